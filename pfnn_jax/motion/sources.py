"""Folders of motion capture as lists of labelled clips: which style, which content, which frames, mirrored or not.

Five conventions are known, by their file names:

- `bandai`: `dataset-N_CONTENT_STYLE_ID.bvh` (Bandai-Namco Research Motion Dataset 1 and 2).
- `100style`: `STYLE_GAIT.bvh`, in the folder or in one folder per style, with `Frame_Cuts.csv` and, for symmetry,
  `Dataset_List.csv` (100STYLE, Mason et al. 2022).
- `xia`: `STYLE_CONTENT_TAKE.bvh` with a two-digit content and a three-digit take (Xia et al. 2015).
- `pfnn`: `NAME.bvh` beside `NAME.phase` (Holden et al. 2017), all of style `neutral`. Files without a `.phase` are left
  out, and so are `_mirror` files: mirrored copies are made from the clips themselves.
- `folders`: one folder of BVH files per style, named as the style. Styles are mirrored except those which
  `asymmetric.txt` beside the style folders lists, one a line; without that file, the papers' asymmetric styles.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import CENTIMETRE, CMU, read_bvh
from pfnn_jax.motion.clip import MotionClip, cut, resample, swap_sides

BANDAI = re.compile(r"(dataset-\d+)_([a-z-]+)_([a-z]+)_(\d+)", re.IGNORECASE)
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
STYLE_GAIT = re.compile(rf"(\w+?)_({'|'.join(GAITS)})")
XIA = re.compile(r"([a-z]+)_(\d\d)_(\d{3})", re.IGNORECASE)
XIA_CONTENTS = {"01": "walk", "13": "run", "16": "jump", "18": "punch"}  # others keep their number

# turn the other way than their names say, by the net change of the hips' heading (right_normal_004 turns twice)
BANDAI_MISLABELLED = {
    "dataset-2_walk-turn-left_masculine_006",
    "dataset-2_walk-turn-left_masculine_007",
    "dataset-2_walk-turn-right_masculine_006",
    "dataset-2_walk-turn-right_masculine_007",
    "dataset-2_walk-turn-right_normal_004",
}

# Mason et al. 2018, few-shot styles not mirrored, then the asymmetric styles of 100STYLE
ASYMMETRIC = frozenset(
    name.lower()
    for name in (
        *("Bouncy", "Dance3", "DragLeg", "Hobble", "HurtLeg", "LeanRight", "LeftHop", "PainfulLeftknee"),
        *("WoundedLeg", "Yokogeri"),
        *("ArmsFolded", "Balance", "BouncyLeft", "BouncyRight", "DragLeftLeg", "DragRightLeg", "LeanLeft"),
        *("RightHop", "LimpLeft", "LimpRight", "Lunge", "Monk", "Old", "OnPhoneLeft", "OnPhoneRight", "Punch"),
        *("RaisedLeftArm", "RaisedRightArm", "ShieldedLeft", "ShieldedRight", "SpinAntiClock", "SpinClock"),
        *("Superman", "Swat", "Sweep", "Teapot", "WalkingStickLeft", "WalkingStickRight"),
    )
)


@dataclass(frozen=True)
class ClipFile:
    """One clip on disk and what is known of it before it is read.

    Attributes:
        path: the BVH file.
        style: name of the style, fit to be a file name.
        content: what is done, as `walk` or `walk-turn-left`; empty where unknown.
        symmetric: whether the style may be mirrored.
        start, stop: frames used, at the file's own rate; stop None means to the end. A stop beyond the take, as in
            shortened takes, means the end too.
        unit: metres per unit of the file, None to guess it.
    """

    path: Path
    style: str
    content: str = ""
    symmetric: bool = True
    start: int = 0
    stop: int | None = None
    unit: float | None = None


def list_clips(folder: str | Path, kind: str = "auto") -> list[ClipFile]:
    """The clips of a folder, ordered by file name.

    Args:
        folder: folder in one of the module's conventions, or one BVH file, whose style is taken from its name.
        kind: bandai, 100style, xia, pfnn or folders; auto finds it from the names.

    Raises:
        InputError: if the folder is absent, holds no clip, follows no or another convention, names a style that is no
            file name, or its tables lack a take or are malformed.
    """
    folder = Path(folder)
    if kind not in ("auto", *KINDS):
        raise InputError(folder, "kind", kind, f"known kinds are auto, {', '.join(KINDS)}")
    if folder.is_file():
        return [_single(folder)]
    if not folder.is_dir():
        raise InputError(folder, "folder", "absent", "must be a folder of BVH files or a BVH file")
    kind = find_kind(folder) if kind == "auto" else kind
    clips = KINDS[kind](folder)
    if not clips:
        raise InputError(folder, "folder", "no clips", f"kind {kind} finds no BVH file here")
    for clip in clips:
        check_style_name(clip.style, clip.path)
    return clips


def find_kind(folder: Path) -> str:
    """The convention that all BVH names of a folder follow.

    Raises:
        InputError: if there is none.
    """
    stems = [path.stem for path in _bvh_files(folder)]
    if (folder / "Frame_Cuts.csv").is_file():
        return "100style"
    for kind, pattern in (("bandai", BANDAI), ("xia", XIA), ("100style", STYLE_GAIT)):
        if stems and all(pattern.fullmatch(stem) for stem in stems):
            return kind
    if any((folder / f"{stem}.phase").is_file() for stem in stems):
        return "pfnn"
    if not stems and any(_bvh_files(child) for child in folder.iterdir() if child.is_dir()):
        return "folders"
    found = f"{len(stems)} BVH files, as {stems[0]}.bvh" if stems else "no BVH files"
    rule = "name files dataset-N_CONTENT_STYLE_ID, STYLE_GAIT or STYLE_CC_TTT, or make one folder per style"
    raise InputError(folder, "folder", found, rule)


def load_clip(clip_file: ClipFile, *, fps: float = 60.0, roles_file: str | Path | None = None) -> MotionClip:
    """Read a listed clip, cut it to its frames and resample it.

    Raises:
        InputError: as `read_bvh`; or if the cut starts beyond the take.
    """
    clip = read_bvh(clip_file.path, unit=clip_file.unit, roles_file=roles_file)
    if clip_file.start or clip_file.stop is not None:
        stop = clip.num_frames if clip_file.stop is None else min(clip_file.stop, clip.num_frames)
        clip = cut(clip, clip_file.start, stop)
    return replace(resample(clip, fps), style=clip_file.style, content=clip_file.content)


def check_style_name(name: str, source: str | Path = "style") -> str:
    """The name, if it can name a folder on every system.

    Raises:
        InputError: if it is empty, longer than 100 characters, starts with a dot, ends with a dot or space, or holds a
            slash, a control character or one of `<>:"|?*`.
    """
    bad = not name or len(name) > 100 or name.startswith((".", " ")) or name.endswith((".", " "))
    if bad or not name.isprintable() or re.search(r'[/\\<>:"|?*]', name):
        shown = ascii(name) if len(name) <= 40 else ascii(name[:37]) + "..."
        rule = "must be a file name: 1 to 100 printable characters, no slash, no leading dot"
        raise InputError(source, "style name", shown, rule)
    return name


def is_symmetric(style: str) -> bool:
    """Whether a style may be mirrored, by the papers' lists of styles that were not."""
    return style.lower() not in ASYMMETRIC


def _bvh_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() == ".bvh" and path.is_file())


def _match(pattern: re.Pattern[str], path: Path, rule: str) -> re.Match[str]:
    found = pattern.fullmatch(path.stem)
    if found is None:
        raise InputError(path, "file name", path.name, f"files of this kind are named {rule}.bvh")
    return found


def _bandai_file(path: Path) -> ClipFile:
    found = _match(BANDAI, path, "dataset-N_CONTENT_STYLE_ID")
    content = swap_sides(found[2]) if path.stem in BANDAI_MISLABELLED else found[2]
    return ClipFile(path, found[3], content, unit=CENTIMETRE)


def _xia_file(path: Path) -> ClipFile:
    found = _match(XIA, path, "STYLE_CONTENT_TAKE")
    return ClipFile(path, found[1], XIA_CONTENTS.get(found[2], found[2]), unit=CMU)


def _single(path: Path) -> ClipFile:
    """A file alone: labelled by its name where that follows a convention, else its name is its style."""
    if BANDAI.fullmatch(path.stem):
        clip = _bandai_file(path)
    elif XIA.fullmatch(path.stem):
        clip = _xia_file(path)
    elif (path.parent / "Frame_Cuts.csv").is_file() and STYLE_GAIT.fullmatch(path.stem):
        clip = _100style_files(path.parent, [path])[0]
    else:
        clip = ClipFile(path, path.stem, "", is_symmetric(path.stem))
    check_style_name(clip.style, path)
    return clip


def _list_bandai(folder: Path) -> list[ClipFile]:
    return [_bandai_file(path) for path in _bvh_files(folder)]


def _list_xia(folder: Path) -> list[ClipFile]:
    return [_xia_file(path) for path in _bvh_files(folder)]


def _list_pfnn(folder: Path) -> list[ClipFile]:
    paths = [path for path in _bvh_files(folder) if path.with_suffix(".phase").is_file()]
    return [ClipFile(path, "neutral", path.stem, unit=CMU) for path in paths if not path.stem.endswith("_mirror")]


def _list_folders(folder: Path) -> list[ClipFile]:
    listed = folder / "asymmetric.txt"
    asymmetric = {line.strip().lower() for line in _read_lines(listed)} - {""} if listed.is_file() else ASYMMETRIC
    styles = sorted(child for child in folder.iterdir() if child.is_dir() and _bvh_files(child))
    unknown = asymmetric - {child.name.lower() for child in styles}
    if unknown and listed.is_file():
        raise InputError(listed, "line", sorted(unknown)[0], "must be the name of a style folder beside this file")
    return [
        ClipFile(path, style.name, path.stem, style.name.lower() not in asymmetric)
        for style in styles
        for path in _bvh_files(style)
    ]


def _list_100style(folder: Path) -> list[ClipFile]:
    inner = [path for child in sorted(folder.iterdir()) if child.is_dir() for path in _bvh_files(child)]
    return _100style_files(folder, _bvh_files(folder) + inner)


def _100style_files(folder: Path, paths: list[Path]) -> list[ClipFile]:
    cuts_file, list_file = folder / "Frame_Cuts.csv", folder / "Dataset_List.csv"
    cuts = _read_table(cuts_file, "STYLE_NAME")
    symmetric = {}
    if list_file.is_file():
        for style, (line, row) in _read_table(list_file, "Style Name").items():
            symmetric[style] = _yes(list_file, line, row.get("Symmetric"))
    clips = []
    for path in paths:
        style, gait = _match(STYLE_GAIT, path, "STYLE_GAIT").groups()
        start, stop = _frame_cut(cuts_file, cuts, style, gait)
        mirrored = symmetric.get(style, is_symmetric(style))
        clips.append(ClipFile(path, style, GAITS[gait], mirrored, start, stop, CENTIMETRE))
    return clips


def _frame_cut(file: Path, cuts: dict, style: str, gait: str) -> tuple[int, int]:
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
        raise InputError(file, f"line {line}", shown, "must be whole frame numbers, the start before the stop")
    return start, stop


def _yes(file: Path, line: int, value: str | None) -> bool:
    if value not in ("Yes", "No"):
        raise InputError(file, f"line {line}", f"Symmetric {value}", "must be Yes or No")
    return value == "Yes"


def _read_lines(file: Path) -> list[str]:
    try:
        return file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            file, "file", getattr(error, "strerror", None) or "not text", "must be readable text"
        ) from None


def _read_table(file: Path, key: str) -> dict[str, tuple[int, dict]]:
    """Rows of a CSV file by the value of one column, with their line numbers."""
    if not file.is_file():
        raise InputError(file, "file", "absent", "100STYLE takes start with calibration and must be cut by this table")
    reader = csv.DictReader(_read_lines(file))
    try:
        rows = [(reader.line_num, row) for row in reader]
    except csv.Error as error:
        raise InputError(file, f"line {reader.line_num}", error, "must be a table of comma-separated values") from None
    if key not in (reader.fieldnames or ()):
        raise InputError(file, "line 1", f"no column {key}", f"the first line names the columns, {key} among them")
    return {row[key]: (line, row) for line, row in rows}


KINDS: dict[str, Callable[[Path], list[ClipFile]]] = {
    "bandai": _list_bandai,
    "100style": _list_100style,
    "xia": _list_xia,
    "pfnn": _list_pfnn,
    "folders": _list_folders,
}
