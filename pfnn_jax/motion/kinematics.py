"""Rotations as unit quaternions [..., 4] in wxyz order, and forward kinematics, vectorised over leading axes.

A quaternion turns vectors by `v' = q v q*`; a product `a b` applies b first. Right-handed axes, Y up.

All functions take and return NumPy arrays in float64. Those that a character needs at run time (`quat_multiply`,
`quat_conjugate`, `quat_rotate`, `quat_normalise`, `quat_exp`, `quat_between`, `quat_from_axis_angle`,
`quat_from_matrix`, `quat_from_yaw` and `quat_from_forward_up`) also take arrays of another library with the array API
(`__array_namespace__`), such as JAX: they then return arrays of that library, in its precision, and their gradients are
finite everywhere.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pfnn_jax.motion.arrays import SMALL, array_namespace, as_floats, components, cross, join_components, unit
from pfnn_jax.motion.skeleton import Skeleton

AXES = {"X": 0, "Y": 1, "Z": 2}
_IDENTITY = (1.0, 0.0, 0.0, 0.0)


def quat_multiply(a: ArrayLike, b: ArrayLike) -> Any:
    """Returns the Hamilton product [..., 4]: the rotation b followed by the rotation a."""
    xp = array_namespace(a, b)
    aw, ax, ay, az = components(a, xp)
    bw, bx, by, bz = components(b, xp)
    return join_components(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ),
        xp,
    )


def quat_conjugate(q: ArrayLike) -> Any:
    """Returns the inverse rotation [..., 4] of a unit quaternion."""
    xp = array_namespace(q)
    if xp is np:
        return np.asarray(q) * np.array([1.0, -1.0, -1.0, -1.0])
    whole = xp.asarray(q)
    return xp.concatenate((whole[..., :1], -whole[..., 1:]), axis=-1)


def quat_rotate(q: ArrayLike, v: ArrayLike) -> Any:
    """Rotates vectors v [..., 3] by unit quaternions q [..., 4]."""
    xp = array_namespace(q, v)
    w, qx, qy, qz = components(q, xp)
    x, y, z = components(v, xp)
    tx, ty, tz = 2.0 * (qy * z - qz * y), 2.0 * (qz * x - qx * z), 2.0 * (qx * y - qy * x)
    return join_components(
        (x + w * tx + qy * tz - qz * ty, y + w * ty + qz * tx - qx * tz, z + w * tz + qx * ty - qy * tx), xp
    )


def quat_normalise(q: ArrayLike) -> Any:
    """Normalises q [..., 4] to unit length; a zero quaternion becomes the identity."""
    xp, given = as_floats(q)
    squared = xp.sum(given * given, axis=-1, keepdims=True)
    found = squared > SMALL**2
    # zero lengths are replaced before the square root, whose gradient at zero would be infinite
    identity = xp.broadcast_to(xp.asarray(_IDENTITY, dtype=given.dtype), given.shape)
    return xp.where(found, given / xp.sqrt(xp.where(found, squared, 1.0)), identity)


def quat_from_axis_angle(axis: ArrayLike, angle: ArrayLike) -> Any:
    """Returns the rotation [..., 4] by `angle` [...] radians about `axis` [..., 3] of any length (zero: identity)."""
    xp, along, angles = as_floats(axis, angle)
    half = angles[..., None] / 2
    squared = xp.sum(along * along, axis=-1, keepdims=True)
    found = squared > SMALL**2
    v = xp.where(found, xp.sin(half) * along / xp.sqrt(xp.where(found, squared, 1.0)), 0.0)
    w = xp.where(found, xp.cos(half), 1.0)
    return xp.concatenate((xp.broadcast_to(w, v.shape[:-1] + (1,)), v), axis=-1)


def quat_from_euler(angles: ArrayLike, order: str) -> np.ndarray:
    """Returns the rotation [..., 4] of Euler angles in radians, in the order in which a BVH file lists its channels.

    "ZYX" means R = Rz Ry Rx: about fixed axes, the rotation listed last is applied first.

    Args:
        angles: [..., 3], one angle per letter of `order`.
        order: any of the six orders of X, Y and Z.
    """
    half = np.asarray(angles, dtype=float) / 2
    cos, sin = components(np.cos(half)), components(np.sin(half))
    i, j, k = _axes(order)
    parity = _parity(i, j)
    q = np.empty(half.shape[:-1] + (4,))
    c01, s01, cs, sc = cos[0] * cos[1], sin[0] * sin[1], cos[0] * sin[1], sin[0] * cos[1]
    # product of three axis quaternions, with e_i e_j = parity e_k
    q[..., 0] = c01 * cos[2] - parity * s01 * sin[2]
    q[..., 1 + i] = sc * cos[2] + parity * cs * sin[2]
    q[..., 1 + j] = cs * cos[2] - parity * sc * sin[2]
    q[..., 1 + k] = c01 * sin[2] + parity * s01 * cos[2]
    return q


def quat_to_euler(q: ArrayLike, order: str) -> np.ndarray:
    """Returns Euler angles [..., 3] in radians, one per letter of `order`, with `quat_from_euler(angles, order)` = ±q.

    The middle angle lies in [-π/2, π/2]; at its ends (gimbal lock) the last angle is 0.
    """
    i, j, k = _axes(order)
    m = quat_to_matrix(quat_normalise(q))
    parity = _parity(i, j)
    # R = Ri(a) Rj(b) Rk(c): its entry [i, k] is ±sin b, its row i holds cos b (cos c, sin c), its column k cos b cos a
    sin_b, cos_b = parity * m[..., i, k], np.hypot(m[..., i, i], m[..., i, j])
    b = np.arctan2(sin_b, cos_b)
    locked = cos_b < 1e-7
    a = np.arctan2(-parity * m[..., j, k], m[..., k, k])
    c = np.arctan2(-parity * m[..., i, j], m[..., i, i])
    a_locked = np.arctan2(parity * m[..., k, j], m[..., j, j])
    return np.stack((np.where(locked, a_locked, a), b, np.where(locked, 0.0, c)), axis=-1)


def quat_to_matrix(q: ArrayLike) -> np.ndarray:
    """Returns the rotation matrices [..., 3, 3] of unit quaternions q [..., 4]."""
    w, x, y, z = components(q)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quat_from_matrix(m: ArrayLike) -> Any:
    """Returns the unit quaternions [..., 4] with w ≥ 0 of rotation matrices m [..., 3, 3]."""
    xp, r = as_floats(m)
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    wx, wy, wz = r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]
    xy, xz, yz = r[..., 0, 1] + r[..., 1, 0], r[..., 0, 2] + r[..., 2, 0], r[..., 1, 2] + r[..., 2, 1]
    # row n is 4 q_n q; the longest row is free of cancellation
    rows = xp.stack(
        [
            xp.stack((1 + xx + yy + zz, wx, wy, wz), axis=-1),
            xp.stack((wx, 1 + xx - yy - zz, xy, xz), axis=-1),
            xp.stack((wy, xy, 1 - xx + yy - zz, yz), axis=-1),
            xp.stack((wz, xz, yz, 1 - xx - yy + zz), axis=-1),
        ],
        axis=-2,
    )
    best = xp.argmax(xp.diagonal(rows, axis1=-2, axis2=-1), axis=-1)
    q = quat_normalise(xp.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :])
    return xp.where(q[..., :1] < 0, -q, q)


def quat_log(q: ArrayLike) -> np.ndarray:
    """Returns the logarithm [..., 3] of unit quaternions: axis times half the angle, after a change of sign to w ≥ 0.

    Source: joint rotations in the released layout of Holden et al. 2017.
    """
    q = np.asarray(q, dtype=float)
    q = np.where(q[..., :1] < 0, -q, q)
    sin = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    # near the identity half/sin(half) is 1 to second order
    scale = np.where(sin > 1e-8, np.arctan2(sin, q[..., :1]) / np.maximum(sin, 1e-8), 1.0)
    return q[..., 1:] * scale


def quat_exp(v: ArrayLike) -> Any:
    """Returns unit quaternions [..., 4] of half-angle vectors v [..., 3]; the inverse of `quat_log`."""
    xp, along = as_floats(v)
    squared = xp.sum(along * along, axis=-1, keepdims=True)
    found = squared > SMALL**2
    half = xp.sqrt(xp.where(found, squared, 1.0))
    w, scale = xp.where(found, xp.cos(half), 1.0), xp.where(found, xp.sin(half) / half, 1.0)
    return xp.concatenate((w, along * scale), axis=-1)


def quat_align(rotations: np.ndarray) -> np.ndarray:
    """Returns quaternions [T, ..., 4] with signs such that each is nearer to the one before than its negative is."""
    dots = np.sum(rotations[1:] * rotations[:-1], axis=-1)
    signs = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    return np.concatenate([rotations[:1], rotations[1:] * signs[..., None]])


def quat_slerp(a: ArrayLike, b: ArrayLike, t: ArrayLike) -> np.ndarray:
    """Returns the rotation [..., 4] at fraction t [...] of the shorter great arc from a to b (unit, [..., 4])."""
    a, b, t = np.asarray(a, dtype=float), np.asarray(b, dtype=float), np.asarray(t, dtype=float)[..., None]
    dot = np.sum(a * b, axis=-1, keepdims=True)
    sign = np.where(dot < 0, -1.0, 1.0)
    angle = np.arccos(np.clip(dot * sign, 0.0, 1.0))
    sin = np.sin(angle)
    near = sin < 1e-6  # short arcs equal their chords
    safe = np.where(near, 1.0, sin)
    wa = np.where(near, 1.0 - t, np.sin((1.0 - t) * angle) / safe)
    wb = np.where(near, t, np.sin(t * angle) / safe)
    return quat_normalise(wa * a + wb * sign * b)


def quat_between(u: ArrayLike, v: ArrayLike) -> Any:
    """Returns the shortest rotation [..., 4] from the direction of u [..., 3] to that of v [..., 3].

    For opposite directions this is a half turn about some axis perpendicular to u; zero vectors give the identity.
    """
    xp, *given = as_floats(u, v)
    start, end = xp.broadcast_arrays(*(unit(each) for each in given))
    dot = xp.sum(start * end, axis=-1, keepdims=True)
    opposite = dot < -1.0 + (1e-9 if start.dtype == np.float64 else 1e-6)
    q = xp.concatenate((1.0 + dot, cross(start, end)), axis=-1)
    x, y = (xp.broadcast_to(xp.asarray(axis, dtype=start.dtype), start.shape) for axis in np.eye(3)[:2])
    away = xp.where(xp.abs(start[..., :1]) < 0.9, x, y)
    half_turn = xp.concatenate((xp.zeros_like(dot), cross(start, away)), axis=-1)
    return quat_normalise(xp.where(opposite, half_turn, q))


def quat_from_yaw(yaw: ArrayLike) -> Any:
    """Returns the rotation [..., 4] by yaw [...] radians about +Y, which takes +Z to (sin yaw, 0, cos yaw)."""
    xp, angle = as_floats(yaw)
    half = angle / 2
    zero = xp.zeros_like(half)
    return xp.stack((xp.cos(half), zero, xp.sin(half), zero), axis=-1)


def quat_from_forward_up(forward: ArrayLike, up: ArrayLike) -> Any:
    """Returns the rotation [..., 4] whose +Z is along `forward` [..., 3] and whose +Y is `up` [..., 3], orthogonalised.

    They need be neither unit nor orthogonal, as a network's outputs are not; `forward` keeps its direction.
    """
    xp, along, upward = as_floats(forward, up)
    z = unit(along)
    x = unit(cross(upward, z))
    return quat_from_matrix(xp.stack((x, cross(z, x), z), axis=-1))


def forward_kinematics(
    skeleton: Skeleton, root_positions: np.ndarray, rotations: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Computes world positions and rotations of all joints.

    Args:
        skeleton: J joints.
        root_positions: [T, 3] metres, position of joint 0.
        rotations: [T, J, 4] local rotations.

    Returns:
        (positions [T, J, 3] metres, world rotations [T, J, 4]).
    """
    rotations = np.asarray(rotations)
    positions, world = np.empty(rotations.shape[:-1] + (3,)), np.empty(rotations.shape)
    offsets = skeleton.offsets
    positions[:, 0], world[:, 0] = root_positions, rotations[:, 0]
    for joints, above in joint_levels(tuple(skeleton.parents.tolist())):
        turn = world[:, above]
        positions[:, joints] = positions[:, above] + quat_rotate(turn, offsets[joints])
        world[:, joints] = quat_multiply(turn, rotations[:, joints])
    return positions, world


def positions_of(
    joints: list[int], skeleton: Skeleton, root_positions: np.ndarray, rotations: np.ndarray
) -> np.ndarray:
    """Computes world positions [T, n, 3] of n joints without posing others than those above them.

    Args:
        joints: indices.
        skeleton: J joints.
        root_positions: [T, 3] metres, position of joint 0.
        rotations: [T, J, 4] local rotations.
    """
    above = set(joints) | {0}
    for joint in range(skeleton.num_joints - 1, 0, -1):  # parents come before their children
        if joint in above:
            above.add(int(skeleton.parents[joint]))
    kept = sorted(above)
    place = {joint: index for index, joint in enumerate(kept)}
    parents = np.array([place.get(int(skeleton.parents[joint]), -1) for joint in kept])
    names = tuple(skeleton.names[joint] for joint in kept)
    part = Skeleton(names, parents, skeleton.offsets[kept], (), np.arange(len(kept)))
    positions, _ = forward_kinematics(part, root_positions, rotations[:, kept])
    return positions[:, [place[joint] for joint in joints]]


def joint_positions(skeleton: Skeleton, rotations: np.ndarray) -> np.ndarray:
    """Returns the positions [T, J, 3] of all joints relative to joint 0, for few frames faster than with rotations.

    Args:
        skeleton: J joints.
        rotations: [T, J, 4] local rotations.
    """
    local = quat_to_matrix(rotations)
    positions, world = np.zeros(rotations.shape[:-1] + (3,)), local.copy()
    for joints, above in joint_levels(tuple(skeleton.parents.tolist())):
        turn = world[:, above]
        positions[:, joints] = positions[:, above] + (turn @ skeleton.offsets[joints, :, None])[..., 0]
        world[:, joints] = turn @ local[:, joints]
    return positions


@functools.lru_cache(maxsize=64)
def joint_levels(parents: tuple[int, ...]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Returns the joints of each depth below the root, ascending, and their parents: they are posed at once."""
    depth = np.zeros(len(parents), dtype=int)
    for joint, parent in enumerate(parents[1:], start=1):
        depth[joint] = depth[parent] + 1
    levels = (np.flatnonzero(depth == level) for level in range(1, int(depth.max()) + 1))
    return [(joints, np.array(parents)[joints]) for joints in levels]


def _parity(i: int, j: int) -> float:
    """Returns +1 if the axes i, j and the third are a cyclic permutation of X, Y, Z, otherwise -1."""
    return 1.0 if j == (i + 1) % 3 else -1.0


def _axes(order: str) -> tuple[int, int, int]:
    """Returns the indices of the three axes of an Euler order.

    Raises:
        ValueError: unless `order` names X, Y and Z once each.
    """
    if sorted(order) != ["X", "Y", "Z"]:
        raise ValueError(f"order must name X, Y and Z once each, got {order!r}.")
    return AXES[order[0]], AXES[order[1]], AXES[order[2]]
