"""Tables, pictures and the report of `experiments.transfer_judged`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from experiments.common.markdown import markdown_table
from experiments.common.transfer_methods import STRENGTHS
from experiments.common.transfer_pairs import OTHER_CONTENT, PEER_FPS, SAME_CONTENT, SAME_STYLE, Pair
from pfnn_jax.evaluation.report import Section, Table, write_report
from pfnn_jax.evaluation.transfer_judge import MEASURES, Spread, summarise
from pfnn_jax.io.files import write_whole
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip
from pfnn_jax.viewer.draw.filmstrip import filmstrip

COLUMNS = (
    "style recognised",
    "style probability",
    "content recognised",
    "SC++, cm",
    "SC++ warped, cm",
    "CC, cm",
    "CC warped, cm",
    "to style warped, cm",
    "sliding",
    "skating, cm/s",
    "jitter ratio",
    "bone error, cm",
    "trajectory, m",
    "trajectory shape, m",
)
"""Measures in the tables; all of them are in report.json."""

NOTE = "Mean over pairs, in brackets the 95 % interval by bootstrap over pairs. " + "; ".join(
    f"{name}: {text}" for name, text in MEASURES.items() if name in COLUMNS
)

RELATIVE = ("style recognised", "style probability", "content recognised", "content probability")
"""Measures that are reported relative to those of the ground truths of the same pairs."""

DRAWN_METHODS = ("content", "ground truth", "optimisation", "fast")


def write_results(
    out: Path,
    found: dict[str, Any],
    pairs: Sequence[Pair],
    results: Mapping[str, Mapping[str, MotionClip]],
    drawn: int,
) -> None:
    """Writes report.json, report.html and table.md.

    Args:
        out: folder.
        found: what the experiment measured; receives `summary`.
        pairs: all pairs.
        results: method -> pair -> clip.
        drawn: number of pairs of different styles and contents in pictures.
    """
    records = found["records"]
    found["summary"] = {
        kind: {name: summarise([one for one in own if one["kind"] == kind]) for name, own in records.items()}
        for kind in (OTHER_CONTENT, SAME_CONTENT, SAME_STYLE)
    }
    found["relative"] = relative(found["summary"][OTHER_CONTENT])
    sections, markdown = _tables(found), []
    for section in sections:
        table = section.table
        assert table is not None
        markdown.append(f"{section.title}. {section.text}\n\n{markdown_table(table.columns, table.rows)}\n")
    sections.append(Section("Strength", "Style against content recognition.", figures=_curves(found["summary"])))
    shown = [pair for pair in pairs if pair.kind == OTHER_CONTENT][:drawn]
    sections.append(Section("Pictures", figures=[(pair.name, _picture(pair, results)) for pair in shown]))
    write_report(out, found, sections, title="Style transfer, judged", overwrite=True)
    write_whole(out / "table.md", "".join(markdown))


def _tables(found: Mapping[str, Any]) -> list[Section]:
    """Returns the tables of all kinds of pairs, of recognition relative to real clips, and of released outputs."""
    real = found["accuracy on real clips"]
    text = f"Held-out real clips of the same folds: {', '.join(f'{kind} {value:.0%}' for kind, value in real.items())}."
    sections = []
    for kind, table in found["summary"].items():
        lines = _lines(table, found["frechet"] if kind == OTHER_CONTENT else {})
        sections.append(
            Section(f"Pairs: {kind}", text, Table(("method", "pairs", *COLUMNS, "Fréchet"), lines, note=NOTE))
        )
    lines = [[name, *(own.get(measure) for measure in RELATIVE)] for name, own in found["relative"].items()]
    text = f"Pairs: {OTHER_CONTENT}. Each measure over that of the ground truths of these pairs."
    sections.append(Section("Relative to real clips", text, Table(("method", *RELATIVE), lines)))
    if found["peers"]:
        lines = [[one["pair"], one["method"], *(one[name] for name in COLUMNS)] for one in found["peers"]]
        text = f"All clips at {PEER_FPS:g} fps."
        sections.append(Section("Released outputs", text, Table(("pair", "method", *COLUMNS), lines)))
    return sections


def relative(table: Mapping[str, Mapping[str, Spread]]) -> dict[str, dict[str, float]]:
    """Returns method -> measure -> mean over that of the ground truth, of recognition; empty without ground truths.

    Args:
        table: method -> measure -> spread, of one kind of pairs.
    """
    real = table.get("ground truth", {})
    return {
        name: {
            measure: spreads[measure].mean / real[measure].mean
            for measure in RELATIVE
            if measure in spreads and measure in real and real[measure].mean > 0
        }
        for name, spreads in table.items()
        if real
    }


def _lines(table: Mapping[str, Mapping[str, Spread]], frechet: Mapping[str, float | None]) -> list[list[Any]]:
    lines = []
    for name, spreads in table.items():
        if spreads:
            count = max(spread.count for spread in spreads.values())
            lines.append([name, str(count), *(_cell(spreads.get(measure)) for measure in COLUMNS), frechet.get(name)])
    return lines


def _cell(spread: Spread | None) -> str | None:
    return None if spread is None else f"{spread.mean:.3g} [{spread.low:.3g}, {spread.high:.3g}]"


def _curves(summary: Mapping[str, Mapping[str, Mapping[str, Spread]]]) -> list[tuple[str, Figure]]:
    """Returns the recognition of style against that of content over strength, one curve per method."""
    from pfnn_jax.viewer.draw.drawing import blank_figure

    figures, table = [], summary[OTHER_CONTENT]
    for method in ("optimisation", "fast"):
        names = {0.0: "content", 1.0: method} | {value: f"{method}, {value:g}" for value in (0.5, 1.5)}
        points = [(value, table[names[value]]) for value in STRENGTHS if table.get(names[value])]
        if len(points) < 2 or method not in table:
            continue
        figure = blank_figure(5.0, 4.0)
        axes = figure.add_subplot()
        x, y = ([spreads[f"{kind} probability"].mean for _, spreads in points] for kind in ("content", "style"))
        axes.plot(x, y, marker="o")
        for (value, _), at in zip(points, zip(x, y, strict=True), strict=True):
            axes.annotate(f"{value:g}", at, textcoords="offset points", xytext=(5, 5))
        axes.set_xlabel("probability of the content")
        axes.set_ylabel("probability of the style")
        figures.append((f"{method}: strength from 0 to 1.5", figure))
    return figures


def _picture(pair: Pair, results: Mapping[str, Mapping[str, MotionClip]]) -> Figure:
    shown = [AnnotatedClip(f"style: {pair.style.style} {pair.style.content}", pair.style)]
    for name in DRAWN_METHODS:
        if pair.name in results.get(name, {}):
            shown.append(AnnotatedClip(name, results[name][pair.name]))
    return filmstrip(*shown, moments=6, title=pair.name)
