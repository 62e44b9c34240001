"""Rotations as unit quaternions [..., 4] in wxyz order. A product `multiply(a, b)` applies b first."""

import numpy as np


def cross(a, b):
    """Returns the cross product [..., 3]; NumPy's own is many times slower on single vectors."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]


def multiply(a, b):
    """Returns the rotation b followed by the rotation a."""
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    w = aw * bw - (av * bv).sum(-1, keepdims=True)
    return np.concatenate([w, aw * bv + bw * av + cross(av, bv)], -1)


def conjugate(q):
    """Returns the inverse rotation."""
    return q * [1.0, -1.0, -1.0, -1.0]


def rotate(q, v):
    """Rotates vectors v [..., 3]."""
    across = 2.0 * cross(q[..., 1:], v)
    return v + q[..., :1] * across + cross(q[..., 1:], across)


def normalise(q):
    """Returns q at length 1."""
    return q / np.maximum(np.linalg.norm(q, axis=-1, keepdims=True), 1e-12)


def about(axis, angle):
    """Returns the rotation by an angle [...] in radians about a unit axis [..., 3]."""
    half = np.asarray(angle)[..., None] / 2
    return np.concatenate([np.cos(half), np.sin(half) * axis], -1)


def about_vertical(facing):
    """Returns the rotation about +Y that takes +Z to a facing, a complex unit number z + ix."""
    return about(np.array([0.0, 1.0, 0.0]), np.angle(facing))


def between(u, v):
    """Returns the shortest rotation from the direction of u [..., 3] to that of v [..., 3]."""
    u, v = (w / np.maximum(np.linalg.norm(w, axis=-1, keepdims=True), 1e-12) for w in (u, v))
    along = (u * v).sum(-1, keepdims=True)
    turn = np.concatenate([1.0 + along, cross(u, v)], -1)
    other = np.where(abs(u[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    half_turn = np.concatenate([0.0 * along, cross(u, other)], -1)
    return normalise(np.where(along < -1.0 + 1e-9, half_turn, turn))


def from_half_angles(v):
    """Returns the rotations of vectors [..., 3], each an axis times half the angle."""
    half = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.concatenate([np.cos(half), v * np.sinc(half / np.pi)], -1)


def from_axes(forward, up):
    """Returns the rotations whose +Z is `forward` and whose +Y is `up`, which are unit and perpendicular [..., 3]."""
    m = np.stack([cross(up, forward), up, forward], -1)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    rows = [  # row n is 4 q_n q; the longest row is free of cancellation
        np.stack([1 + xx + yy + zz, wx, wy, wz], -1),
        np.stack([wx, 1 + xx - yy - zz, xy, xz], -1),
        np.stack([wy, xy, 1 - xx + yy - zz, yz], -1),
        np.stack([wz, xz, yz, 1 - xx - yy + zz], -1),
    ]
    rows = np.stack(rows, -2)
    longest = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), -1)
    return normalise(np.take_along_axis(rows, longest[..., None, None], -2)[..., 0, :])


def mix_rotations(old, new, share):
    """Interpolates rotations that are near each other."""
    new = np.where((old * new).sum(-1, keepdims=True) >= 0.0, new, -new)
    return normalise(old + share * (new - old))
