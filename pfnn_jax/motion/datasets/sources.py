"""Lists the clips of a motion capture folder: style, content, frames used, and whether they may be mirrored.

Five naming conventions are recognised, of BVH and of glTF files (`clip_files.CLIP_SUFFIXES`):

- `bandai`: `dataset-N_CONTENT_STYLE_ID.bvh` (Bandai-Namco Research Motion Dataset 1 and 2).
- `100style`: `STYLE_GAIT.bvh`, in the folder or in one folder per style, with `Frame_Cuts.csv` and, for symmetry,
  `Dataset_List.csv` (100STYLE, Mason et al. 2022).
- `xia`: `STYLE_CONTENT_TAKE.bvh` with a two-digit content and a three-digit take (Xia et al. 2015).
- `pfnn`: `NAME.bvh` with `NAME.phase` (Holden et al. 2017), all of style `neutral`. Files without a `.phase` file are
  skipped, and so are `_mirror` files: mirrored copies are made from the clips themselves.
- `folders`: one folder of clips per style, named after the style; the files may lie in folders of it. Styles are
  mirrored except those listed in `asymmetric.txt` (one per line, in the folder of the style folders); without that
  file, except the papers' asymmetric styles.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import swap_sides
from pfnn_jax.motion.clip_files import is_clip_file, is_gltf_file
from pfnn_jax.motion.datasets.clip_table import read_options
from pfnn_jax.motion.datasets.style100 import CUTS, GAITS, STYLE_GAIT, read_lines, read_tables
from pfnn_jax.motion.length_unit import CENTIMETRE, CMU
from pfnn_jax.motion.reading import ReadOptions

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

BANDAI = re.compile(r"(dataset-\d+)_([a-z-]+)_([a-z]+)_(\d+)", re.IGNORECASE)
XIA = re.compile(r"([a-z]+)_(\d\d)_(\d{3})", re.IGNORECASE)
# other numbers are kept as the content
XIA_CONTENTS = {"01": "walk", "13": "run", "16": "jump", "18": "punch", "22": "kick"}

# These turn the other way than their names say, by the net change of the hips' heading (right_normal_004 turns twice).
BANDAI_MISLABELLED = {
    "dataset-2_walk-turn-left_masculine_006",
    "dataset-2_walk-turn-left_masculine_007",
    "dataset-2_walk-turn-right_masculine_006",
    "dataset-2_walk-turn-right_masculine_007",
    "dataset-2_walk-turn-right_normal_004",
}


@dataclass(frozen=True)
class ClipFile:
    """A clip on disk, described before it is read.

    Attributes:
        path: a BVH or glTF file (`clip_files.CLIP_SUFFIXES`); a string becomes a `Path`.
        style: name of the style, valid as a file name.
        content: what is performed, such as `walk` or `walk-turn-left`; empty if unknown.
        symmetric: whether the style may be mirrored.
        start, stop: frames used, at the file's own rate; stop None means to the end, and so does a stop beyond the
            end, as in shortened files.
        unit: metres per unit of the file, as its data set's convention says; None to guess it.
        cut_by: (file, place) that states start and stop, for messages; None if they come from no file.
        reading: what the user says about the file, which takes precedence.
        data_set: name of the folder that was listed (`list_data_sets`), whose files share a unit.
        roles_file: JSON file that names the joints' roles in this file; None for that of the call that reads it.
    """

    path: Path
    style: str
    content: str = ""
    symmetric: bool = True
    start: int = 0
    stop: int | None = None
    unit: float | None = None
    cut_by: tuple[Path, str] | None = None
    reading: ReadOptions = ReadOptions()
    data_set: str = ""
    roles_file: Path | None = None

    if TYPE_CHECKING:  # callers may pass a string, readers always find a Path

        def __init__(
            self,
            path: str | Path,
            style: str,
            content: str = "",
            symmetric: bool = True,
            start: int = 0,
            stop: int | None = None,
            unit: float | None = None,
            cut_by: tuple[Path, str] | None = None,
            reading: ReadOptions = ...,
            data_set: str = ...,
            roles_file: Path | None = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", Path(self.path))

    @property
    def read_options(self) -> ReadOptions:
        """What is known about the file: what the user says, and the unit of its convention."""
        known = self.reading.unit is not None or is_gltf_file(self.path)  # which are in metres
        return self.reading if known else replace(self.reading, unit=self.unit)


def is_symmetric(style: str) -> bool:
    """Returns whether a style may be mirrored, by the papers' lists of styles that were not."""
    return style.lower() not in ASYMMETRIC


def list_clips(folder: str | Path, kind: str = "auto", reading: ReadOptions | None = None) -> list[ClipFile]:
    """Lists the clips of a folder, ordered by file name.

    A table `clips.csv` in the folder may say how files are to be read, see `clip_table`.

    Args:
        folder: folder in one of the module's conventions, or one file, whose style is taken from its name.
        kind: bandai, 100style, xia, pfnn or folders; auto recognises it by the names.
        reading: what is known about all files; the table takes precedence.

    Raises:
        InputError: if the folder is absent, holds no clip or follows another convention or none; if a style is not a
            valid file name; if its tables lack a clip or are malformed.
    """
    folder, reading = Path(folder), reading or ReadOptions()
    if kind not in ("auto", *KINDS):
        raise InputError(folder, "kind", kind, f"must be auto, {', '.join(KINDS)}")
    if folder.is_file():
        return [replace(_single(folder), reading=reading)]
    if not folder.is_dir():
        raise InputError(folder, "folder", "absent", "must be a folder of BVH or glTF files, or one file")
    kind = find_kind(folder) if kind == "auto" else kind
    clips = KINDS[kind](folder)
    if not clips:
        raise InputError(folder, "folder", "no clips", f"must hold clips of kind {kind}")
    for clip in clips:
        check_style_name(clip.style, clip.path)
    options = read_options(folder, [clip.path for clip in clips], reading)
    return [replace(clip, reading=found, roles_file=roles) for clip, (found, roles) in zip(clips, options, strict=True)]


def unlisted_files(folder: str | Path, clips: Iterable[ClipFile]) -> list[Path]:
    """Returns the files with clips in a folder, at any depth, that are not among its clips."""
    folder = Path(folder)
    listed = {clip.path for clip in clips}
    return [path for path in _clips_below(folder) if path not in listed] if folder.is_dir() else []


def select_styles(clips: Iterable[ClipFile], styles: Collection[str], source: str | Path) -> list[ClipFile]:
    """Returns the clips of some styles.

    Args:
        clips: as `list_clips` returns them.
        styles: names of the styles to keep.
        source: where the clips come from, for messages.

    Raises:
        InputError: for a style that no clip has.
    """
    clips = list(clips)
    found = sorted({clip.style for clip in clips})
    for style in styles:
        if style not in found:
            raise InputError(source, "style", style, f"must be one of {', '.join(found)}")
    return [clip for clip in clips if clip.style in styles]


def find_kind(folder: Path) -> str:
    """Returns the naming convention that all clips of a folder follow.

    Raises:
        InputError: if there is none.
    """
    stems = [path.stem for path in _clips_in(folder)]
    if (folder / CUTS).is_file():
        return "100style"
    for kind, pattern in (("bandai", BANDAI), ("xia", XIA), ("100style", STYLE_GAIT)):
        if stems and all(pattern.fullmatch(stem) for stem in stems):
            return kind
    if any((folder / f"{stem}.phase").is_file() for stem in stems):
        return "pfnn"
    if not stems and _clips_below(folder):
        return "folders"
    found = f"{len(stems)} clips, such as {stems[0]}" if stems else "no BVH or glTF files"
    rule = "name files dataset-N_CONTENT_STYLE_ID, STYLE_GAIT or STYLE_CC_TTT, or make one folder per style"
    raise InputError(folder, "folder", found, rule)


def check_style_name(name: str, source: str | Path = "style") -> str:
    """Returns a style's name if it can name a folder on every system.

    Raises:
        InputError: if it is empty, longer than 100 characters or 200 bytes, starts with a dot, ends with a dot or
            space, or holds a slash, a control character or one of `<>:"|?*`.
    """
    too_long = len(name) > 100 or len(name.encode(errors="replace")) > 200  # file systems count bytes
    bad = not name or too_long or name.startswith((".", " ")) or name.endswith((".", " "))
    if bad or not name.isprintable() or re.search(r'[/\\<>:"|?*]', name):
        shown = repr(name) if len(name) <= 40 else repr(name[:37]) + "..."
        size = "at most 100 characters and 200 bytes"
        rule = f'must be a file name: {size}, none of / \\ < > : " | ? *, no dot or space at its ends'
        raise InputError(source, "style name", shown, rule)
    return name


def _clips_in(folder: Path) -> list[Path]:
    """Returns the files of a folder that hold clips, by their suffixes."""
    return sorted(path for path in folder.iterdir() if is_clip_file(path) and path.is_file())


def _clips_below(folder: Path) -> list[Path]:
    """Returns the files with clips of a folder and of its sub-folders at any depth."""
    return sorted(path for path in folder.rglob("*") if is_clip_file(path) and path.is_file())


def _match(pattern: re.Pattern[str], path: Path, form: str) -> re.Match[str]:
    found = pattern.fullmatch(path.stem)
    if found is None:
        raise InputError(path, "file name", path.name, f"must be {form}.bvh")
    return found


def _bandai_file(path: Path) -> ClipFile:
    found = _match(BANDAI, path, "dataset-N_CONTENT_STYLE_ID")
    content = swap_sides(found[2]) if path.stem in BANDAI_MISLABELLED else found[2]
    return ClipFile(path, found[3], content, unit=CENTIMETRE)


def _xia_file(path: Path) -> ClipFile:
    found = _match(XIA, path, "STYLE_CONTENT_TAKE")
    return ClipFile(path, found[1], XIA_CONTENTS.get(found[2], found[2]), unit=CMU)


def style100_files(folder: Path, paths: Iterable[Path]) -> list[ClipFile]:
    """Describes clips of 100STYLE by their names and the tables of their folder.

    Args:
        folder: of the tables. Without `Dataset_List.csv`, symmetry follows the paper's list (`is_symmetric`).
        paths: files with clips.

    Raises:
        InputError: for another file name, or a table that lacks a clip or is malformed.
    """
    tables = read_tables(folder)
    clips = []
    for path in paths:
        style, gait = _match(STYLE_GAIT, path, "STYLE_GAIT").groups()
        cut, symmetric = tables.cut(style, gait), tables.symmetric.get(style, is_symmetric(style))
        clips.append(ClipFile(path, style, GAITS[gait], symmetric, cut.start, cut.stop, CENTIMETRE, cut.place))
    return clips


def _single(path: Path) -> ClipFile:
    """Describes one file: by its name if that follows a convention, otherwise its name is its style."""
    if BANDAI.fullmatch(path.stem):
        clip = _bandai_file(path)
    elif XIA.fullmatch(path.stem):
        clip = _xia_file(path)
    elif (path.parent / CUTS).is_file() and STYLE_GAIT.fullmatch(path.stem):
        clip = style100_files(path.parent, [path])[0]
    else:
        clip = ClipFile(path, path.stem, "", is_symmetric(path.stem))
    check_style_name(clip.style, path)
    return clip


def _list_bandai(folder: Path) -> list[ClipFile]:
    return [_bandai_file(path) for path in _clips_in(folder)]


def _list_100style(folder: Path) -> list[ClipFile]:
    inner = [path for child in sorted(folder.iterdir()) if child.is_dir() for path in _clips_in(child)]
    return style100_files(folder, _clips_in(folder) + inner)


def _list_xia(folder: Path) -> list[ClipFile]:
    return [_xia_file(path) for path in _clips_in(folder)]


def _list_pfnn(folder: Path) -> list[ClipFile]:
    paths = [path for path in _clips_in(folder) if path.with_suffix(".phase").is_file()]
    return [ClipFile(path, "neutral", path.stem, unit=CMU) for path in paths if not path.stem.endswith("_mirror")]


def _list_folders(folder: Path) -> list[ClipFile]:
    listed = folder / "asymmetric.txt"
    asymmetric = {line.strip().lower() for line in read_lines(listed)} - {""} if listed.is_file() else ASYMMETRIC
    styles = sorted(child for child in folder.iterdir() if child.is_dir() and _clips_below(child))
    unknown = asymmetric - {child.name.lower() for child in styles}
    if unknown and listed.is_file():
        raise InputError(listed, "line", sorted(unknown)[0], "must be the name of a style folder")
    return [
        ClipFile(path, style.name, path.stem, style.name.lower() not in asymmetric)
        for style in styles
        for path in _clips_below(style)
    ]


KINDS: dict[str, Callable[[Path], list[ClipFile]]] = {
    "bandai": _list_bandai,
    "100style": _list_100style,
    "xia": _list_xia,
    "pfnn": _list_pfnn,
    "folders": _list_folders,
}
