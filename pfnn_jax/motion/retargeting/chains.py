"""Distributes the bending of a chain of joints, such as a spine, over a chain of another length."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.kinematics import quat_slerp

BEND_AT_BASE = 0.6
"""Exponent of a joint's place between two others: spines and necks bend more at their base, so half of the way up they
have done two thirds of the bend (as measured on spines of three joints from five sources)."""


def resample_chain(turns: np.ndarray, count: int, *, lower: bool = False) -> np.ndarray:
    """Returns the rotations of the joints of a chain with another number of joints.

    Each joint of the shorter chain has a counterpart in the longer one, spread evenly and the last with the last; both
    turn alike. The other joints of a longer chain are interpolated between counterparts along the shorter arc, so that
    a longer chain holds all that a shorter one does, and the way back is exact.

    Args:
        turns: [T, 1 + n, 4] world rotations from the reference pose, of the joint that carries the chain and of its n
            joints.
        count: joints m of the other chain.
        lower: whether, of two joints that are equally near, the lower is the counterpart; necks bend most at the base.

    Returns:
        [T, m, 4].
    """
    last = turns.shape[1] - 1
    if last == 0 or count == 0:
        return np.repeat(turns[:, :1], count, axis=1)
    if count <= last:
        return turns[:, _counterparts(count, last, lower)[1:]]
    places = np.interp(np.arange(1, count + 1), _counterparts(last, count, lower), np.arange(last + 1))
    before = np.minimum(places.astype(int), last - 1)
    share = places - before
    between = quat_slerp(turns[:, before], turns[:, before + 1], share**BEND_AT_BASE)
    exact = np.rint(places).astype(int)
    return np.where((share % 1.0 == 0)[:, None], turns[:, exact], between)


def _counterparts(shorter: int, longer: int, lower: bool) -> np.ndarray:
    """Returns the joints [1 + n] of the longer chain that are the counterparts of 0, 1 ... n in the shorter one."""
    places = np.arange(shorter + 1) * longer / shorter
    return (np.ceil(places - 0.5) if lower else np.floor(places + 0.5)).astype(int)
