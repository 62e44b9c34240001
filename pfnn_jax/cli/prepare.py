"""`pfnn-jax prepare`: from folders of BVH files to a dataset."""

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
    """Turn folders of BVH files into a dataset for training.

    Attributes:
        source: folder of BVH files: one folder per style, or a known data set.
        out: folder of the dataset.
        kind: naming convention of the files; auto recognises it.
        styles: styles to keep; all by default.
        roles: JSON file that names the joints' roles, for skeletons whose joints are not recognised.
        reading: what is known about the files, where it is not found or wrong.
        overwrite: replace an existing dataset.
        skip_bad: leave out bad files and name them; otherwise all of them are refused together.
        workers: number of processes; by default one per processor if there is much to read. The dataset does not
            depend on it.
        config: how clips become rows.
    """

    source: Annotated[Positional[Path], tyro.conf.arg(metavar="FOLDER")]
    out: Path
    kind: Literal["auto", "bandai", "100style", "xia", "pfnn", "folders"] = "auto"
    styles: tuple[str, ...] = ()
    roles: Path | None = None
    reading: Reading = ReadOptions()
    overwrite: bool = False
    skip_bad: bool = False
    workers: int | None = None
    config: Annotated[PrepareConfig, FLAT] = field(default_factory=PrepareConfig)

    def run(self) -> Any:
        from pfnn_jax.cli.progress import progress
        from pfnn_jax.motion.datasets.preparation import prepare
        from pfnn_jax.motion.datasets.sources import list_clips, select_styles, unlisted_files

        check_output(self.out, self.overwrite)
        clips = list_clips(self.source, self.kind, self.reading)
        _print_unlisted(unlisted_files(self.source, clips))
        clips = select_styles(clips, self.styles, self.source) if self.styles else clips
        with progress("preparing") as report:
            dataset = prepare(
                clips,
                self.out,
                self.config,
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
        print(f"note: {len(files)} BVH files are not used, such as {files[0]}: their folder or name does not fit")


def _print_dataset(dataset: Dataset) -> None:
    from pfnn_jax.motion.datasets.splits import WINDOW_ROWS

    for note in dataset.notes:
        print(f"note: {note['file']}: {note['note']}")
    for skipped in dataset.skipped:
        print(f"left out: {skipped['file']}: {skipped['reason']}")
    for split, takes in dataset.takes_without_window.items():
        if short := sum(takes.values()):
            print(f"{split}: {short} takes (counting mirrored ones) are shorter than {WINDOW_ROWS} rows and are padded")
    for split, rows in dataset.rows.items():
        least, most = min(rows.values()), max(rows.values())
        print(f"{dataset.path}: {split}: {len(rows)} styles of {least} to {most} rows, {sum(rows.values())} in all")
