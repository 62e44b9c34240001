"""Small skeletons and BVH texts for the tests of motion files."""

from __future__ import annotations

import dataclasses

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import quat_conjugate, quat_from_euler, quat_multiply, quat_normalise, quat_rotate
from pfnn_jax.motion.reading import Axis
from pfnn_jax.motion.roles import assign_roles
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.up_axis import TURNS

# part, parent, offset in metres of an adult in T-pose; the parts are numbered as here in every naming convention
BODY = (
    ("hips", -1, (0.0, 0.0, 0.0)),
    ("spine", 0, (0.0, 0.12, 0.0)),
    ("neck", 1, (0.0, 0.35, 0.0)),
    ("head", 2, (0.0, 0.10, 0.02)),
    ("l_clavicle", 1, (0.03, 0.30, 0.0)),
    ("l_upperarm", 4, (0.15, 0.0, 0.0)),
    ("l_forearm", 5, (0.28, 0.0, 0.0)),
    ("l_hand", 6, (0.25, 0.0, 0.0)),
    ("r_clavicle", 1, (-0.03, 0.30, 0.0)),
    ("r_upperarm", 8, (-0.15, 0.0, 0.0)),
    ("r_forearm", 9, (-0.28, 0.0, 0.0)),
    ("r_hand", 10, (-0.25, 0.0, 0.0)),
    ("l_thigh", 0, (0.09, -0.05, 0.0)),
    ("l_calf", 12, (0.0, -0.42, 0.0)),
    ("l_foot", 13, (0.0, -0.42, -0.02)),
    ("l_toe", 14, (0.0, -0.07, 0.15)),
    ("r_thigh", 0, (-0.09, -0.05, 0.0)),
    ("r_calf", 16, (0.0, -0.42, 0.0)),
    ("r_foot", 17, (0.0, -0.42, -0.02)),
    ("r_toe", 18, (0.0, -0.07, 0.15)),
)
PARENTS = np.array([parent for _, parent, _ in BODY])
OFFSETS = np.array([offset for _, _, offset in BODY])
NAMES = tuple(name for name, _, _ in BODY)
MIRROR = np.array([0, 1, 2, 3, 8, 9, 10, 11, 4, 5, 6, 7, 16, 17, 18, 19, 12, 13, 14, 15])


def body(names: tuple[str, ...] = NAMES, scale: float = 1.0) -> Skeleton:
    """The adult, or a smaller or larger one, without roles."""
    leaves = [joint for joint in range(len(PARENTS)) if joint not in PARENTS]
    sites = tuple((joint, np.array([0.0, 0.0, 0.05 * scale])) for joint in leaves)
    return Skeleton(tuple(names), PARENTS, OFFSETS * scale, sites, np.arange(len(names)))


def body_clip(seed: int = 0, frames: int = 5, fps: float = 60.0, scale: float = 1.0, spread: float = 0.4) -> MotionClip:
    """The adult in random poses, with roles."""
    random = np.random.default_rng(seed)
    rotations = quat_from_euler(random.normal(0.0, spread, (frames, len(PARENTS), 3)), "ZYX")
    roots = random.normal(0.0, 0.05, (frames, 3)) + np.array([0.0, 0.9 * scale, 0.0])
    return MotionClip(assign_roles(body(scale=scale)), fps, roots, rotations, "plain", "walk-turn-left")


def tipped(clip: MotionClip, up: Axis) -> MotionClip:
    """The clip as a file has it whose `up` axis points up."""
    turn = quat_conjugate(TURNS[up])
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat_multiply(turn, rotations[:, 0])
    return dataclasses.replace(clip, root_positions=quat_rotate(turn, clip.root_positions), rotations=rotations)


def random_clip(random: np.random.Generator, joints: int, frames: int) -> MotionClip:
    """A random tree in random motion."""
    parents = np.array([-1] + [int(random.integers(0, joint)) for joint in range(1, joints)])
    sites = tuple((joint, random.normal(size=3)) for joint in range(joints) if joint not in parents)
    offsets = random.normal(size=(joints, 3)) * (parents >= 0)[:, None]
    names = ("Hips", *(f"bone {joint}" for joint in range(1, joints)))
    skeleton = Skeleton(names, parents, offsets, sites, np.arange(joints))
    rotations = quat_normalise(random.normal(size=(frames, joints, 4)))
    return MotionClip(skeleton, 30.0, random.normal(size=(frames, 3)), rotations)


def bvh_text(joints: list[tuple[str, int, tuple, str]], rows: np.ndarray, frame_time: str = "0.0333333") -> str:
    """BVH text of joints (name, parent, offset, channels) given depth first, with an End Site on every leaf."""
    lines, open_joints = ["HIERARCHY"], []
    owners = {parent for _, parent, _, _ in joints}

    def close_to(parent: int) -> None:
        while open_joints and open_joints[-1] != parent:
            if open_joints.pop() not in owners:
                lines.extend(["End Site", "{", "OFFSET 0 0 0.1", "}"])
            lines.append("}")

    for index, (name, parent, offset, channels) in enumerate(joints):
        close_to(parent)
        lines.append(f"{'JOINT' if open_joints else 'ROOT'} {name}")
        lines += ["{", "OFFSET " + " ".join(map(str, offset)), f"CHANNELS {len(channels.split())} {channels}"]
        open_joints.append(index)
    close_to(-2)
    rows = np.atleast_2d(rows)
    lines += ["MOTION", f"Frames: {len(rows)}", f"Frame Time: {frame_time}"]
    return "\n".join(lines + [" ".join(map(repr, row)) for row in rows.tolist()]) + "\n"
