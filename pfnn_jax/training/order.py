"""The order of training: which rows and clips each step sees, a pure function of the seed and the step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from pfnn_jax.training.data import Draw, Rows

_ROWS, _CLIPS = 0, 1  # streams of random numbers, so that clips are drawn independently of the frames


@dataclass(frozen=True, eq=False)
class StepOrder:
    """The minibatches of a training run.

    Step i belongs to style i mod S. Every style goes through its own shuffled passes, of as many minibatches as its
    rows fill; a last incomplete one is dropped, with other rows in each pass. A pass of the shortest style is an epoch.

    Attributes:
        first_row: [S+1] first row of every style.
        batch_size: B.
        seed: of all passes.
        num_clips: C clips drawn for a step, with repetition; 0 for none.
        windows, first_window: as in `Rows`; needed for clips.
    """

    first_row: np.ndarray
    batch_size: int
    seed: int
    num_clips: int = 0
    windows: np.ndarray | None = None
    first_window: np.ndarray | None = None

    def __post_init__(self):
        counts = np.diff(self.first_row)
        if counts.min() < self.batch_size:
            raise ValueError(f"`batch_size` must be at most the {counts.min()} rows of a style, got {self.batch_size}.")
        if self.num_clips and (self.windows is None or self.first_window is None):
            raise ValueError("`windows` are needed where clips are drawn, got None.")
        if self.num_clips and self.first_window is not None and np.diff(self.first_window).min() < 1:
            raise ValueError(f"Every style must have a window, got {np.diff(self.first_window)}.")

    @property
    def num_styles(self) -> int:
        """S."""
        return len(self.first_row) - 1

    @property
    def steps_per_epoch(self) -> int:
        """Number of steps in which the shortest style's rows are seen once."""
        return self.num_styles * int(np.diff(self.first_row).min() // self.batch_size)

    def rows(self, step: int) -> np.ndarray:
        """Returns the [B] int32 rows of a step."""
        turn, style = divmod(step, self.num_styles)
        number, batch = divmod(turn, int(self.first_row[style + 1] - self.first_row[style]) // self.batch_size)
        return self._pass(style, number)[batch * self.batch_size : (batch + 1) * self.batch_size]

    def clips(self, step: int) -> np.ndarray:
        """Returns the [C, 2] int32 windows of a step: first row, number of rows."""
        assert self.windows is not None and self.first_window is not None
        style = step % self.num_styles
        rng = np.random.default_rng((self.seed, _CLIPS, step))
        first, stop = self.first_window[style : style + 2]
        return self.windows[rng.integers(first, stop, self.num_clips)]

    def draw(self, first_step: int, count: int) -> Draw:
        """Returns the rows and clips of `count` steps."""
        steps = range(first_step, first_step + count)
        rows = np.stack([self.rows(step) for step in steps])
        return Draw(rows, np.stack([self.clips(step) for step in steps]) if self.num_clips else None)

    @cached_property
    def _pass(self) -> Callable[[int, int], np.ndarray]:
        return lru_cache(maxsize=2 * self.num_styles)(self._shuffle)

    def _shuffle(self, style: int, number: int) -> np.ndarray:
        first, stop = self.first_row[style : style + 2]
        rng = np.random.default_rng((self.seed, _ROWS, style, number))
        return (first + rng.permutation(stop - first)).astype(np.int32)


def order_of(rows: Rows, batch_size: int, seed: int, num_clips: int = 0) -> StepOrder:
    """Returns the order of a training run over `rows`."""
    return StepOrder(rows.first_row, batch_size, seed, num_clips, rows.windows, rows.first_window)


def identity(rows: Rows) -> list[np.ndarray]:
    """Returns arrays that are equal where training on two sets of rows is: what is drawn, and their statistics."""
    normaliser = rows.normaliser
    statistics = () if normaliser is None else (normaliser.inputs, normaliser.outputs)
    found = [rows.first_row, rows.windows, *(values for part in statistics for values in (part.mean, part.std))]
    return [np.asarray(values) for values in found if values is not None]
