"""Reports: one JSON file for scripts, one HTML page for people, readable without a server or a network."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import json_text, write_whole
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip
from pfnn_jax.viewer.draw.drawing import png_bytes
from pfnn_jax.viewer.player.player import player_assets, player_html


@dataclass(frozen=True, eq=False)
class Table:
    """Rows of a report's table.

    Attributes:
        columns: headings; the first column names the rows.
        rows: cells: text, numbers (drawn with three significant digits) or None (drawn as a dash).
        best: columns whose smallest number is marked.
        note: small print below.
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
    """One part of a report: text, then a table, then figures, then clips that play side by side.

    Attributes:
        title: heading.
        text: paragraphs, parted by blank lines.
        table: a table, or None.
        figures: (caption, figure) pairs.
        clips: clips.
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
    """Write `report.json` and `report.html`, each whole or not at all.

    Args:
        out_dir: folder, made where it does not exist.
        result: what scripts read: numbers, text, lists, mappings, dataclasses and NumPy values; NaN becomes null.
        sections: what people read, in order.
        title: heading of the page.
        subtitle: one line below it.
        facts: a few headline numbers, label -> value with its unit.
        overwrite: replace earlier reports.

    Returns:
        Path of the page.

    Raises:
        InputError: a report is there and `overwrite` is not set.
    """
    folder = Path(out_dir)
    page, data = folder / "report.html", folder / "report.json"
    for path in (page, data):
        if path.exists() and not overwrite:
            raise InputError(path, "output", "exists", "name another folder or pass --overwrite")
    text = json_text(result)
    rendered = render_report(sections, title=title, subtitle=subtitle, facts=facts)
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(data, text)
    write_whole(page, rendered)
    return page


def render_report(
    sections: Sequence[Section], *, title: str, subtitle: str = "", facts: Mapping[str, str] | None = None
) -> str:
    """The page's HTML: style, pictures, motion and script all inside it."""
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
    """Three significant digits without exponents between 0.001 and 10⁶; whole numbers with thousands parted."""
    if float(value).is_integer() and abs(value) < 1e15:
        return f"{int(value):,}"
    size = abs(float(value))
    if not 1e-3 <= size < 1e6:
        return f"{value:.2e}"
    return f"{value:,.{max(0, 2 - math.floor(math.log10(size)))}f}"
