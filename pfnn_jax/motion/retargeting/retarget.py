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
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.humanoid.map import ARM, LEG, HumanoidMap
from pfnn_jax.motion.kinematics import (
    forward_kinematics,
    quat_conjugate,
    quat_from_axis_angle,
    quat_multiply,
    quat_rotate,
)
from pfnn_jax.motion.retargeting.ankles import with_ankles
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
    foot_headings,
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

WIDER = 0.1
"""Leg lengths by which the hip joints of two people may lie further out; a figure's may by a whole leg."""

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
    retargeter = make_retargeter(clip.skeleton, target, source_map=source_map, target_map=target_map, clip=clip)
    joints = f"{clip.skeleton.num_joints} to {target.num_joints} joints"
    summary = f"retargeted from {joints}, legs scaled by {retargeter.scale:.2f}"
    return Retargeted(retargeter.clip(clip), retargeter.scale, summary)


def make_retargeter(
    source: Skeleton,
    target: Skeleton,
    *,
    source_map: HumanoidMap | None = None,
    target_map: HumanoidMap | None = None,
    clip: MotionClip | None = None,
) -> Retargeter:
    """Returns what puts motions of one skeleton onto another; see `retarget`.

    Args:
        source: J joints.
        target: K joints.
        source_map, target_map: the humanoid maps of both skeletons; by default their own.
        clip: a motion on the source, which shows its reference pose and resting heights where the skeleton does not.

    Raises:
        InputError: as `retarget`.
    """
    file = (clip.source if clip is not None else "") or "clip"
    source_map = humanoid_of(source, file) if source_map is None else source_map
    standing, target_map = _with_feet(target, target_map)
    lengths = [leg_length_of(source, source_map), leg_length_of(standing, target_map)]
    if not min(lengths) > 0:
        raise InputError(file, "skeleton", "a leg of no length", "hips, knees and ankles must be apart")
    scale = lengths[1] / lengths[0]
    if same_bones(source, target, scale) and same_floor(source, target, scale):
        return Retargeter(source, target, scale)
    references = _source_reference(source, source_map, clip), reference_pose(standing, target_map)
    feet = _flat_feet(source, standing, source_map, target_map, references, clip)
    wider = _wider(source, standing, source_map, target_map, scale, lengths[1])
    bodies = Bodies(standing, source_map, target_map, *references, tuple(zip(*feet, strict=True)), wider)
    return Retargeter(source, target, scale, bodies)


def _wider(
    source: Skeleton, target: Skeleton, source_map: HumanoidMap, target_map: HumanoidMap, scale: float, leg: float
) -> float:
    """Returns the metres by which the target's feet stand further out: its hips are wider by more than a person's."""
    halves = [
        np.linalg.norm(rest_pose(skeleton)[body.left_thigh] - rest_pose(skeleton)[body.right_thigh]) / 2
        for skeleton, body in ((source, source_map), (target, target_map))
    ]
    return max(float(halves[1] - scale * halves[0]) - WIDER * leg, 0.0)


def _with_feet(target: Skeleton, body: HumanoidMap | None) -> tuple[Skeleton, HumanoidMap]:
    """Returns the target with ankles and its map; see `with_ankles`."""
    if body is None:
        body = need_humanoid(target)
    standing, body = with_ankles(target, body)
    return standing, humanoid_of(replace(standing, humanoid=body))


def same_bones(skeleton: Skeleton, other: Skeleton, scale: float = 1.0) -> bool:
    """Returns whether both skeletons have the same joints and bones, the other's `scale` times as long."""
    if not np.array_equal(skeleton.parents, other.parents):
        return False
    tolerance = ALIKE * max(float(np.abs(other.offsets).max()), 1e-9)
    return bool(np.all(np.abs(scale * skeleton.offsets - other.offsets) <= tolerance))


@dataclass(frozen=True, eq=False)
class Bodies:
    """What two different bodies need to take each other's motion.

    Attributes:
        target: the target skeleton with ankles, which come last where it has none of its own.
        source_map, target_map: the humanoid maps.
        source_reference, target_reference: [J, 4] and [K, 4] reference poses.
        feet: the source's and the target's foot, left and right.
        wider: metres by which each foot of the target stands further out than the source's, scaled.
    """

    target: Skeleton
    source_map: HumanoidMap
    target_map: HumanoidMap
    source_reference: np.ndarray
    target_reference: np.ndarray
    feet: tuple[tuple[FlatFoot, FlatFoot], ...]
    wider: float


@dataclass(frozen=True, eq=False)
class Retargeter:
    """Puts motions of one skeleton onto another, as whole clips or frame by frame.

    Attributes:
        source: J joints.
        target: K joints.
        scale: leg length of the target over that of the source, by which travel is scaled.
        bodies: what both bodies differ in; None if they have the same bones up to scale, so that rotations are kept.
    """

    source: Skeleton
    target: Skeleton
    scale: float
    bodies: Bodies | None = None

    def clip(self, clip: MotionClip) -> MotionClip:
        """Returns a clip of the source on the target."""
        if self.bodies is None:
            return replace(clip, skeleton=self.target, root_positions=self.scale * clip.root_positions)
        positions, world = forward_kinematics(self.source, clip.root_positions, clip.rotations)
        floor = moving_minimum(self.sole_heights(positions), stance_frames(clip.fps))
        roots, moved = self.world_poses(positions, world, floor)
        return replace(clip, skeleton=self.target, root_positions=roots, rotations=_local(self.target, moved))

    def pose(self, positions: np.ndarray, world: np.ndarray, floor: float) -> tuple[np.ndarray, np.ndarray]:
        """Returns one pose on the target: what `clip` returns for that frame above the same floor.

        Args:
            positions: [J, 3] metres of the source's joints.
            world: [J, 4] their world rotations.
            floor: metres, the lowest of `sole_heights` within `STANCE_SECONDS`.

        Returns:
            Positions [K, 3] in metres and world rotations [K, 4] of the target's joints.
        """
        if self.bodies is None:
            return self.scale * np.asarray(positions, float), np.asarray(world, float)
        one = np.asarray(positions, float)[None], np.asarray(world, float)[None]
        roots, moved = self.world_poses(*one, np.array([floor]))
        return place_joints(self.target, roots[0], moved[0]), moved[0]

    @property
    def carriers(self) -> np.ndarray:
        """The joint [K] of the target with which each moves rigidly in all motions; itself if it is moved."""
        if self.bodies is None:
            return np.arange(self.target.num_joints)
        source, target = self.bodies.source_map, self.bodies.target_map
        still = np.zeros((1, self.source.num_joints, 4))
        return _carriers(self.bodies.target, target, set(part_turns(still, source, target)))[: self.target.num_joints]

    def sole_heights(self, positions: np.ndarray) -> np.ndarray:
        """Returns the height [T] in metres of the lower sole of the source in positions [T, J, 3]."""
        if self.bodies is None:
            return np.zeros(len(positions))
        return sole_heights(positions, self.bodies.source_map, [own for own, _ in self.bodies.feet])

    def world_poses(self, positions: np.ndarray, world: np.ndarray, floor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns root positions [T, 3] and world rotations [T, K, 4] of the target, each frame by itself.

        Args:
            positions: [T, J, 3] metres of the source's joints.
            world: [T, J, 4] their world rotations.
            floor: [T] metres below the source's feet.
        """
        assert self.bodies is not None
        roots, moved = _retarget(self.bodies, self.scale, positions, world, self.scale * floor)
        return roots, moved[:, : self.target.num_joints]


def place_joints(skeleton: Skeleton, root: np.ndarray, world: np.ndarray) -> np.ndarray:
    """Returns the positions [J, 3] of the joints of one pose.

    Args:
        skeleton: J joints.
        root: [3] metres, of joint 0.
        world: [J, 4] world rotations.
    """
    bones = quat_rotate(world[skeleton.parents], skeleton.offsets)
    bones[0] = root
    for joint in range(1, skeleton.num_joints):
        bones[joint] += bones[skeleton.parents[joint]]
    return bones


def _retarget(
    bodies: Bodies, scale: float, positions: np.ndarray, world: np.ndarray, floor: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns root positions [T, 3] and world rotations [T, K, 4]; see `Retargeter.world_poses`.

    Args:
        bodies: both bodies; the target's has K joints.
        scale: of travel.
        positions, world: [T, J, 3] and [T, J, 4] of the source.
        floor: [T] metres below the target's feet.
    """
    target, reference = bodies.target, bodies.target_reference
    source_map, target_map = bodies.source_map, bodies.target_map
    turns = part_turns(quat_multiply(world, quat_conjugate(bodies.source_reference)), source_map, target_map)
    moved = np.empty((len(world), target.num_joints, 4))
    parts = list(turns)
    moved[:, parts] = quat_multiply(np.stack([turns[joint] for joint in parts], axis=1), reference[parts])
    leg = leg_length_of(target, target_map)
    ankles = []
    for side, (own, other) in zip(SIDES, bodies.feet, strict=True):
        (ankle,), (foot,) = limb(source_map, side, "foot"), limb(target_map, side, "foot")
        turned = pitch_foot(turns[foot], scale, own, other)
        places = ankle_targets(positions[:, ankle], turns[foot], turned, scale, own, other, floor, leg)
        turned, lifted = keep_toes_above(turned, other, places, floor)
        moved_by = lifted - places + SIDES[side] * bodies.wider * np.cross(UP, foot_headings(turns[foot]))
        # the toe keeps its place where the foot is turned less steep
        ankles.append(moved_by + ankle_targets(positions[:, ankle], turns[foot], turned, scale, own, other, floor, leg))
        moved[:, foot] = quat_multiply(turned, reference[foot])
    higher = UP * np.mean([other.height - scale * own.height for own, other in bodies.feet])
    middle = (positions[:, source_map.left_thigh] + positions[:, source_map.right_thigh]) / 2
    hips = scale * middle + higher - quat_rotate(moved[:, target_map.hips], _middle_of_legs(target, target_map))
    left = quat_rotate(turns[target_map.hips], LEFT)
    targets = np.stack(ankles, axis=1)
    hips = place_legs(target_map, target, hips, moved, left, targets, leg_extension(positions, source_map))
    lift_toes(target_map, target, reference, moved, targets, [other for _, other in bodies.feet], floor)
    moved = moved[:, _carriers(target, target_map, set(turns))]
    return _root_of(target, target_map.hips, hips, moved), moved


def _flat_feet(
    source: Skeleton,
    target: Skeleton,
    source_map: HumanoidMap,
    target_map: HumanoidMap,
    references: tuple[np.ndarray, np.ndarray],
    clip: MotionClip | None,
) -> tuple[list[FlatFoot], list[FlatFoot]]:
    """Returns the feet of the source and of the target, left and right, at their resting heights where both are known.

    Args:
        source, target: the skeletons.
        source_map, target_map: the humanoid maps.
        references: reference poses [J, 4] and [K, 4].
        clip: a motion on the source, or None.
    """
    known = target.resting_heights
    own = [flat_foot(source, source_map, references[0], side) for side in SIDES]
    others = [flat_foot(target, target_map, references[1], side) for side in SIDES]
    if known is None:
        return own, others
    heights = source.resting_heights
    if heights is None and clip is not None:
        heights = find_resting_heights(clip, source_map)
    if heights is None:
        return own, others
    return list(map(resting_foot, own, heights)), list(map(resting_foot, others, known))


def stance_frames(fps: float) -> int:
    """Returns the odd number of frames around each within which a foot stands."""
    return 2 * int(np.ceil(STANCE_SECONDS * fps / 2)) + 1


def _source_reference(skeleton: Skeleton, body: HumanoidMap, clip: MotionClip | None) -> np.ndarray:
    """Returns the reference pose [J, 4] of a skeleton, from a motion on it where nothing else shows it."""
    if skeleton.poses is None and clip is not None:
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


def _carriers(skeleton: Skeleton, body: HumanoidMap, known: set[int]) -> np.ndarray:
    """Returns the joint [J] in `known` with which each turns: itself, or the next above; a root above the hips with
    these."""
    carriers = np.arange(skeleton.num_joints)
    for joint, parent in enumerate(skeleton.parents):
        if joint not in known:
            carriers[joint] = carriers[parent] if parent >= 0 else body.hips
    return carriers


def _root_of(skeleton: Skeleton, joint: int, position: np.ndarray, world: np.ndarray) -> np.ndarray:
    """Returns the root positions [T, 3] with which a joint is at positions [T, 3], at world rotations [T, J, 4]."""
    while (parent := int(skeleton.parents[joint])) >= 0:
        position = position - quat_rotate(world[:, parent], skeleton.offsets[joint])
        joint = parent
    return position


def _local(skeleton: Skeleton, world: np.ndarray) -> np.ndarray:
    """Returns the local rotations [T, J, 4] of world rotations [T, J, 4]."""
    above = np.maximum(skeleton.parents, 0)
    local = quat_multiply(quat_conjugate(world[:, above]), world)
    local[:, 0] = world[:, 0]
    return local
