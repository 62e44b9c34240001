"""The last seconds of foot contacts as a chart."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pfnn_jax.viewer.draw.palette import LEFT, RIGHT, rgba_css

if TYPE_CHECKING:
    import viser

SECONDS = 4.0
SAMPLES = 120
LANES = ("right toe", "right heel", "left toe", "left heel")  # from the bottom
_ORDER = (3, 2, 1, 0)  # of a view's contacts
_FILL = tuple(rgba_css(colour, opacity) for colour in (RIGHT, LEFT) for opacity in (0.55, 0.9))
_GAP = 0.18  # of a lane's height


class Timeline:
    """Four lanes, full where a heel or toe is on the ground.

    Args:
        gui: the tab's own.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        self._times = np.linspace(-SECONDS, 0.0, SAMPLES)
        self._seen: list[tuple[float, np.ndarray]] = []
        bands: Any = tuple({"series": (2 * i + 2, 2 * i + 1), "fill": _FILL[i]} for i in range(4))
        line: dict[str, Any] = {"stroke": "rgba(0,0,0,0)", "width": 0, "points": {"show": False}}
        series: Any = ({"label": "s"}, *(dict(line, label=LANES[i // 2]) for i in range(8)))
        self._chart = gui.add_uplot(
            self._lanes(np.zeros((SAMPLES, 4))),
            series=series,
            bands=bands,
            scales={"x": {"time": False, "range": (-SECONDS, 0.0)}, "y": {"range": (0.0, 4.0)}},
            axes=({"show": False}, {"show": False}),
            legend={"show": False},
            cursor={"show": False},
            height=72,
            padding=(6, 8, 6, 8),
        )

    def add(self, seconds: float, contacts: np.ndarray) -> None:
        """One moment: a clock's seconds, and contacts [4] in 0..1 as a view has them."""
        self._seen.append((seconds, contacts[list(_ORDER)]))
        if len(self._seen) > 2 * SAMPLES * 4:
            self._seen = [seen for seen in self._seen if seen[0] >= seconds - SECONDS - 0.1]

    def show(self, seconds: float) -> None:
        """Draws what has been added, up to now."""
        if not self._seen:
            return
        clock = np.array([moment for moment, _ in self._seen]) - seconds
        values = np.stack([contacts for _, contacts in self._seen])
        index = np.searchsorted(clock, self._times, side="right") - 1
        known = (index >= 0)[:, None]
        self._chart.data = self._lanes(np.where(known, values[np.maximum(index, 0)], 0.0))

    def _lanes(self, contacts: np.ndarray) -> tuple[np.ndarray, ...]:
        arrays = [self._times]
        for lane in range(4):
            base = np.full(SAMPLES, lane + _GAP / 2)
            arrays += [base, base + (1.0 - _GAP) * np.clip(contacts[:, lane], 0.0, 1.0)]
        return tuple(arrays)
