"""Points and directions on the ground as complex numbers z + ix, and what interpolates them.

The world is in metres, Y up, +Z forward, +X left. A facing is the unit number e^(i yaw), and a rotation about the
vertical is a product. Whatever stands on the ground needs no matrices then.
"""

import numpy as np


def mix(old, new, share):
    """Interpolates linearly."""
    return old + share * (new - old)


def unit(v):
    """Returns complex numbers, or vectors [..., 3], at length 1."""
    return v / (np.abs(v) if np.iscomplexobj(v) else np.linalg.norm(v, axis=-1, keepdims=True))


def angle(start, end):
    """Returns the angles in radians from directions, of any length, to others."""
    return np.angle(end * np.conj(start))


def turn_towards(facing, target, share):
    """Turns facings by a share of their angle to a target, the shorter way round."""
    return facing * np.exp(1j * share * angle(facing, target))


def to_world(vectors, facing, point: complex | np.ndarray = 0j):
    """Rotates vectors [J, 3] from the frame of a root into the world, then moves them along the ground."""
    ground = (vectors[:, 2] + 1j * vectors[:, 0]) * facing + point
    return np.stack([ground.imag, vectors[:, 1], ground.real], -1)


def to_local(vectors, facing, point: complex | np.ndarray = 0j):
    """Moves vectors [J, 3] on the ground so that `point` becomes the origin, and rotates them into a root's frame."""
    return to_world(vectors, np.conj(facing), -point * np.conj(facing))


def fill(samples):
    """Interpolates samples [M, ...] that are ten frames apart linearly: [10 (M - 1) + 1, ...]."""
    share = np.arange(10).reshape(1, -1, *[1] * (samples.ndim - 1)) / 10
    between = mix(samples[:-1, None], samples[1:, None], share)
    return np.concatenate([between.reshape(-1, *samples.shape[1:]), samples[-1:]])
