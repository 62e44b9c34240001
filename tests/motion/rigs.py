"""Skeletons of files for tests of the humanoid map: hierarchies of BVH files, characters, and animals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from pfnn_jax.motion.skeleton import Skeleton


def bvh_skeleton(path: Path) -> Skeleton:
    """The whole hierarchy of a BVH file, with what the reader may fold or refuse; offsets in the file's unit."""
    names: list[str] = []
    parents: list[int] = []
    offsets: list[list[float]] = []
    sites: list[tuple[int, np.ndarray]] = []
    open_joints: list[int] = []  # -1 for an End Site
    for line in path.read_text(encoding="latin-1").split("MOTION")[0].splitlines():
        words = line.split()
        if words and words[0].upper() in ("ROOT", "JOINT"):
            parents.append(open_joints[-1] if open_joints else -1)
            names.append(" ".join(words[1:]).rstrip("{ "))
            offsets.append([0.0, 0.0, 0.0])
            open_joints.append(len(names) - 1)
        elif words and words[0].upper() == "END":
            open_joints.append(-1)
        elif words and words[0].upper() == "OFFSET":
            values = [float(word) for word in words[1:4]]
            if open_joints[-1] >= 0:
                offsets[open_joints[-1]] = values
            else:
                sites.append((open_joints[-2], np.array(values)))
        elif "}" in line:
            open_joints.pop()
    offsets[0] = [0.0, 0.0, 0.0]
    return Skeleton(tuple(names), np.array(parents), np.array(offsets), tuple(sites), np.arange(len(names)))


def character(folder: Path, name: str) -> tuple[Skeleton, np.ndarray, list[int]]:
    """A character of `joints.json`.

    Returns:
        Its skeleton, parents before children, with names empty where it has none; its poses [1, J, 3]; and the index in
        the file of each joint.
    """
    joints = json.loads((folder / "joints.json").read_text())["files"][name]["joints"]
    order: list[int] = []
    while len(order) < len(joints):
        order += [i for i, joint in enumerate(joints) if i not in order and joint["parent"] in (-1, *order)]
    place = {old: new for new, old in enumerate(order)} | {-1: -1}
    parents = np.array([place[joints[i]["parent"]] for i in order])
    # the inverse bind matrices of the lumberjack's controls are all alike; its rest pose is a frame of a clip
    pose = "rest" if name == "rigify_lumberjack" else "bind"
    places = np.array([joints[i].get(pose, joints[i]["rest"]) for i in order], float)
    offsets = np.where((parents >= 0)[:, None], places - places[parents], 0.0)
    names = tuple(joints[i]["name"] or "" for i in order)
    return Skeleton(names, parents, offsets, (), np.arange(len(names))), places[None], order


def tree(rows: list[tuple[str, str, tuple[float, float, float]]]) -> Skeleton:
    """A skeleton of rows (name, parent's name, offset in metres)."""
    names = [name for name, _, _ in rows]
    parents = np.array([names.index(parent) if parent else -1 for _, parent, _ in rows])
    offsets = np.array([offset for _, _, offset in rows], float)
    return Skeleton(tuple(names), parents, offsets, (), np.arange(len(names)))


def quadruped(leg: float, trunk: float, *, named: bool, trunk_bones: int = 4) -> Skeleton:
    """An animal on four legs that faces +Z, from a cat to an elephant.

    Args:
        leg: metres from the floor to the trunk.
        trunk: metres from hind legs to forelegs.
        named: whether its joints have the names of a human's, as in animal captures.
        trunk_bones: bones of the spine.
    """
    rows: list[tuple[str, str, tuple[float, float, float]]] = [("Hips", "", (0, 0, 0))]
    spine = "Hips"
    for bone in range(trunk_bones):
        rows.append((f"Spine{bone}", spine, (0, 0, trunk / trunk_bones)))
        spine = f"Spine{bone}"
    rows += [("Neck", spine, (0, 0.3 * leg, 0.3 * leg)), ("Head", "Neck", (0, 0.2 * leg, 0.3 * leg))]
    rows += [("Tail1", "Hips", (0, 0, -0.2 * leg)), ("Tail2", "Tail1", (0, -0.1 * leg, -0.3 * leg))]
    for side, x in (("Left", 0.15 * leg), ("Right", -0.15 * leg)):
        rows += [
            (f"{side}UpLeg", "Hips", (x, 0, 0)),
            (f"{side}Leg", f"{side}UpLeg", (0, -0.45 * leg, 0.1 * leg)),
            (f"{side}Foot", f"{side}Leg", (0, -0.45 * leg, -0.15 * leg)),
            (f"{side}ToeBase", f"{side}Foot", (0, -0.1 * leg, 0.1 * leg)),
            (f"{side}Shoulder", spine, (0.5 * x, 0.05 * leg, 0)),
            (f"{side}Arm", f"{side}Shoulder", (0.5 * x, -0.05 * leg, 0)),
            (f"{side}ForeArm", f"{side}Arm", (0, -0.45 * leg, -0.1 * leg)),
            (f"{side}Hand", f"{side}ForeArm", (0, -0.5 * leg, 0.05 * leg)),
        ]
    skeleton = tree(rows)
    return skeleton if named else without_names(skeleton)


def crab(legs: int) -> Skeleton:
    """An animal with a number of legs on each side, and a pair of claws, without names."""
    rows: list[tuple[str, str, tuple[float, float, float]]] = [
        ("Hips", "", (0, 0, 0)),
        ("Head", "Hips", (0, 0.05, 0.2)),
    ]
    for side in (1.0, -1.0):
        for leg in range(legs):
            name = f"{leg} {side}"
            rows += [
                (f"a{name}", "Hips", (0.2 * side, 0, 0.1 * leg - 0.15)),
                (f"b{name}", f"a{name}", (0.3 * side, 0.2, 0)),
                (f"c{name}", f"b{name}", (0.3 * side, -0.4, 0)),
                (f"d{name}", f"c{name}", (0.05 * side, -0.1, 0)),
            ]
        rows += [
            (f"e{side}", "Hips", (0.15 * side, 0, 0.25)),
            (f"f{side}", f"e{side}", (0.2 * side, 0.1, 0.2)),
            (f"g{side}", f"f{side}", (-0.1 * side, 0, 0.2)),
        ]
    return without_names(tree(rows))


def without_names(skeleton: Skeleton) -> Skeleton:
    """The skeleton with names that say nothing."""
    names = tuple(f"{'abcdefgh'[joint % 8]}{joint}" for joint in range(skeleton.num_joints))
    return Skeleton(names, skeleton.parents, skeleton.offsets, skeleton.end_sites, skeleton.mirror)
