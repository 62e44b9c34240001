"""Tables and the report of `experiments.transfer_against_few_shot`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.common.markdown import markdown_table
from pfnn_jax.evaluation.report import Section, Table, write_report
from pfnn_jax.io.files import write_whole

MEASURES = {
    "style recognised": ("recognised, %", 100.0),
    "style probability": ("probability, %", 100.0),
    "distance": ("from real walks, cm", 1.0),
    "trunk": ("trunk", 1.0),
    "arms": ("arms", 1.0),
    "legs": ("legs", 1.0),
    "CC warped, cm": ("from the content, cm", 1.0),
    "trajectory shape, m": ("path's shape, m", 1.0),
    "sliding": ("sliding", 1.0),
    "skating, cm/s": ("skating, cm/s", 1.0),
    "jitter ratio": ("jitter, of the content's", 1.0),
    "speed": ("speed, of real walks'", 1.0),
    "path_error": ("from the path, cm", 1.0),
}
"""Title and factor of every measure."""

HIGHER_IS_BETTER = ("style recognised", "style probability")

COMPARED = (
    "style recognised",
    "style probability",
    "distance",
    "trunk",
    "arms",
    "legs",
    "sliding",
    "skating, cm/s",
    "jitter ratio",
)
"""Measures of which the lower (or, in `HIGHER_IS_BETTER`, the higher) is better."""

PAIRS = (("few-shot", "optimisation"), ("few-shot", "fast network"), ("fast network", "optimisation"))

BY_STYLE = ("style recognised", "style probability", "distance", "skating, cm/s", "jitter ratio", "speed")
BY_CONTENT = ("style recognised", "distance", "skating, cm/s", "jitter ratio")

RESAMPLES = 2000
"""Of the bootstrap."""

Row = Mapping[str, Any]


def write_results(out: Path, rows: Sequence[Row], settings: Mapping[str, str]) -> dict[str, Any]:
    """Writes report.json, report.html and table.md, and returns the content of the first."""
    shown = {
        "All styles": (["method", *_titles(*MEASURES), "failed"], summary(rows)),
        "By style": (["style", "method", *_titles(*BY_STYLE)], _by(rows, "style", BY_STYLE)),
        "By content": (["content", "method", *_titles(*BY_CONTENT)], _by(rows, "content", BY_CONTENT)),
        "Pair by pair": (["first", "second", "measure", "difference", "95 %", "first better"], pairwise(rows)),
    }
    tables = {title: Table(head, lines) for title, (head, lines) in shown.items()}
    result = {
        "config": dict(settings),
        "rows": list(rows),
        **{
            title: [dict(zip(table.columns, line, strict=True)) for line in table.rows]
            for title, table in tables.items()
        },
    }
    sections = [Section(title, table=table) for title, table in tables.items()]
    pictures = sorted((out / "pictures").glob("*.png"))
    sections.append(Section("Pictures", figures=[(path.stem, _figure(path)) for path in pictures]))
    write_report(out, result, sections, title="Style transfer against few-shot learning", overwrite=True)
    text = "\n".join(f"{title}\n\n{markdown_table(table.columns, table.rows)}" for title, table in tables.items())
    write_whole(out / "table.md", text)
    print(text)
    return result


def summary(rows: Sequence[Row]) -> list[list[Any]]:
    """Returns one line for each method: mean ± standard deviation over walks of every measure, and failures."""
    lines = []
    for method in _values(rows, "method"):
        own = [row for row in rows if row["method"] == method]
        failed = sum(bool(row["fault"]) for row in own)
        lines.append([method, str(len(own)), *(_spread(own, measure) for measure in MEASURES), str(failed)])
    return lines


def pairwise(rows: Sequence[Row]) -> list[list[Any]]:
    """Returns, for two methods on the same contents, the mean difference of every measure.

    The interval is a bootstrap over styles, as walks of one style are not independent. The last column counts walks in
    which the first method is better.
    """
    lines = []
    for first, second in PAIRS:
        for measure in COMPARED:
            by_style = _differences(rows, first, second, measure)
            if not by_style:
                continue
            title, factor = MEASURES[measure]
            every = np.concatenate(list(by_style.values()))
            better = every > 0 if measure in HIGHER_IS_BETTER else every < 0
            low, high = factor * _bootstrap(list(by_style.values()))
            lines.append(
                [
                    first,
                    second,
                    title,
                    f"{factor * every.mean():+.3g}",
                    f"{low:+.3g} to {high:+.3g}",
                    f"{int(better.sum())}/{len(every)}",
                ]
            )
    return lines


def _differences(rows: Sequence[Row], first: str, second: str, measure: str) -> dict[str, np.ndarray]:
    """Returns the differences of a measure on the same contents, by style."""
    found = {(row["style"], row["clip"], row["method"]): row.get(measure) for row in rows}
    differences: dict[str, list[float]] = {}
    for (style, clip, method), value in found.items():
        other = found.get((style, clip, second))
        if method == first and value is not None and other is not None:
            differences.setdefault(style, []).append(value - other)
    return {style: np.array(values) for style, values in differences.items()}


def _bootstrap(groups: Sequence[np.ndarray]) -> np.ndarray:
    """Returns the 2.5 and 97.5 % quantiles of the mean over groups that are drawn again with replacement."""
    rng = np.random.default_rng(0)
    draws = rng.integers(len(groups), size=(RESAMPLES, len(groups)))
    means = [np.concatenate([groups[index] for index in draw]).mean() for draw in draws]
    return np.quantile(means, (0.025, 0.975))


def _by(rows: Sequence[Row], field: str, measures: Sequence[str]) -> list[list[Any]]:
    lines = []
    for value in _values(rows, field):
        for method in _values(rows, "method"):
            own = [row for row in rows if row[field] == value and row["method"] == method]
            if own:
                lines.append([value, method, str(len(own)), *(_spread(own, measure) for measure in measures)])
    return lines


def _spread(rows: Sequence[Row], measure: str) -> str | None:
    """Returns mean ± standard deviation of a measure over the rows that have it."""
    known = np.array([row[measure] for row in rows if row.get(measure) is not None])
    factor = MEASURES[measure][1]
    return f"{factor * known.mean():.3g} ± {factor * known.std():.2g}" if len(known) else None


def _values(rows: Sequence[Row], field: str) -> list[str]:
    return list(dict.fromkeys(row[field] for row in rows))


def _titles(*measures: str) -> list[str]:
    return ["walks", *(MEASURES[measure][0] for measure in measures)]


def _figure(path: Path) -> Any:
    import matplotlib.image
    from matplotlib.figure import Figure

    pixels = matplotlib.image.imread(path)
    figure = Figure(figsize=(pixels.shape[1] / 144, pixels.shape[0] / 144), dpi=144)
    figure.figimage(pixels)
    return figure
