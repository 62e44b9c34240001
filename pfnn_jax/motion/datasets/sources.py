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

import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import CENTIMETRE, CMU, read_bvh
from pfnn_jax.motion.clip import MotionClip, cut, resample, swap_sides
from pfnn_jax.motion.datasets.clip_file import ASYMMETRIC, ClipFile, is_symmetric
from pfnn_jax.motion.datasets.style100 import CUTS, STYLE_GAIT, read_lines, style100_files

BANDAI = re.compile(r"(dataset-\d+)_([a-z-]+)_([a-z]+)_(\d+)", re.IGNORECASE)
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


def clips_of_styles(clips: Iterable[ClipFile], styles: Collection[str], source: str | Path) -> list[ClipFile]:
    """The clips of some styles.

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
    """The convention that all BVH names of a folder follow.

    Raises:
        InputError: if there is none.
    """
    stems = [path.stem for path in _bvh_files(folder)]
    if (folder / CUTS).is_file():
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


@dataclass(frozen=True, eq=False)
class Take:
    """A clip as its file has it, cut but not resampled.

    Attributes:
        clip: the frames used, at the file's rate.
        start: frame of the file that is the clip's first.
        frames_in_file: all of the file's frames.
        note: what was found odd about it; empty for nothing.
    """

    clip: MotionClip
    start: int
    frames_in_file: int
    note: str = ""


def read_take(clip_file: ClipFile, roles_file: str | Path | None = None) -> Take:
    """Reads a listed clip and cuts it to its frames.

    A stop beyond the take means its end, and is noted.

    Raises:
        InputError: as `read_bvh`; or if the cut starts beyond the take, naming the table that says so.
    """
    path = Path(clip_file.path)
    whole = read_bvh(path, unit=clip_file.unit, roles_file=roles_file)
    stop = whole.num_frames if clip_file.stop is None else clip_file.stop
    file, place = clip_file.cut_by or (path, "cut")
    if clip_file.start >= whole.num_frames:
        rule = f"must lie within the {whole.num_frames} frames of {path.name}"
        raise InputError(file, place, f"start {clip_file.start}", rule)
    note = ""
    if stop > whole.num_frames:
        note = f"{place}: stop {stop} lies beyond the take's {whole.num_frames} frames, its end is used"
    part = cut(whole, clip_file.start, min(stop, whole.num_frames))
    part = replace(part, style=clip_file.style, content=clip_file.content)
    return Take(part, clip_file.start, whole.num_frames, note)


def load_clip(clip_file: ClipFile, *, fps: float = 60.0, roles_file: str | Path | None = None) -> MotionClip:
    """Reads a listed clip, cut to its frames and resampled.

    Raises:
        InputError: as `read_take`.
    """
    return resample(read_take(clip_file, roles_file).clip, fps)


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
    elif (path.parent / CUTS).is_file() and STYLE_GAIT.fullmatch(path.stem):
        clip = style100_files(path.parent, [path])[0]
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
    asymmetric = {line.strip().lower() for line in read_lines(listed)} - {""} if listed.is_file() else ASYMMETRIC
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
    return style100_files(folder, _bvh_files(folder) + inner)


KINDS: dict[str, Callable[[Path], list[ClipFile]]] = {
    "bandai": _list_bandai,
    "100style": _list_100style,
    "xia": _list_xia,
    "pfnn": _list_pfnn,
    "folders": _list_folders,
}
