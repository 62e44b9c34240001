"""Work for other processes, which import this file and little else."""

from __future__ import annotations

import sys

from pfnn_jax.errors import InputError


def invert(value: int) -> float:
    """1 / value; refuses even numbers, fails at 9, ends the process at 13."""
    if value == 9:
        raise KeyError(value)
    if value == 13:
        sys.exit(5)
    if value % 2 == 0:
        raise InputError("numbers", "value", value, "must be odd")
    print("not an answer")
    return 1 / value
