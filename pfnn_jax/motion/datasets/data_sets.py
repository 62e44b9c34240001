"""Lists the clips of several folders for one dataset, and gives their styles different names."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.motion.datasets.sources import ClipFile, check_style_name, list_clips
from pfnn_jax.motion.reading import ReadOptions


def list_data_sets(
    folders: Iterable[str | Path], kind: str = "auto", reading: ReadOptions | None = None
) -> list[ClipFile]:
    """Lists the clips of several folders, as `list_clips` does for one.

    Where folders have styles of the same name, upper and lower case alike, the name of the folder becomes a prefix:
    `bandai-namco-1_old`. Other styles keep their names. Folders of the same name are distinguished by those above them.

    Args:
        folders: folders, each of one convention, or files, which belong to the folder that they lie in.
        kind: as in `list_clips`.
        reading: what is known about all files; the table `clips.csv` of a folder takes precedence.

    Raises:
        InputError: as `list_clips`; for no folders, or a file that is listed twice; if a style still has the name of
            another folder's.
    """
    paths = [Path(folder) for folder in folders]
    if not paths:
        raise InputError("clips", "folders", "none", "name at least one")
    listed = [list_clips(path, kind, reading) for path in paths]
    clips = [
        replace(clip, data_set=name) for name, each in zip(_data_set_names(paths), listed, strict=True) for clip in each
    ]
    _check_listed_once(clips)
    return _name_styles(clips)


def _data_set_names(paths: Sequence[Path]) -> list[str]:
    """Returns the name of each folder, with as many of the folders above it as tell it from the others."""
    folders = [(path.parent if path.is_file() else path).resolve() for path in paths]

    def name(folder: Path) -> str:
        others = {other for other in folders if other != folder}
        for count in range(1, len(folder.parts)):
            tail = folder.parts[-count:]
            if all(other.parts[-count:] != tail for other in others):
                return "_".join(tail)
        return folder.name

    return [name(folder) for folder in folders]


def _check_listed_once(clips: Sequence[ClipFile]) -> None:
    seen: set[Path] = set()
    for clip in clips:
        path = clip.path.resolve()
        if path in seen:
            raise InputError(clip.path, "clip", "listed twice", "name every folder once, and none inside another")
        seen.add(path)


def _name_styles(clips: Sequence[ClipFile]) -> list[ClipFile]:
    """Returns the clips with styles that several data sets have named after those too."""
    shared = _shared_styles(clips)
    named = [
        replace(clip, style=check_style_name(f"{clip.data_set}_{clip.style}", clip.path))
        if clip.style.casefold() in shared
        else clip
        for clip in clips
    ]
    still = _shared_styles(named)
    for clip in named:
        if clip.style.casefold() in still:
            raise InputError(clip.path, "style", clip.style, "is a style of another folder too: rename the folder")
    return named


def _shared_styles(clips: Sequence[ClipFile]) -> set[str]:
    """Returns the styles that more than one data set has, in lower case."""
    owners: dict[str, set[str]] = defaultdict(set)
    for clip in clips:
        owners[clip.style.casefold()].add(clip.data_set)
    return {style for style, names in owners.items() if len(names) > 1}
