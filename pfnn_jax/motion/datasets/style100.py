"""The tables and file names of 100STYLE (Mason et al. 2022).

Files are `STYLE_GAIT.bvh`, in one folder or in one folder per style. `Frame_Cuts.csv` has a row for each style with the
first and last frame of each gait between the calibration poses; `Dataset_List.csv` says which styles are symmetric.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import CENTIMETRE
from pfnn_jax.motion.datasets.clip_file import ClipFile, is_symmetric

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
"""Contents that begin so are transitions between gaits."""

STYLE_GAIT = re.compile(rf"(\w+?)_({'|'.join(GAITS)})")


def style100_files(folder: Path, paths: list[Path]) -> list[ClipFile]:
    """The takes at these paths, cut as the folder's tables say.

    Args:
        folder: of the tables. Without `Dataset_List.csv` the paper's list of symmetric styles holds.
        paths: BVH files.

    Raises:
        InputError: naming the table, line, value and rule; or a file of another name.
    """
    cuts = _read_table(folder / CUTS, "STYLE_NAME")
    symmetric = read_symmetric(folder / STYLES)
    clips = []
    for path in paths:
        found = STYLE_GAIT.fullmatch(path.stem)
        if found is None:
            raise InputError(path, "file name", path.name, "files of this kind are named STYLE_GAIT.bvh")
        style, gait = found.groups()
        start, stop, line = _frame_cut(folder / CUTS, cuts, style, gait)
        place = (folder / CUTS, f"line {line}, style {style}, {gait}")
        mirrored = symmetric.get(style, is_symmetric(style))
        clips.append(ClipFile(path, style, GAITS[gait], mirrored, start, stop, CENTIMETRE, place))
    return clips


def read_symmetric(file: Path) -> dict[str, bool]:
    """Whether each style of `Dataset_List.csv` may be mirrored; nothing without the file.

    Raises:
        InputError: naming the line and value.
    """
    if not file.is_file():
        return {}
    symmetric = {}
    for style, (line, row) in _read_table(file, "Style Name").items():
        value = row.get("Symmetric")
        if value not in ("Yes", "No"):
            raise InputError(file, f"line {line}", f"Symmetric {value}", "must be Yes or No")
        symmetric[style] = value == "Yes"
    return symmetric


def _frame_cut(file: Path, cuts: dict, style: str, gait: str) -> tuple[int, int, int]:
    if style not in cuts:
        raise InputError(file, f"style {style}", "no row", "every take needs its first and last frame")
    line, row = cuts[style]
    found = row.get(f"{gait}_START"), row.get(f"{gait}_STOP")
    try:
        start, stop = (int(value or "") for value in found)
    except ValueError:
        start, stop = 0, 0
    if not 0 <= start < stop:
        shown = f"{gait}_START {found[0]}, {gait}_STOP {found[1]}"
        rule = "must be whole frame numbers, the start before the stop"
        raise InputError(file, f"line {line}, style {style}", shown, rule)
    return start, stop, line


def read_lines(file: Path) -> list[str]:
    """Lines of a text file.

    Raises:
        InputError: if it cannot be read, or is no text.
    """
    try:
        return file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        found = getattr(error, "strerror", None) or "not text"
        raise InputError(file, "file", found, "must be readable text") from None


def _read_table(file: Path, key: str) -> dict[str, tuple[int, dict]]:
    """Rows of a CSV file by the value of one column, with their line numbers."""
    if not file.is_file():
        raise InputError(file, "file", "absent", "100STYLE takes start with calibration and must be cut by this table")
    reader = csv.DictReader(read_lines(file))
    try:
        rows = [(reader.line_num, row) for row in reader]
    except csv.Error as error:
        raise InputError(file, f"line {reader.line_num}", error, "must be a table of comma-separated values") from None
    if key not in (reader.fieldnames or ()):
        raise InputError(file, "line 1", f"no column {key}", f"the first line names the columns, {key} among them")
    return {row[key]: (line, row) for line, row in rows}
