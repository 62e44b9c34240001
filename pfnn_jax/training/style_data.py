"""The frames of one style's clips as few-shot training reads them: normalised, the end of each clip held out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.features import Features
from pfnn_jax.motion.normaliser import Normaliser
from pfnn_jax.training.batches import Batch


def to_batch(parts: Sequence[Features], normaliser: Normaliser) -> Batch:
    """All rows [N, ...] of the parts, one after another, normalised float32."""
    return Batch(
        x=normaliser.inputs.apply(np.concatenate([part.x for part in parts])).astype(np.float32),
        y=normaliser.outputs.apply(np.concatenate([part.y for part in parts])).astype(np.float32),
        phase=np.concatenate([part.phase for part in parts]).astype(np.float32),
    )


def hold_out(parts: Sequence[Features], share: float, source: str = "clip") -> tuple[list[Features], list[Features]]:
    """Each part cut in time: its first rows to learn from, its last `share` of rows to choose by.

    Neighbouring frames are almost equal, so frames held out at random would measure memory.

    Raises:
        InputError: if a part is too short to leave rows on both sides.
    """
    learn, choose = [], []
    for part in parts:
        count = round(len(part.x) * (1 - share))
        if not 0 < count < len(part.x):
            raise InputError(source, "frames", len(part.x), f"holding out {share:g} must leave some on each side")
        learn.append(_rows(part, slice(0, count)))
        choose.append(_rows(part, slice(count, None)))
    return learn, choose


def first_rows(part: Features, count: int) -> Features:
    """The first `count` rows of a part."""
    return _rows(part, slice(0, count))


def _rows(part: Features, rows: slice) -> Features:
    return Features(part.x[rows], part.y[rows], part.phase[rows], part.frames[rows])
