"""Rows as training reads them: normalised, style after style, or the two ends of one style's clip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.features import Features, join_rows, select_rows
from pfnn_jax.motion.frame_layout import FrameLayout
from pfnn_jax.motion.normaliser import Normaliser
from pfnn_jax.training.batches import Batch, StyleData, cut_windows


def to_batch(parts: Sequence[Features], normaliser: Normaliser) -> Batch:
    """All rows [N, ...] of the parts, one after another, normalised float32."""
    rows = join_rows(parts)
    return normalised(rows.x, rows.y, rows.phase, normaliser)


def normalised(x: np.ndarray, y: np.ndarray, phase: np.ndarray, normaliser: Normaliser) -> Batch:
    """Rows in layout units as float32 that a network reads; a scalar phase stays in radians."""
    if normaliser.phases is not None:
        phase = normaliser.phases.apply(phase)
    rows = normaliser.inputs.apply(x), normaliser.outputs.apply(y), phase
    return Batch(*(np.asarray(values, np.float32) for values in rows))


def style_data(
    styles: Mapping[str, Sequence[Features]],
    layout: FrameLayout,
    normaliser: Normaliser,
    parents: Sequence[int] | np.ndarray | None = None,
) -> StyleData:
    """Training data in memory from the rows of clips.

    Args:
        styles: name -> the clips of that style.
        layout: of the rows.
        normaliser: of all styles.
        parents: [J] of the skeleton, for the bone-length loss.
    """
    batches = [to_batch(clips, normaliser) for clips in styles.values()]
    first_row = np.cumsum([0, *(len(batch.x) for batch in batches)])
    windows, row = [], 0
    for clip in (clip for clips in styles.values() for clip in clips):
        ends = np.flatnonzero(np.diff(clip.frames) != 1) + 1  # a clip may miss frames, e.g. unlabelled ones
        for part in np.split(np.arange(row, row + len(clip.x)), ends):
            windows.append(cut_windows(len(part)) + np.array([part[0], 0], np.int32))
        row += len(clip.x)
    return StyleData(
        x=np.concatenate([batch.x for batch in batches]),
        y=np.concatenate([batch.y for batch in batches]),
        phase=np.concatenate([batch.phase for batch in batches]),
        first_row=first_row,
        layout=layout,
        windows=np.concatenate(windows),
        first_window=np.searchsorted(np.concatenate(windows)[:, 0], first_row),
        parents=None if parents is None else np.asarray(parents),
        outputs=normaliser.outputs,
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
