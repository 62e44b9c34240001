"""`pfnn-jax prepare`: from folders of clips to a dataset."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import FLAT, Command, Reading, check_output
from pfnn_jax.motion.datasets.preparation import PrepareConfig
from pfnn_jax.motion.reading import ReadOptions

if TYPE_CHECKING:
    from pfnn_jax.motion.datasets.dataset import Dataset


@dataclass(frozen=True, kw_only=True)
class Prepare(Command):
    """Turn folders of BVH or glTF clips into a dataset for training.

    Attributes:
        folders: folders of BVH or glTF files, each with one folder per style, or a known data set. Styles that several
            have are named after their folder too: FOLDER_STYLE.
        out: folder of the dataset.
        kind: naming convention of the files; auto recognises it.
        skeleton: put all clips onto this skeleton: that of a file, `synthetic` (that of the procedural walkers), or
            the name of one of the folders, for that of its first clip. Without it all clips must share one.
        styles: styles to keep, by their names in the dataset; all by default.
        roles: JSON file that names the joints' roles, for skeletons whose joints are not recognised.
        reading: what is known about the files, where it is not found or wrong.
        overwrite: replace an existing dataset.
        skip_bad: leave out bad files and name them; otherwise all of them are refused together.
        workers: number of processes; by default one per processor if there is much to read. The dataset does not
            depend on it.
        config: how clips become rows.
    """

    folders: Annotated[Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FOLDER [FOLDER ...]")]
    out: Path
    kind: Literal["auto", "bandai", "100style", "xia", "pfnn", "folders"] = "auto"
    skeleton: Annotated[str | None, tyro.conf.arg(metavar="FILE|NAME")] = None
    styles: tuple[str, ...] = ()
    roles: Path | None = None
    reading: Reading = ReadOptions()
    overwrite: bool = False
    skip_bad: bool = False
    workers: int | None = None
    config: Annotated[PrepareConfig, FLAT] = field(default_factory=PrepareConfig)

    def run(self) -> Any:
        from pfnn_jax.cli.progress import progress
        from pfnn_jax.motion.datasets.data_sets import list_data_sets
        from pfnn_jax.motion.datasets.preparation import prepare
        from pfnn_jax.motion.datasets.sources import select_styles, unlisted_files
        from pfnn_jax.motion.datasets.target_skeleton import named_skeleton

        check_output(self.out, self.overwrite)
        clips = list_data_sets(self.folders, self.kind, self.reading)
        skeleton = None if self.skeleton is None else named_skeleton(self.skeleton, clips, self.reading)
        _print_unlisted([file for folder in self.folders for file in unlisted_files(folder, clips)])
        source = ", ".join(map(str, self.folders))
        clips = select_styles(clips, self.styles, source) if self.styles else clips
        with progress("preparing") as report:
            dataset = prepare(
                clips,
                self.out,
                self.config,
                skeleton=skeleton,
                roles_file=self.roles,
                overwrite=self.overwrite,
                skip_bad=self.skip_bad,
                progress_callback=report,
                workers=self.workers,
            )
        _print_dataset(dataset)
        return {
            "styles": dataset.styles,
            "frames_per_style": dataset.frames_per_style,
            "rows": dataset.rows,
            "skipped": dataset.skipped,
            "notes": dataset.notes,
            "takes_without_window": dataset.takes_without_window,
        }


def _print_unlisted(files: list[Path]) -> None:
    if files:
        print(f"note: {len(files)} clips are not used, such as {files[0]}: their folder or name does not fit")


def _files_of_notes(dataset: Dataset) -> dict[str, list[str]]:
    """Returns the files that each note is about."""
    files: dict[str, list[str]] = {}
    for note in dataset.notes:
        files.setdefault(note["note"], []).append(note["file"])
    return files


def _print_dataset(dataset: Dataset) -> None:
    from pfnn_jax.motion.datasets.splits import WINDOW_ROWS

    for note, files in _files_of_notes(dataset).items():
        others = f" (and {len(files) - 1} more)" if len(files) > 1 else ""
        print(f"note: {files[0]}{others}: {note}")
    for skipped in dataset.skipped:
        print(f"left out: {skipped['file']}: {skipped['reason']}")
    for split, takes in dataset.takes_without_window.items():
        if short := sum(takes.values()):
            print(f"{split}: {short} takes (counting mirrored ones) are shorter than {WINDOW_ROWS} rows and are padded")
    for split, rows in dataset.rows.items():
        least, most = min(rows.values()), max(rows.values())
        print(f"{dataset.path}: {split}: {len(rows)} styles of {least} to {most} rows, {sum(rows.values())} in all")
