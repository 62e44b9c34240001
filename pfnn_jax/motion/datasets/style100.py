"""The tables and file names of 100STYLE (Mason et al. 2022).

Files are `STYLE_GAIT.bvh`, in one folder or in one folder per style. `Frame_Cuts.csv` has one row per style, with the
first and last frame of each gait between the calibration poses; `Dataset_List.csv` says which styles are symmetric.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path

from pfnn_jax.errors import InputError

CUTS, STYLES = "Frame_Cuts.csv", "Dataset_List.csv"
GAITS = {
    "FW": "walk",
    "FR": "run",
    "BW": "walk-back",
    "BR": "run-back",
    "SW": "walk-side",
    "SR": "run-side",
    "ID": "idle",
    "TR1": "transition-1",
    "TR2": "transition-2",
    "TR3": "transition-3",
}
IDLE = GAITS["ID"]
TRANSITION = "transition"
"""Prefix of the contents that are transitions between gaits."""

STYLE_GAIT = re.compile(rf"(\w+?)_({'|'.join(GAITS)})")


@dataclass(frozen=True)
class FrameCut:
    """The frames of a clip that hold its gait.

    Attributes:
        start, stop: frames at the file's own rate; `stop` is exclusive.
        place: where the table states them, for messages.
    """

    start: int
    stop: int
    place: tuple[Path, str]


@dataclass(frozen=True)
class Style100Tables:
    """The two tables that describe the clips of 100STYLE.

    Attributes:
        folder: the folder that holds the tables.
        cuts: style -> (line, row) of `Frame_Cuts.csv`.
        symmetric: style -> whether it may be mirrored; empty without `Dataset_List.csv`.
    """

    folder: Path
    cuts: dict[str, tuple[int, dict[str, str]]]
    symmetric: dict[str, bool]

    def cut(self, style: str, gait: str) -> FrameCut:
        """Returns the frames of a style's gait.

        Raises:
            InputError: if the table has no row for the style, or no whole frame numbers with start before stop.
        """
        file = self.folder / CUTS
        if style not in self.cuts:
            raise InputError(file, f"style {style}", "no row", "must give the first and last frame of every clip")
        line, row = self.cuts[style]
        found = row.get(f"{gait}_START"), row.get(f"{gait}_STOP")
        try:
            start, stop = (int(value or "") for value in found)
        except ValueError:
            start, stop = 0, 0
        if not 0 <= start < stop:
            shown = f"{gait}_START {found[0]}, {gait}_STOP {found[1]}"
            rule = "must be whole frame numbers, the start before the stop"
            raise InputError(file, f"line {line}, style {style}", shown, rule)
        return FrameCut(start, stop, (file, f"line {line}, style {style}, {gait}"))


def read_tables(folder: Path) -> Style100Tables:
    """Reads the tables of a 100STYLE folder.

    Raises:
        InputError: if `Frame_Cuts.csv` is absent, or a table is malformed: naming the line, value and rule.
    """
    return Style100Tables(folder, _read_table(folder / CUTS, "STYLE_NAME"), _read_symmetric(folder / STYLES))


def read_lines(file: Path) -> list[str]:
    """Reads the lines of a text file.

    Raises:
        InputError: if it cannot be read or is not text.
    """
    try:
        return file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        found = getattr(error, "strerror", None) or "not text"
        raise InputError(file, "file", found, "must be readable text") from None


def _read_symmetric(file: Path) -> dict[str, bool]:
    if not file.is_file():
        return {}
    symmetric = {}
    for style, (line, row) in _read_table(file, "Style Name").items():
        value = row.get("Symmetric")
        if value not in ("Yes", "No"):
            raise InputError(file, f"line {line}", f"Symmetric {value}", "must be Yes or No")
        symmetric[style] = value == "Yes"
    return symmetric


def _read_table(file: Path, key: str) -> dict[str, tuple[int, dict[str, str]]]:
    """Returns the rows of a CSV file by the value of one column, with their line numbers."""
    if not file.is_file():
        rule = "must be present: clips of 100STYLE begin with calibration poses, which this table cuts off"
        raise InputError(file, "file", "absent", rule)
    reader = csv.DictReader(read_lines(file))
    try:
        rows = [(reader.line_num, row) for row in reader]
    except csv.Error as error:
        raise InputError(file, f"line {reader.line_num}", error, "must be a table of comma-separated values") from None
    if key not in (reader.fieldnames or ()):
        raise InputError(file, "line 1", f"no column {key}", f"must name the columns, {key} among them")
    return {row[key]: (line, row) for line, row in rows}
