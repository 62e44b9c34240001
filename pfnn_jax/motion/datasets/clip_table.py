"""Reads `clips.csv`, a small table that says how the files of a folder are to be read where that is not found or wrong.

    files,unit,up,source_fps,travel,clip_name,roles
    *,centimetre,,,,,
    old/*,inch,z,,,,old/roles.json
    old/walk_03.bvh,,,60,keep,,
    hero.glb,,,,,Walk_A,

`files` and `roles` are paths relative to the folder, `files` with `*` for any characters. An empty cell leaves the
value open. Where several lines fit a file, the last one that has a value counts.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from pfnn_jax.errors import InputError
from pfnn_jax.motion.humanoid.overrides import read_overrides_file
from pfnn_jax.motion.reading import ReadOptions, check_options

TABLE = "clips.csv"

ROLES = "roles"
"""Column of JSON files that name the joints' roles."""

COLUMNS = ("files", *(field.name for field in fields(ReadOptions)), ROLES)

NUMBERS = ("unit", "source_fps")


@dataclass(frozen=True)
class TableRow:
    """One line of a table.

    Attributes:
        pattern: of paths relative to the folder.
        line: number in the file.
        values: column -> value; only those that are given.
        roles_file: JSON file that names the joints' roles, or None.
    """

    pattern: str
    line: int
    values: dict[str, Any]
    roles_file: Path | None


def read_options(folder: Path, paths: Sequence[Path], reading: ReadOptions) -> list[tuple[ReadOptions, Path | None]]:
    """Returns what is known about each file of a folder: what its table says and, where that is silent, `reading`.

    Args:
        folder: with or without a table.
        paths: files in it.
        reading: what is known about all files.

    Returns:
        For each file, how it is to be read, and the JSON file that names its joints' roles, or None.

    Raises:
        InputError: for a table that is malformed, a line that fits no file, or a JSON file that cannot be read.
    """
    table = folder / TABLE
    if not table.is_file():
        return [(reading, None)] * len(paths)
    rows, used, found = _read_table(table), set(), []
    for path in paths:
        options, roles_file = reading, None
        for row in rows:
            if fnmatchcase(path.relative_to(folder).as_posix(), row.pattern):
                options, roles_file = replace(options, **row.values), row.roles_file or roles_file
                used.add(row.line)
        found.append((options, roles_file))
    for row in rows:
        if row.line not in used:
            raise InputError(table, f"line {row.line}", row.pattern, "must fit a clip that is read from the folder")
    return found


def _read_table(table: Path) -> list[TableRow]:
    try:
        with table.open(encoding="utf-8-sig", newline="") as file:
            lines = [[cell.strip() for cell in line] for line in csv.reader(file)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(table, "file", error, "must be a readable table of comma-separated values") from None
    head = lines[0] if lines else []
    if not head or head[0] != "files" or len(set(head)) < len(head) or not set(head) <= set(COLUMNS):
        rule = f"must begin with `files` and name columns among {', '.join(COLUMNS[1:])}"
        raise InputError(table, "line 1", ",".join(head) or "empty", rule)
    rows = [_row(table, number, head, line) for number, line in enumerate(lines[1:], start=2) if any(line)]
    return rows


def _row(table: Path, number: int, head: list[str], cells: list[str]) -> TableRow:
    if len(cells) != len(head):
        raise InputError(table, f"line {number}", f"{len(cells)} cells", f"must be {len(head)}, as in the first line")
    given = {name: cell for name, cell in zip(head[1:], cells[1:], strict=True) if cell}
    roles = given.pop(ROLES, None)
    values = {name: _value(name, cell) for name, cell in given.items()}
    try:
        check_options(replace(ReadOptions(), **values), table)
    except InputError as error:
        raise InputError(table, f"line {number}, {error.place}", error.value, error.rule) from None
    return TableRow(cells[0], number, values, None if roles is None else _roles_file(table, number, roles))


def _roles_file(table: Path, number: int, cell: str) -> Path:
    """Returns the JSON file that a cell names, once it is known to be readable."""
    path = table.parent / cell
    if not path.is_file():
        rule = "must be the path of a JSON file, relative to the table's folder"
        raise InputError(table, f"line {number}, {ROLES}", cell, rule)
    read_overrides_file(path)
    return path


def _value(name: str, cell: str) -> float | str:
    """Returns a cell as a number where that is one; what it may be is checked later."""
    if name not in NUMBERS:
        return cell
    try:
        return float(cell)
    except ValueError:
        return cell if name == "unit" else float("nan")
