"""Reports: a JSON file for scripts, and a self-contained HTML page for readers."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pfnn_jax.io.files import json_text, refuse_existing, write_whole
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip
from pfnn_jax.viewer.draw.drawing import png_bytes
from pfnn_jax.viewer.player.player import player_assets, player_html

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Table:
    """The table of a section.

    Attributes:
        columns: headings; the first column names the rows.
        rows: cells, each text, a number (printed with three significant digits) or None (printed as a dash).
        best: columns whose smallest number is highlighted.
        note: footnote.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str | float | int | None]]
    best: Sequence[str] = ()
    note: str = ""

    def __post_init__(self):
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"Each row of a Table needs {len(self.columns)} cells, got {list(row)}.")


@dataclass(frozen=True, eq=False)
class Section:
    """One section of a report: text, then a table, then figures, then clips that play side by side.

    Attributes:
        title: heading.
        text: paragraphs, separated by blank lines.
        table: a table, or None.
        figures: (caption, figure) pairs.
        clips: clips for the player.
    """

    title: str
    text: str = ""
    table: Table | None = None
    figures: Sequence[tuple[str, Figure]] = ()
    clips: Sequence[AnnotatedClip] = field(default_factory=tuple)


def write_report(
    out_dir: str | Path,
    result: Mapping[str, Any],
    sections: Sequence[Section],
    *,
    title: str,
    subtitle: str = "",
    facts: Mapping[str, str] | None = None,
    overwrite: bool = False,
) -> Path:
    """Writes `report.json` and `report.html`, each atomically.

    Args:
        out_dir: folder, created if it does not exist.
        result: content of the JSON file: numbers, text, lists, mappings, dataclasses, NumPy values; NaN becomes null.
        sections: content of the page, in order.
        title: heading of the page.
        subtitle: one line below the heading.
        facts: a few headline numbers, label -> value with its unit.
        overwrite: replace earlier reports.

    Returns:
        Path of the page.

    Raises:
        InputError: if a report exists and `overwrite` is not set.
    """
    folder = Path(out_dir)
    page, data = folder / "report.html", folder / "report.json"
    for path in (page, data):
        refuse_existing(path, overwrite)
    text = json_text(result)
    rendered = render_report(sections, title=title, subtitle=subtitle, facts=facts)
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(data, text)
    write_whole(page, rendered)
    return page


def render_report(
    sections: Sequence[Section], *, title: str, subtitle: str = "", facts: Mapping[str, str] | None = None
) -> str:
    """Returns the HTML of the page with its style sheet, pictures, motion and scripts embedded."""
    style = files("pfnn_jax.evaluation").joinpath("report.css").read_text(encoding="utf-8")
    assets = player_assets() if any(section.clips for section in sections) else ""
    head = f"<h1>{html.escape(title)}</h1>" + (f'<p class="subtitle">{html.escape(subtitle)}</p>' if subtitle else "")
    body = head + _facts(facts or {}) + "".join(_section(section) for section in sections)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{style}</style>{assets}</head><body><main>{body}</main></body></html>\n"
    )


def _facts(facts: Mapping[str, str]) -> str:
    items = (f"<li><b>{html.escape(value)}</b><span>{html.escape(label)}</span></li>" for label, value in facts.items())
    return f'<ul class="facts">{"".join(items)}</ul>' if facts else ""


def _section(section: Section) -> str:
    paragraphs = (part.strip() for part in section.text.split("\n\n"))
    parts = [f"<section><h2>{html.escape(section.title)}</h2>"]
    parts += [f"<p>{html.escape(part)}</p>" for part in paragraphs if part]
    if section.table is not None:
        parts.append(_table(section.table))
    parts += [_picture(caption, figure) for caption, figure in section.figures]
    if section.clips:
        parts.append(player_html(section.clips, assets=False))
    return "".join(parts) + "</section>"


def _picture(caption: str, figure: Figure) -> str:
    data = base64.b64encode(png_bytes(figure)).decode("ascii")
    below = f"<figcaption>{html.escape(caption)}</figcaption>" if caption else ""
    return (
        f'<figure class="picture"><img alt="{html.escape(caption)}" src="data:image/png;base64,{data}">{below}</figure>'
    )


def _table(table: Table) -> str:
    best = {column: _smallest(table, number) for number, column in enumerate(table.columns) if column in table.best}
    head = "".join(f"<th>{html.escape(column)}</th>" for column in table.columns)
    rows = "".join(
        "<tr>"
        + "".join(_cell(cell, best.get(column)) for column, cell in zip(table.columns, row, strict=True))
        + "</tr>"
        for row in table.rows
    )
    note = f'<p class="note">{html.escape(table.note)}</p>' if table.note else ""
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>{note}'


def _smallest(table: Table, number: int) -> float | None:
    values = [row[number] for row in table.rows]
    found = [float(v) for v in values if isinstance(v, int | float | np.number) and math.isfinite(v)]
    return min(found, default=None)


def _cell(cell: str | float | int | None, best: float | None) -> str:
    if isinstance(cell, str):
        return f'<td class="text">{html.escape(cell)}</td>'
    if cell is None or not math.isfinite(cell):
        return "<td>–</td>"
    mark = ' class="best"' if best is not None and float(cell) == best else ""
    return f"<td{mark}>{format_number(cell)}</td>"


def format_number(value: float | int) -> str:
    """Formats a number: three significant digits, whole numbers in full with thousands separators.

    Only magnitudes below 0.001 or from 10⁶ have an exponent.
    """
    if float(value).is_integer() and abs(value) < 1e15:
        return f"{int(value):,}"
    size = abs(float(value))
    if not 1e-3 <= size < 1e6:
        return f"{value:.2e}"
    return f"{value:,.{max(0, 2 - math.floor(math.log10(size)))}f}"
