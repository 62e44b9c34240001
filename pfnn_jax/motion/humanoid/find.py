"""Finds the humanoid map of a skeleton by names, geometry and a user's overrides."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.humanoid.checks import DOUBTFUL, Body, Finding, check_geometry, is_no_pose, stands
from pfnn_jax.motion.humanoid.map import ARM, LEG, SIDES, HumanoidMap
from pfnn_jax.motion.humanoid.measured import COINCIDENT, body_size, measured_limbs
from pfnn_jax.motion.humanoid.named import detached_foot, named_limbs, named_trunk
from pfnn_jax.motion.humanoid.names import read_names
from pfnn_jax.motion.humanoid.overrides import Chosen, choose_joints, listed
from pfnn_jax.motion.humanoid.tree import JointTree, joint_tree
from pfnn_jax.motion.humanoid.trunk import Trunk, find_head, find_hips, find_spine
from pfnn_jax.motion.skeleton import Skeleton, rest_pose

Poses = np.ndarray | Callable[[], np.ndarray] | None

UP_AXES = (
    np.eye(3),
    np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),  # Z up
    np.diag([-1.0, -1, 1]),  # Y down
    np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),  # Z down
    np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),  # X up
    np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]),  # X down
)
"""Rotations that turn each axis of a file upwards, in the order in which they are tried."""

BY_GEOMETRY = 0.85
"""Factor of the confidence where limbs are found by geometry alone."""


def find_humanoid(
    skeleton: Skeleton,
    *,
    poses: Poses = None,
    overrides: Mapping[str, Any] | None = None,
    source: str | Path = "skeleton",
) -> HumanoidMap:
    """Finds which joint of a skeleton plays which part of a human body.

    Names of all common conventions are read without namespaces and what exporters add; limbs without such names are
    found by their bones and places. Geometry then confirms the map: order of the joints, equal lengths of left and
    right, the side to which the toes point, and whether this is a human at all.

    Args:
        skeleton: the joints; its own map, roles and mirror are ignored.
        poses: [N, J, 3] joint positions of some poses in any unit, or a function that returns them. Where joints have
            telling names they are used, and the function is called, only if the pose of zero rotations leaves a doubt.
        overrides: bone, role or VRM bone -> joint name; see `choose_joints`. What it does not name is found.
        source: file to name in messages.

    Returns:
        The map, with its confidence and explanation.

    Raises:
        InputError: if legs or hips are missing, if the joints do not lie on chains, if the skeleton is not that of a
            human, or if an override names an unknown bone or joint or contradicts another.
    """
    parents = tuple(skeleton.parents.tolist())
    if not overrides:
        sites = tuple(joint for joint, site in skeleton.end_sites if not site.any())
        offsets = np.ascontiguousarray(skeleton.offsets, float).tobytes()
        confirmed = _confirmed_at_rest(skeleton.names, parents, offsets, sites, len(skeleton.end_sites))
        if confirmed is not None:
            return confirmed
    tree = joint_tree(parents)
    chosen = choose_joints(overrides or {}, skeleton.names, source)
    limbs, notes = _named_limbs(skeleton.names, tree, chosen)
    if _has(limbs, "shin"):
        return _by_names(skeleton, tree, limbs, notes, chosen, poses, source)
    return _by_geometry(skeleton, tree, limbs, chosen, _positions(skeleton, poses), source)


@functools.lru_cache(maxsize=16)
def _confirmed_at_rest(
    names: tuple[str, ...], parents: tuple[int, ...], offsets: bytes, dead_ends: tuple[int, ...], num_sites: int
) -> HumanoidMap | None:
    """Returns the map of a skeleton with telling names if its rest pose leaves no doubt.

    Clips of one skeleton share the result.

    Args:
        names: of J joints.
        parents: of the joints.
        offsets: [J, 3] float64, as bytes.
        dead_ends: joints with an End Site at their own place.
        num_sites: number of End Sites.
    """
    tree = joint_tree(parents)
    limbs, notes = _named_limbs(names, tree, {})
    places = np.frombuffer(offsets).reshape(-1, 3)
    sites = [(joint, np.zeros(3)) for joint in dead_ends] + [(0, np.ones(3))] * (num_sites - len(dead_ends))
    skeleton = Skeleton(names, np.array(parents), places, tuple(sites), np.arange(len(names)))
    if not _has(limbs, "shin") or is_no_pose(limbs, rest_pose(skeleton)[None]):
        return None
    try:
        found = _by_names(skeleton, tree, limbs, notes, {}, None, "skeleton")
    except InputError:
        return None
    return None if any(line.startswith(DOUBTFUL) for line in found.explanation) else found


def need_humanoid(skeleton: Skeleton, source: str | Path = "skeleton") -> HumanoidMap:
    """Returns the skeleton's humanoid map; one that was read without it is searched in its pose of zero rotations.

    Raises:
        InputError: if it has none, with the reason.
    """
    return skeleton.humanoid if skeleton.humanoid is not None else find_humanoid(skeleton, source=source)


def _positions(skeleton: Skeleton, poses: Poses) -> np.ndarray:
    """Returns the poses [N, J, 3]."""
    if poses is None:
        return rest_pose(skeleton)[None]
    return np.asarray(poses() if callable(poses) else poses, float)


def _has(limbs: Mapping[str, Any], part: str) -> bool:
    """Returns whether both sides have a part."""
    return all(f"{side}_{part}" in limbs for side in SIDES)


def _named_limbs(names: tuple[str, ...], tree: JointTree, chosen: Chosen) -> tuple[dict[str, int], list[str]]:
    """Returns the limbs that names and overrides give, with feet that are not under their leg, and a line for each."""
    notes = []
    limbs = dict(named_limbs(names, tree.parents))
    for side in SIDES:
        leg = {limbs[f"{side}_{part}"] for part in LEG if f"{side}_{part}" in limbs}
        if leg and f"{side}_foot" not in limbs and (foot := detached_foot(names, side, leg)) is not None:
            limbs[f"{side}_foot"] = foot
            notes.append(f"the {side} foot {names[foot]} is not under the leg")
    return _override(limbs, chosen, tree), notes


def _override(limbs: dict[str, int], chosen: Chosen, tree: JointTree) -> dict[str, int]:
    """Returns limbs with the chosen joints, and the middle joint of a limb whose ends alone are chosen."""
    limbs = {bone: joint for bone, joint in limbs.items() if bone not in chosen}
    limbs |= {bone: joint for bone, joint in chosen.items() if isinstance(joint, int)}
    for side in SIDES:
        for upper, lower, end in (("thigh", "shin", "foot"), ("upper_arm", "lower_arm", "hand")):
            first, last = limbs.get(f"{side}_{upper}"), limbs.get(f"{side}_{end}")
            middle = limbs.get(f"{side}_{lower}")
            if first is None or last is None or first == last or not tree.is_above(first, last):
                continue
            between = tree.down(first, last)[:-1]
            if between and middle not in between and f"{side}_{lower}" not in chosen:
                limbs[f"{side}_{lower}"] = between[(len(between) - 1) // 2]
    return {bone: joint for bone, joint in limbs.items() if bone not in ("hips", "head")}


def _by_names(
    skeleton: Skeleton,
    tree: JointTree,
    limbs: dict[str, int],
    notes: list[str],
    chosen: Chosen,
    poses: Poses,
    source: str | Path,
) -> HumanoidMap:
    """Returns the map of a skeleton whose legs are named, confirmed by its rest pose or, if that is doubtful, by poses.

    A person may crawl through a clip and yet stand in the rest pose, unless that shows no body.

    Raises:
        InputError: as the last of both poses does, if neither gives a map.
    """
    best: HumanoidMap | None = None
    refusal: InputError | None = None
    rest = rest_pose(skeleton)[None]
    for choice in (rest, poses):
        if choice is None or (choice is rest and poses is not None and is_no_pose(limbs, rest)):
            continue
        finding = Finding(list(notes))
        try:
            found = _complete(skeleton, tree, limbs, chosen, _positions(skeleton, choice), finding, source)
        except InputError as error:
            refusal = error
            continue
        if not finding.doubtful:
            return found
        best = found if best is None or found.confidence > best.confidence else best
    if best is None:
        assert refusal is not None
        raise refusal
    return best


def _by_geometry(
    skeleton: Skeleton, tree: JointTree, limbs: dict[str, int], chosen: Chosen, poses: np.ndarray, source: str | Path
) -> HumanoidMap:
    """Returns the map of a skeleton whose legs are not named, with the first axis up with which it stands.

    Raises:
        InputError: as the first axis up does.
    """
    helpers = [label.helper for label in read_names(skeleton.names)]
    arms = {bone: joint for bone, joint in limbs.items() if _has(limbs, "upper_arm")}
    lying: HumanoidMap | None = None
    refusal: InputError | None = None
    for up in UP_AXES:
        finding = Finding()
        finding.decide("limbs found by their lengths and places, not by names", BY_GEOMETRY)
        stood = poses @ up.T
        measured = _override({**measured_limbs(tree, stood, helpers), **arms}, chosen, tree)
        try:
            found = _complete(skeleton, tree, measured, chosen, stood, finding, source, by_geometry=True)
        except InputError as error:
            refusal = refusal or error
            continue
        if stands(Body(found.joints(), read_names(skeleton.names), tree, stood)):
            return found
        lying = lying or found
    if refusal is None and lying is not None:
        return lying
    assert refusal is not None
    raise refusal


def _complete(
    skeleton: Skeleton,
    tree: JointTree,
    limbs: dict[str, int],
    chosen: Chosen,
    poses: np.ndarray,
    finding: Finding,
    source: str | Path,
    *,
    by_geometry: bool = False,
) -> HumanoidMap:
    """Adds hips, spine, neck and head to limbs, and confirms the map by geometry."""
    missing = [f"{side}_{part}" for side in SIDES for part in ("thigh", "shin") if f"{side}_{part}" not in limbs]
    if missing:
        rule = f"must have a joint for {', '.join(missing)}; name it in a file of overrides (--roles)"
        raise InputError(source, "skeleton", f"joints {listed(skeleton.names)}", rule)
    names = skeleton.names
    limbs = _below_connectors(limbs, tree, chosen, poses[0])
    sites = [joint for joint, site in skeleton.end_sites if not site.any()]
    ends = frozenset(sites if len(sites) < len(skeleton.end_sites) else ())  # where all are zero they say nothing
    trunk = Trunk(tree, read_names(names), named_trunk(names), poses[0], limbs, ends)
    head = chosen["head"] if "head" in chosen else find_head(trunk)
    assert not isinstance(head, tuple)
    hips = chosen["hips"] if isinstance(chosen.get("hips"), int) else find_hips(trunk, head)
    assert isinstance(hips, int)
    spine, neck = find_spine(trunk, hips, head)
    spine, neck = (chosen.get(bone, found) for bone, found in (("spine", spine), ("neck", neck)))
    parts = {f"{side}_{part}": limbs.get(f"{side}_{part}") for side in SIDES for part in (*ARM, *LEG)}
    found: dict[str, Any] = {"hips": hips, "spine": spine, "neck": neck, "head": head, **parts}
    _require_chains(names, tree, found, source)
    insist = all(isinstance(chosen.get(f"{side}_thigh"), int) for side in SIDES)
    body = Body(found, trunk.labels, tree, poses, by_geometry)
    check_geometry(body, finding, source, insist=insist)
    return HumanoidMap(**found, confidence=finding.confidence, explanation=tuple(finding.lines))


def _below_connectors(limbs: Mapping[str, int], tree: JointTree, chosen: Chosen, pose: np.ndarray) -> dict[str, int]:
    """Returns limbs in which no thigh is a connector, a joint between hips and thigh that both legs have at one place.

    Hip joints are apart. Where no joints above the shins are, the limbs are returned unchanged.

    Args:
        limbs: bone -> joint.
        tree: of J joints.
        chosen: by the user; their thighs are kept.
        pose: [J, 3].
    """
    gap = COINCIDENT * body_size(pose)
    chains = [[limbs[f"{side}_thigh"], limbs[f"{side}_shin"]] for side in SIDES]
    if any(f"{side}_thigh" in chosen for side in SIDES) or not all(tree.is_above(*chain) for chain in chains):
        return dict(limbs)
    thighs = [[thigh, *tree.down(thigh, shin)[:-1]] for thigh, shin in chains]
    for left, right in zip(*thighs, strict=False):
        if np.linalg.norm(pose[left] - pose[right]) > gap:
            return {**limbs, "left_thigh": left, "right_thigh": right}
    return dict(limbs)


def _require_chains(names: tuple[str, ...], tree: JointTree, found: dict[str, Any], source: str | Path) -> None:
    """Refuses limbs whose joints do not descend from each other, and joints that play two parts."""
    for side in SIDES:
        thigh, shin, foot, toe = (found[f"{side}_{part}"] for part in LEG)
        chain = [found["hips"], thigh, shin]
        # a foot may hang elsewhere than under its leg, but not above it
        detached = foot is not None and not tree.is_above(shin, foot) and not tree.is_above(foot, shin)
        chain += [] if foot is None or detached else [foot]
        pairs = list(zip(chain, chain[1:], strict=False)) + (
            [(foot, toe)] if foot is not None and toe is not None else []
        )
        upper, lower, hand = (found[f"{side}_{part}"] for part in ("upper_arm", "lower_arm", "hand"))
        arm = [joint for joint in (upper, lower, hand) if joint is not None]
        pairs += list(zip(arm, arm[1:], strict=False))
        for one, other in pairs:
            if not tree.is_above(one, other) or one == other:
                rule = "hips, thigh, shin, ankle and toe, and the joints of an arm, must each lie below the one before"
                raise InputError(source, "skeleton", f"{side}: {names[other]} is not below {names[one]}", rule)
    if found["left_thigh"] == found["right_thigh"]:
        raise InputError(source, "skeleton", names[found["left_thigh"]], "left and right must be different joints")
    if found["left_upper_arm"] is not None and found["left_upper_arm"] == found["right_upper_arm"]:
        raise InputError(source, "skeleton", names[found["left_upper_arm"]], "left and right must be different joints")
