"""Puts a motion onto another skeleton: from any humanoid to any other.

With Q the world rotation of a joint and R its rotation in the reference pose, G = Q R⁻¹ turns a part of the body from
the reference pose into its pose. The target's joint of the same part gets Q' = G R'. Positions follow from the target's
own bones, travel is scaled by the length of the legs, and feet are put where the source's feet are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.filters import moving_minimum
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.map import ARM, LEG, HumanoidMap
from pfnn_jax.motion.kinematics import (
    forward_kinematics,
    quat_conjugate,
    quat_from_axis_angle,
    quat_multiply,
    quat_rotate,
)
from pfnn_jax.motion.retargeting.body import (
    FORWARD,
    LEFT,
    SIDES,
    UP,
    humanoid_of,
    limb,
    neck_chain,
    torso_chain,
)
from pfnn_jax.motion.retargeting.chains import resample_chain
from pfnn_jax.motion.retargeting.feet import (
    FlatFoot,
    ankle_targets,
    flat_foot,
    keep_toes_above,
    lift_toes,
    pitch_foot,
    resting_foot,
    sole_heights,
)
from pfnn_jax.motion.retargeting.legs import leg_extension, place_legs
from pfnn_jax.motion.retargeting.reference import reference_pose, some_poses
from pfnn_jax.motion.retargeting.resting import find_resting_heights, same_floor
from pfnn_jax.motion.skeleton import Skeleton, rest_pose

STANCE_SECONDS = 1.0
"""Within any such time one foot of a person who walks or runs stands."""

ARMS_DOWN = np.deg2rad(75.0)
"""Radians below the T-pose at which the arms of the target hang where the source has none."""

ALIKE = 1e-6  # of the longest bone: offsets that differ by less are equal


@dataclass(frozen=True, eq=False)
class Retargeted:
    """A clip on another skeleton.

    Attributes:
        clip: the motion on the target skeleton.
        scale: leg length of the target over that of the source, by which travel is scaled.
        summary: one line: "retargeted from 59 to 22 joints, legs scaled by 0.93".
    """

    clip: MotionClip
    scale: float
    summary: str


def retarget(
    clip: MotionClip,
    target: Skeleton,
    *,
    source_map: HumanoidMap | None = None,
    target_map: HumanoidMap | None = None,
) -> Retargeted:
    """Puts a clip onto another skeleton.

    Bones keep their directions and hips, chest, head, hands and feet their orientations, measured from the reference
    poses of both skeletons. Spine and neck of another number of joints share the bending. Joints without a
    counterpart, such as fingers and helper joints, are at rest. Arms that the source does not have hang down. The
    result depends neither on names nor on local axes.

    A skeleton with the same bones up to scale (whatever the names) keeps all rotations.

    Args:
        clip: T frames on J joints.
        target: the skeleton to put it onto, of K joints.
        source_map, target_map: the humanoid maps of both skeletons; by default their own.

    Returns:
        The clip on the target, the scale and a summary.

    Raises:
        InputError: if either skeleton has no humanoid map, no ankles, or a leg without length.
    """
    source_map = humanoid_of(clip.skeleton, clip.source or "clip") if source_map is None else source_map
    target_map = humanoid_of(target) if target_map is None else target_map
    lengths = [leg_length_of(clip.skeleton, source_map), leg_length_of(target, target_map)]
    if not min(lengths) > 0:
        raise InputError(
            clip.source or "clip", "skeleton", "a leg of no length", "hips, knees and ankles must be apart"
        )
    scale = lengths[1] / lengths[0]
    if same_bones(clip.skeleton, target, scale) and same_floor(clip.skeleton, target, scale):
        moved = replace(clip, skeleton=target, root_positions=scale * clip.root_positions)
    else:
        moved = _retarget(clip, target, source_map, target_map, scale)
    joints = f"{clip.skeleton.num_joints} to {target.num_joints} joints"
    return Retargeted(moved, scale, f"retargeted from {joints}, legs scaled by {scale:.2f}")


def same_bones(skeleton: Skeleton, other: Skeleton, scale: float = 1.0) -> bool:
    """Returns whether both skeletons have the same joints and bones, the other's `scale` times as long."""
    if not np.array_equal(skeleton.parents, other.parents):
        return False
    tolerance = ALIKE * max(float(np.abs(other.offsets).max()), 1e-9)
    return bool(np.all(np.abs(scale * skeleton.offsets - other.offsets) <= tolerance))


def _retarget(
    clip: MotionClip, target: Skeleton, source_map: HumanoidMap, target_map: HumanoidMap, scale: float
) -> MotionClip:
    """Returns the clip on another skeleton; see `retarget`."""
    source = clip.skeleton
    positions, world = forward_kinematics(source, clip.root_positions, clip.rotations)
    references = _source_reference(clip, source_map), reference_pose(target, target_map)
    turns = part_turns(quat_multiply(world, quat_conjugate(references[0])), source_map, target_map)
    moved = np.empty((clip.num_frames, target.num_joints, 4))
    for joint, turn in turns.items():
        moved[:, joint] = quat_multiply(turn, references[1][joint])
    feet = list(zip(*_flat_feet(clip, target, source_map, target_map, references), strict=True))
    leg = leg_length_of(target, target_map)
    floor = scale * moving_minimum(sole_heights(positions, source_map, [own for own, _ in feet]), _window(clip.fps))
    ankles = []
    for side, (own, other) in zip(SIDES, feet, strict=True):
        (ankle,), (foot,) = limb(source_map, side, "foot"), limb(target_map, side, "foot")
        turned = pitch_foot(turns[foot], scale, own, other)
        places = ankle_targets(positions[:, ankle], turns[foot], turned, scale, own, other, floor, leg)
        turned, places = keep_toes_above(turned, other, places, floor)
        ankles.append(places)
        moved[:, foot] = quat_multiply(turned, references[1][foot])
    raised = UP * np.mean([other.height - scale * own.height for own, other in feet])
    middle = (positions[:, source_map.left_thigh] + positions[:, source_map.right_thigh]) / 2
    hips = scale * middle + raised - quat_rotate(moved[:, target_map.hips], _middle_of_legs(target, target_map))
    left = quat_rotate(turns[target_map.hips], LEFT)
    targets = np.stack(ankles, axis=1)
    hips = place_legs(target_map, target, hips, moved, left, targets, leg_extension(positions, source_map))
    lift_toes(target_map, target, references[1], moved, targets, [other for _, other in feet], floor)
    local = _fill(target, target_map, moved, set(turns))
    at_origin, _ = forward_kinematics(target, np.zeros((clip.num_frames, 3)), local)
    return replace(clip, skeleton=target, root_positions=hips - at_origin[:, target_map.hips], rotations=local)


def _flat_feet(
    clip: MotionClip,
    target: Skeleton,
    source_map: HumanoidMap,
    target_map: HumanoidMap,
    references: tuple[np.ndarray, np.ndarray],
) -> tuple[list[FlatFoot], list[FlatFoot]]:
    """Returns the feet of the source and of the target, left and right, at their resting heights where both are known.

    Args:
        clip: the motion on the source.
        target: the other skeleton.
        source_map, target_map: the humanoid maps.
        references: reference poses [J, 4] and [K, 4].
    """
    source, known = clip.skeleton, target.resting_heights
    own = [flat_foot(source, source_map, references[0], side) for side in SIDES]
    others = [flat_foot(target, target_map, references[1], side) for side in SIDES]
    if known is None:
        return own, others
    heights = source.resting_heights
    if heights is None:
        heights = find_resting_heights(clip, source_map)
    if heights is None:
        return own, others
    return list(map(resting_foot, own, heights)), list(map(resting_foot, others, known))


def _window(fps: float) -> int:
    """Returns the odd number of frames around each within which a foot stands."""
    return 2 * int(np.ceil(STANCE_SECONDS * fps / 2)) + 1


def _source_reference(clip: MotionClip, body: HumanoidMap) -> np.ndarray:
    """Returns the reference pose [J, 4] of a clip's skeleton, from its motion where nothing else shows it."""
    skeleton = clip.skeleton
    if skeleton.poses is None:
        skeleton = replace(skeleton, poses=some_poses(clip.rotations))
    return reference_pose(skeleton, body)


def _middle_of_legs(skeleton: Skeleton, body: HumanoidMap) -> np.ndarray:
    """Returns the point [3] between both thigh joints in the frame of the hips."""
    rest = rest_pose(skeleton)
    return (rest[body.left_thigh] + rest[body.right_thigh]) / 2 - rest[body.hips]


def part_turns(every: np.ndarray, source: HumanoidMap, target: HumanoidMap) -> dict[int, np.ndarray]:
    """Returns world rotations [T, 4] for each of the target's joints that is a part of the body.

    Args:
        every: [T, J, 4] world rotations of the source's joints from some common pose.
        source, target: the humanoid maps.
    """
    turns = {target.hips: every[:, source.hips]}
    torso, neck = torso_chain(source), neck_chain(source)
    chest = torso[-1]
    _share(turns, target.spine, resample_chain(every[:, list(torso)], len(target.spine)))
    above = neck_chain(target)
    _share(turns, above, resample_chain(every[:, [chest, *neck]], len(above), lower=True))
    for side in SIDES:
        _follow(turns, every, source.limb(side, ARM), target.limb(side, ARM), chest)
        if source.limb(side, ARM)[1] is None:
            _hang_arm(turns, side, target.limb(side, ARM))
        _follow(turns, every, source.limb(side, LEG), target.limb(side, LEG), source.hips)
    return turns


def _share(turns: dict[int, np.ndarray], joints: tuple[int, ...], shared: np.ndarray) -> None:
    """Adds the rotations [T, n, 4] of the n joints of a spine or neck."""
    turns.update({joint: shared[:, number] for number, joint in enumerate(joints)})


def _follow(
    turns: dict[int, np.ndarray],
    every: np.ndarray,
    own: tuple[int | None, ...],
    joints: tuple[int | None, ...],
    carrier: int,
) -> None:
    """Adds the joints of a limb; one whose counterpart the source lacks turns with the part that carries it."""
    for part, joint in zip(own, joints, strict=True):
        carrier = carrier if part is None else part
        if joint is not None:
            turns[joint] = every[:, carrier]


def _hang_arm(turns: dict[int, np.ndarray], side: str, arm: tuple[int | None, ...]) -> None:
    """Lowers an arm of the target, without its clavicle, from the T-pose of the reference pose."""
    lowered = quat_from_axis_angle(FORWARD, -SIDES[side] * ARMS_DOWN)
    turns.update({joint: quat_multiply(turns[joint], lowered) for joint in arm[1:] if joint is not None})


def _fill(skeleton: Skeleton, body: HumanoidMap, world: np.ndarray, known: set[int]) -> np.ndarray:
    """Returns local rotations [T, J, 4] with joints outside `known` at rest; fills in their world rotations."""
    local = np.empty_like(world)
    for joint in range(skeleton.num_joints):
        parent = int(skeleton.parents[joint])
        if joint not in known:  # a root above the hips keeps the hips' orientation
            world[:, joint] = world[:, parent if parent >= 0 else body.hips]
        if parent < 0:
            local[:, joint] = world[:, joint]
        elif joint in known:
            local[:, joint] = quat_multiply(quat_conjugate(world[:, parent]), world[:, joint])
        else:
            local[:, joint] = (1.0, 0.0, 0.0, 0.0)
    return local
