"""Joint rotations of a body with rigid bones, from positions of its points that need not fit any bones.

From the hips outwards every joint is turned so that its bones point as the positions do. Where several bones leave a
joint, at hips and chest, its rotation is their least-squares fit (Kabsch 1976). A thigh or upper arm is also turned
about itself, into the plane in which its limb bends. What positions cannot show is kept from an initial motion: the
twist of other bones and of straight limbs, the orientation of the head on its neck, the roll of feet, and joints that
carry no point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pfnn_jax.motion.arrays import unit
from pfnn_jax.motion.body_points import POINT_NAMES, POINT_PARENTS, BodyPoints
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.filters import gaussian_filter, moving_minimum
from pfnn_jax.motion.humanoid.map import SIDES
from pfnn_jax.motion.humanoid.tree import joint_tree
from pfnn_jax.motion.kinematics import (
    forward_kinematics,
    quat_between,
    quat_conjugate,
    quat_from_axis_angle,
    quat_from_matrix,
    quat_multiply,
    quat_rotate,
)
from pfnn_jax.motion.labels.phase import runs_of
from pfnn_jax.motion.roles import chain_up
from pfnn_jax.motion.skeleton import Skeleton

PELVIS = [POINT_NAMES.index(name) for name in ("hips", "left_thigh", "right_thigh", "spine")]
"""Points whose mean places the pelvis, so that the noise of one of them matters less."""

STRAIGHT, BENT = 0.17, 0.5
"""Sine of a limb's bend (10 and 30 degrees) up to which its plane says nothing, and from which on it decides."""

MOST_ROLL = np.deg2rad(120.0)
"""Radians by which a limb turns about itself; no shoulder or hip does so by more."""

FAR = np.deg2rad(120.0)
"""Radians beyond which the shortest arc between directions says little: at half a turn every way is as short."""

NEAR_FAR_SECONDS = 0.15
"""Time before and after such frames over which a rotation passes from one shortest arc to another."""

ROLL_SECONDS = 0.05
"""Standard deviation of the Gaussian over that turn: the plane of a limb that is hardly bent is uncertain."""

FLEXIBLE = ("spine", "chest", "neck", "left_upper_arm", "right_upper_arm")
"""Points that a joint between them and the one above, such as a clavicle, may move; thighs are rigid in the pelvis."""

LIMBS = {
    f"{side}_{first}": tuple(POINT_NAMES.index(f"{side}_{part}") for part in (first, *others))
    for side in SIDES
    for first, *others in (("thigh", "shin", "foot"), ("upper_arm", "lower_arm", "hand"))
}
"""Points (root, middle, end) of each limb that bends in a plane, by the name of its root."""

LEVEL = ("left_foot", "right_foot")
"""Points whose joints keep their roll in the world: a foot stands flat however its shin leans."""

BACKWARD = 0.03
"""Metres by which a knee behind the line from hip to ankle is half reflected to the front."""

MOST_WRIST = np.deg2rad(80.0)
"""Radians by which a wrist bends, unless the initial motion's bends by more."""

Points = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class _Body:
    """An initial motion, and what of it has been turned so far.

    Attributes:
        skeleton: J joints.
        points: where the points are.
        local, world: [T, J, 4] rotations of the initial motion.
        joints: [T, J, 3] its joints in metres.
        own: [T, 21, 3] its points.
        fps: its frames per second.
        turned: [T, J, 4] new world rotations.
        places: [T, J, 3] new positions in metres, relative to joint 0.
    """

    skeleton: Skeleton
    points: BodyPoints
    local: np.ndarray
    world: np.ndarray
    joints: np.ndarray
    own: np.ndarray
    fps: float
    turned: np.ndarray
    places: np.ndarray

    def carry(self, joint: int) -> None:
        """Moves a joint with its parent."""
        parent = int(self.skeleton.parents[joint])
        if parent < 0:
            self.turned[:, joint], self.places[:, joint] = self.world[:, joint], 0.0
            return
        above = self.turned[:, parent]
        self.turned[:, joint] = quat_multiply(above, self.local[:, joint])
        self.places[:, joint] = self.places[:, parent] + quat_rotate(above, self.skeleton.offsets[joint])

    def aim(self, joint: int, aimed: Points, positions: np.ndarray) -> None:
        """Turns a joint so that these points lie in the directions that positions [T, 21, 3] give them."""
        world = self.world[:, joint]
        change = quat_multiply(self.turned[:, joint], quat_conjugate(world))
        if self._is_level(joint):
            change = np.broadcast_to((1.0, 0.0, 0.0, 0.0), world.shape)
        have = quat_rotate(change[:, None], self.own[:, list(aimed)] - self.joints[:, [joint]])
        want = np.stack([self._wanted(joint, point, positions) for point in aimed], axis=1)
        change = quat_multiply(best_rotation(have, want, round(NEAR_FAR_SECONDS * self.fps)), change)
        for limb in LIMBS.values():
            if aimed == (limb[1],) and self.points.joints[limb[0]] == joint:
                change = quat_multiply(self._roll(joint, limb, change, positions), change)
        self.turned[:, joint] = quat_multiply(change, world)

    def _wanted(self, joint: int, point: int, positions: np.ndarray) -> np.ndarray:
        """Returns the vector [T, 3] from a joint, where it is now, to a point."""
        above = POINT_PARENTS[point]
        carrier, offset = int(self.points.joints[above]), self.points.offsets[above]
        start = self.places[:, carrier]
        if offset.any():
            start = start + quat_rotate(self.turned[:, carrier], offset)
        return positions[:, point] - positions[:, above] - (self.places[:, joint] - start)

    def _roll(self, joint: int, limb: Points, change: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Returns the rotations [T, 4] about a limb's first bone into the plane in which the limb bends.

        Args:
            joint: at the root of the limb.
            limb: its points.
            change: [T, 4] by which the joint has been turned in the world.
            positions: [T, 21, 3] metres.
        """
        root, middle, end = limb
        bones = np.stack([self.own[:, middle] - self.joints[:, joint], self.own[:, end] - self.own[:, middle]], axis=1)
        upper, lower = quat_rotate(change[:, None], bones).swapaxes(0, 1)
        own, bent = _plane(upper, lower)
        plane, wanted = _plane(positions[:, middle] - positions[:, root], positions[:, end] - positions[:, middle])
        share = np.clip((np.minimum(bent, wanted) - STRAIGHT) / (BENT - STRAIGHT), 0.0, 1.0)
        share = share * share * (3.0 - 2.0 * share)
        along = unit(upper)
        angle = np.arctan2(np.sum(np.cross(own, plane) * along, axis=-1), np.sum(own * plane, axis=-1))
        return quat_from_axis_angle(along, gaussian_filter(share * limit_roll(angle), ROLL_SECONDS * self.fps))

    def _is_level(self, joint: int) -> bool:
        return any(self.points.joints[POINT_NAMES.index(name)] == joint for name in LEVEL)


def rotations_from_positions(
    skeleton: Skeleton, points: BodyPoints, positions: np.ndarray, initial: MotionClip
) -> MotionClip:
    """Returns the clip on rigid bones whose points lie as given positions do.

    The positions of the initial motion's own points give back the initial motion.

    Args:
        skeleton: J joints.
        points: where its points are (`find_body_points`).
        positions: [T, 21, 3] metres in the world.
        initial: T frames on the skeleton, facing as the positions do. It decides what positions do not show.
    """
    joints, world = forward_kinematics(skeleton, initial.root_positions, initial.rotations)
    own = points.positions(joints, world)
    body = _Body(
        skeleton, points, initial.rotations, world, joints, own, initial.fps, world.copy(), joints - joints[:, :1]
    )
    positions, aims = limit_wrists(bend_knees_forward(positions, own), own), _aims(skeleton, points)
    for joint in range(skeleton.num_joints):
        body.carry(joint)
        if joint in aims:
            body.aim(joint, aims[joint], positions)
    _share_twist(body)
    pelvis = points.positions(body.places, body.turned)[:, PELVIS].mean(axis=1)
    local = body.turned.copy()
    local[:, 1:] = quat_multiply(quat_conjugate(body.turned[:, skeleton.parents[1:]]), body.turned[:, 1:])
    local = np.where(np.sum(local * initial.rotations, axis=-1, keepdims=True) < 0, -local, local)
    return replace(initial, root_positions=positions[:, PELVIS].mean(axis=1) - pelvis, rotations=local)


def limit_roll(angle: np.ndarray) -> np.ndarray:
    """Returns angles [T] in radians about a limb, reduced beyond `MOST_ROLL` to reach 0 at half a turn.

    A limb that seems to bend to the other side, as an elbow that a network has overstretched, does not turn about
    itself for that; and as half a turn to the left is one to the right, any other rule would jump there.
    """
    return np.sign(angle) * np.minimum(np.abs(angle), MOST_ROLL * (np.pi - np.abs(angle)) / (np.pi - MOST_ROLL))


def bend_knees_forward(positions: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Returns positions with knees that are bent backwards reflected to the front of the line from hip to ankle.

    A network can place knees there; a thigh that followed would turn about itself by half a turn.

    Args:
        positions: [T, 21, 3] metres.
        own: [T, 21, 3] metres, of a motion whose knees may be as far back as they are.
    """
    left = [points[:, LIMBS["left_thigh"][0]] - points[:, LIMBS["right_thigh"][0]] for points in (positions, own)]
    positions = positions.copy()
    for limb in (LIMBS["left_thigh"], LIMBS["right_thigh"]):
        ahead, forward = _ahead(positions, limb, left[0])
        excess = ahead - np.minimum(_ahead(own, limb, left[1])[0], 0.0)
        reflected = excess**2 / (np.abs(excess) + BACKWARD)
        positions[:, limb[1]] += np.where(excess < 0, reflected - excess, 0.0)[:, None] * forward
    return positions


def limit_wrists(positions: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Returns positions with hands that do not fold back onto their forearms, as a network can place them.

    Beyond `MOST_WRIST` the bend is reduced, to reach 0 where hand and forearm are opposite: as no side is the right
    one there, any other rule would jump.

    Args:
        positions: [T, 21, 3] metres.
        own: [T, 21, 3] metres, of a motion whose wrists may be bent by as much as they are.
    """
    positions = positions.copy()
    for side in SIDES:
        elbow, wrist, end = (POINT_NAMES.index(f"{side}_{part}") for part in ("lower_arm", "hand", "hand_end"))
        (arm, hand), bones = (
            (points[:, wrist] - points[:, elbow], points[:, end] - points[:, wrist]) for points in (positions, own)
        )
        angle, most = angle_between(arm, hand), np.clip(angle_between(*bones), MOST_WRIST, 0.97 * np.pi)
        limited = np.minimum(angle, most * (np.pi - angle) / (np.pi - most))
        axis = unit(np.cross(hand, arm))
        turned = quat_rotate(quat_from_axis_angle(axis, angle - limited), hand)
        opposite = np.linalg.norm(axis, axis=-1) < 0.5
        straight = unit(arm) * np.linalg.norm(hand, axis=-1, keepdims=True)
        turned = np.where((opposite & (angle > most))[:, None], straight, turned)
        positions[:, end] = positions[:, wrist] + np.where((angle > most)[:, None], turned, hand)
    return positions


def angle_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Returns the angles [T] in radians between vectors [T, 3], 0 where one of both is zero."""
    return np.arctan2(np.linalg.norm(np.cross(first, second), axis=-1), np.sum(first * second, axis=-1))


def _ahead(points: np.ndarray, limb: Points, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the metres [T] by which a knee is in front of its leg, and the direction [T, 3] that is the front."""
    hip, knee, ankle = (points[:, point] for point in limb)
    forward = np.cross(unit(ankle - hip), unit(left))
    return np.sum((knee - hip) * forward, axis=-1), forward


def best_rotation(have: np.ndarray, want: np.ndarray, reach: int = 0) -> np.ndarray:
    """Returns the rotations [T, 4] that turn N vectors [T, N, 3] towards others: the least-squares fit (Kabsch 1976).

    For a single vector it is that of `steady_arcs`, within `reach` frames.
    """
    if have.shape[1] == 1:
        return steady_arcs(have[:, 0], want[:, 0], reach)
    left, _, right = np.linalg.svd(want.swapaxes(1, 2) @ have)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return quat_from_matrix(left @ right)


def steady_arcs(have: np.ndarray, want: np.ndarray, reach: int = 0) -> np.ndarray:
    """Returns the rotations [T, 4] of vectors [T, 3] to others by the shortest arc, without jumps at half a turn.

    Within some frames (`reach`) of where both directions are farther apart than `FAR`, each frame's rotation follows
    from that of its neighbour by the shortest arc, and what is then missing at the other end is a turn about the vector
    that grows evenly on the way.
    The rotation is the identity where one of both vectors is zero.
    """
    arcs = quat_between(have, want)
    far = angle_between(have, want) > FAR
    far = moving_minimum(-far.astype(float), 2 * reach + 1) < 0
    for start, stop in runs_of(far):
        if start > 0:
            _follow(arcs, have, want, range(start, stop), 1)
        elif stop < len(far):
            _follow(arcs, have, want, range(stop - 1, start - 1, -1), -1)
        else:
            _follow(arcs, have, want, range(1, len(far)), 1)
        if 0 < start and stop < len(far):
            last = quat_multiply(quat_between(quat_rotate(arcs[stop - 1], have[stop]), want[stop]), arcs[stop - 1])
            missing = quat_multiply(arcs[stop], quat_conjugate(last))
            axis = unit(want[stop])
            angle = 2 * np.arctan2(missing[1:] @ axis, missing[0])
            angle = (angle + np.pi) % (2 * np.pi) - np.pi  # the shorter way round
            share = np.arange(1, stop - start + 1) / (stop - start + 1)
            arcs[start:stop] = quat_multiply(
                quat_from_axis_angle(unit(want[start:stop]), share * angle), arcs[start:stop]
            )
    return arcs


def _follow(arcs: np.ndarray, have: np.ndarray, want: np.ndarray, frames: range, step: int) -> None:
    """Sets the rotations [T, 4] of frames, in turn, to the nearest to that of the frame before."""
    for frame in frames:
        before = arcs[frame - step]
        arcs[frame] = quat_multiply(quat_between(quat_rotate(before, have[frame]), want[frame]), before)


def _aims(skeleton: Skeleton, points: BodyPoints) -> dict[int, Points]:
    """Returns joint -> points that it is turned towards."""
    aims: dict[int, Points] = {}
    for point, above in enumerate(POINT_PARENTS):
        if above < 0:
            continue
        end = int(points.joints[point])
        start = joint_tree(tuple(skeleton.parents.tolist())).fork((int(points.joints[above]), end))
        chain = chain_up(skeleton.parents, end)
        between = chain[: chain.index(start)][::-1]
        if end in between and not points.offsets[point].any():
            between.remove(end)
        first = POINT_NAMES[point] in FLEXIBLE and between
        for joint in {start, between[0]} if first else {start}:
            aims[joint] = (*aims.get(joint, ()), point)
    return aims


def _share_twist(body: _Body) -> None:
    """Gives the spine half of the twist between pelvis and chest, where the chest hangs from it."""
    spine, chest = (int(body.points.joints[POINT_NAMES.index(name)]) for name in ("spine", "chest"))
    if body.skeleton.parents[chest] != spine:
        return
    axis = unit(body.places[:, chest] - body.places[:, spine])
    changes = [quat_multiply(body.turned[:, j], quat_conjugate(body.world[:, j])) for j in (spine, chest)]
    between = quat_multiply(changes[1], quat_conjugate(changes[0]))
    half = np.arctan2(np.sum(between[:, 1:] * axis, axis=-1), between[:, 0])
    half = (half + np.pi / 2) % np.pi - np.pi / 2  # the shorter way round
    body.turned[:, spine] = quat_multiply(quat_from_axis_angle(axis, half), body.turned[:, spine])


def _plane(upper: np.ndarray, lower: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the unit normal [T, 3] of the plane of two bones, or zero, and the sine [T] of their angle."""
    normal = np.cross(upper, lower)
    lengths = np.linalg.norm(upper, axis=-1) * np.linalg.norm(lower, axis=-1)
    return unit(normal), np.linalg.norm(normal, axis=-1) / np.maximum(lengths, 1e-12)
