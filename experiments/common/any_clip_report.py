"""Tables and the report of `experiments.any_clip`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.common.any_clip_takes import SAME_FRAMES
from experiments.common.markdown import markdown_table
from pfnn_jax.evaluation.report import Section, Table, write_report
from pfnn_jax.io.files import write_whole

SUMMARY = (
    "base",
    "source",
    "walks",
    "learned, cm",
    "without, cm",
    "nearest own style, cm",
    "retargeting, cm",
    "actor again, cm",
    "one step: learned, cm",
    "one step: without, cm",
    "one step: nearest own style, cm",
    "one step: repeating the pose, cm",
    "skating: learned, cm/s",
    "skating: without, cm/s",
    "skating: actor, cm/s",
    "failed: learned",
    "failed: without",
    "seconds to learn",
)

ROUNDED = 6
"""Decimals of means: retargeting onto the same skeleton changes nothing but the last bits."""

DOCUMENTED = tuple(
    name
    for name in SUMMARY
    if name not in ("one step: nearest own style, cm", "one step: repeating the pose, cm", "skating: without, cm/s")
)
"""Columns of the summary that fit on a page of the documentation."""

DETAILS = (
    "style",
    "judged on",
    "learned from, s",
    "learned, cm",
    "trunk",
    "arms",
    "legs",
    "without, cm",
    "nearest own style, cm",
    "own style",
    "retargeting, cm",
    "actor again, cm",
    "one step: learned, cm",
    "one step: without, cm",
    "hips, of the actor's height",
    "trunk, °",
    "speed, of the actor's",
    "floating, cm",
    "skating, cm/s",
    "skating: actor, cm/s",
    "faults",
)

NOTE = (
    "Distances are between mean gait cycles, over the joints of the body, on the actor's skeleton. Retargeting is the "
    "take itself on the run's skeleton and back; actor again is the distance of the learned clip from the judged take. "
    "Means leave out walks without steps, which count as failed. The base was trained on clips of sources marked *, "
    "maybe on the judged takes; sources marked † have takes that are too short to judge on other frames than the "
    "learned ones."
)


def write_results(
    out: Path, rows: Sequence[Mapping[str, Any]], skipped: Mapping[str, Mapping[str, str]], settings: Mapping[str, str]
) -> dict[str, Any]:
    """Writes report.json, report.html and table.md, and returns the content of the first."""
    table = summary(rows)
    result = {"config": dict(settings), "summary": table, "rows": list(rows), "skipped": dict(skipped)}
    sections = [Section("Summary", table=Table(SUMMARY, table, note=NOTE)), *_sections(out, rows), _skips(skipped)]
    write_report(out, result, sections, title="Any clip in, onto any network", overwrite=True)
    columns = [SUMMARY.index(name) for name in DOCUMENTED]
    write_whole(out / "table.md", markdown_table(DOCUMENTED, [[line[column] for column in columns] for line in table]))
    return result


def summary(rows: Sequence[Mapping[str, Any]]) -> list[list[str | float | None]]:
    """Returns the rows of `SUMMARY`: the means of every base and source."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["base"], row["source"]), []).append(row)
    return [_summary(base, source, own) for (base, source), own in groups.items()]


def _summary(base: str, source: str, rows: Sequence[Mapping[str, Any]]) -> list[str | float | None]:
    takes = [take for row in rows for take in row["judged"]]

    def walks(kind: str, key: str) -> float | None:
        return _mean([take["walks"][kind].get(key) for take in takes])

    def failed(kind: str) -> str:
        return f"{sum(bool(take['walks'][kind]['faults']) for take in takes)}/{len(takes)}"

    marks = ("*" if any(row["seen"] for row in rows) else "") + (
        "†" if any(row["how"] == SAME_FRAMES for row in rows) else ""
    )
    return [
        base,
        source + marks,
        str(len(takes)),
        *(walks(kind, "distance") for kind in ("learned", "without", "own")),
        _mean([take["retargeting"] for take in takes]),
        _mean([take["actor"] for take in takes]),
        *(walks(kind, "one_step") for kind in ("learned", "without", "own")),
        _mean([take["hold"] for take in takes]),
        *(walks(kind, "skating") for kind in ("learned", "without")),
        _mean([take["skating"] for take in takes]),
        *(failed(kind) for kind in ("learned", "without")),
        _mean([row["info"]["seconds"] for row in rows]),
    ]


def _sections(out: Path, rows: Sequence[Mapping[str, Any]]) -> list[Section]:
    sections = []
    for base, source in dict.fromkeys((row["base"], row["source"]) for row in rows):
        own = [row for row in rows if (row["base"], row["source"]) == (base, source)]
        lines = [_details(row, take) for row in own for take in row["judged"]]
        text = " ".join(
            f"{row['style']}: {'; '.join(row['info']['warnings'])}." for row in own if row["info"]["warnings"]
        )
        pictures = [out / "pictures" / take["picture"] for row in own for take in row["judged"]]
        figures = [(path.stem.replace("__", ", "), _figure(path)) for path in pictures if path.exists()]
        sections.append(Section(f"{source} on {base}", text, Table(DETAILS, lines), figures))
    return sections


def _details(row: Mapping[str, Any], take: Mapping[str, Any]) -> list[str | float | None]:
    learned, without, own = (take["walks"][kind] for kind in ("learned", "without", "own"))
    return [
        row["style"],
        f"{take['file']} ({row['how']})",
        row["learned"]["part_seconds"],
        *(learned.get(key) for key in ("distance", "trunk", "arms", "legs")),
        without["distance"],
        own["distance"],
        row["own_style"] or "",
        take["retargeting"],
        take["actor"],
        learned["one_step"],
        without["one_step"],
        *(learned.get(key) for key in ("height", "lean", "speed", "floating", "skating")),
        take["skating"],
        "; ".join(f"{kind}: {', '.join(walk['faults'])}" for kind, walk in take["walks"].items() if walk["faults"]),
    ]


def _skips(skipped: Mapping[str, Mapping[str, str]]) -> Section:
    lines = [[source, style, reason] for source, styles in skipped.items() for style, reason in styles.items()]
    return Section("Skipped", table=Table(("source", "style", "reason"), lines))


def _figure(path: Path):
    """Returns a picture as a figure of the same size, for the report."""
    import matplotlib.image
    from matplotlib.figure import Figure

    pixels = matplotlib.image.imread(path)
    figure = Figure(figsize=(pixels.shape[1] / 144, pixels.shape[0] / 144), dpi=144)
    figure.figimage(pixels)
    return figure


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return round(float(np.mean(known)), ROUNDED) if known else None
