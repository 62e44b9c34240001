"""The frames of one style's clips as few-shot training reads them: normalised, the end of each clip held out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.features import Features, join_rows, select_rows
from pfnn_jax.motion.normaliser import Normaliser
from pfnn_jax.training.batches import Batch


def to_batch(parts: Sequence[Features], normaliser: Normaliser) -> Batch:
    """All rows [N, ...] of the parts, one after another, normalised float32."""
    rows = join_rows(parts)
    return Batch(
        x=normaliser.inputs.apply(rows.x).astype(np.float32),
        y=normaliser.outputs.apply(rows.y).astype(np.float32),
        phase=rows.phase.astype(np.float32),
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
        learn.append(select_rows(part, slice(0, count)))
        choose.append(select_rows(part, slice(count, None)))
    return learn, choose
