"""Commands that make data: datasets and phase labels, and a picture of local phases."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import Positional as Argument

from pfnn_jax.cli.base import FLAT, Command, check_file
from pfnn_jax.cli.progress import clip_progress
from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.phase_plot import phase_plot
from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.clip import resample
from pfnn_jax.motion.datasets.dataset import Dataset, prepare
from pfnn_jax.motion.datasets.preparation import PrepareConfig
from pfnn_jax.motion.datasets.sources import clips_of_styles, list_clips
from pfnn_jax.motion.datasets.splits import WINDOW
from pfnn_jax.motion.labels.local_phase import LocalPhaseConfig
from pfnn_jax.motion.labels.phase import label_phase, write_phase
from pfnn_jax.motion.trajectory import LAYOUT_FPS
from pfnn_jax.viewer.draw.drawing import save_figure


@dataclass(frozen=True, kw_only=True)
class Prepare(Command):
    """From folders of BVH files to a dataset that training reads.

    Attributes:
        source: folder of BVH files: one folder per style, or a known data set.
        out: the dataset's folder.
        kind: convention of the file names; auto finds it.
        styles: styles to keep; all by default.
        roles: JSON that names the joints' roles where they are not found by themselves.
        overwrite: replace an existing dataset.
        workers: processes; by default one per processor where there is much to read. The dataset is the same.
        config: how clips become rows.
    """

    source: Annotated[Argument[Path], tyro.conf.arg(metavar="FOLDER")]
    out: Path
    kind: Literal["auto", "bandai", "100style", "xia", "pfnn", "folders"] = "auto"
    styles: tuple[str, ...] = ()
    roles: Path | None = None
    overwrite: bool = False
    workers: int | None = None
    config: Annotated[PrepareConfig, FLAT] = field(default_factory=PrepareConfig)

    def run(self) -> Any:
        clips = list_clips(self.source, self.kind)
        clips = clips_of_styles(clips, self.styles, self.source) if self.styles else clips
        with clip_progress() as progress:
            dataset = prepare(
                clips,
                self.out,
                self.config,
                roles_file=self.roles,
                overwrite=self.overwrite,
                progress=progress,
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


def _print_dataset(dataset: Dataset) -> None:
    for note in dataset.notes:
        print(f"note: {note['file']}: {note['note']}")
    for skipped in dataset.skipped:
        print(f"left out: {skipped['file']}: {skipped['reason']}")
    for split, takes in dataset.takes_without_window.items():
        if short := sum(takes.values()):
            print(f"{split}: {short} takes, mirrored ones included, are shorter than {WINDOW} rows: one window, padded")
    for split, rows in dataset.rows.items():
        least, most = min(rows.values()), max(rows.values())
        print(f"{dataset.path}: {split}: {len(rows)} styles of {least} to {most} rows, {sum(rows.values())} in all")


@dataclass(frozen=True, kw_only=True)
class LabelPhase(Command):
    """Find the phase of a clip and write it as a `.phase` file, which a person can correct.

    Attributes:
        clip: BVH file.
        out: the `.phase` file: one value in cycles for each frame of the BVH file; 0 = right foot contact.
        roles: JSON that names the joints' roles.
        overwrite: replace an existing file.
    """

    clip: Annotated[Argument[Path], tyro.conf.arg(metavar="CLIP.bvh")]
    out: Path
    roles: Path | None = None
    overwrite: bool = False

    def run(self) -> Any:
        check_file(self.out, ".phase", self.overwrite)
        labels = label_phase(read_bvh(self.clip, roles_file=self.roles))
        write_phase(self.out, labels, overwrite=self.overwrite)
        steps = len(labels.contacts_right) + len(labels.contacts_left)
        print(f"{self.out}: {steps} steps, {int(labels.labelled.sum())} of {labels.num_frames} frames labelled")
        return {"steps": steps, "labelled": int(labels.labelled.sum()), "frames": labels.num_frames}


@dataclass(frozen=True, kw_only=True)
class PlotPhase(Command):
    """Draw the local phases of hands and toes over time.

    Attributes:
        clip: BVH file.
        out: the picture, a PNG file.
        start: seconds into the clip at which the picture begins.
        seconds: how much of the clip it shows. Phases are always those of the whole clip.
        roles: JSON that names the joints' roles.
        overwrite: replace an existing file.
        config: when a toe touches the ground.
    """

    clip: Annotated[Argument[Path], tyro.conf.arg(metavar="CLIP.bvh")]
    out: Path
    start: float = 0.0
    seconds: float = 6.0
    roles: Path | None = None
    overwrite: bool = False
    config: Annotated[LocalPhaseConfig, FLAT] = field(default_factory=LocalPhaseConfig)

    def run(self) -> Any:
        check_file(self.out, ".png", self.overwrite)
        clip = resample(read_bvh(self.clip, roles_file=self.roles), LAYOUT_FPS)
        first, last = (round(second * clip.fps) for second in (self.start, self.start + self.seconds))
        if not 0 <= first < min(last, clip.num_frames - 1):
            shown = f"{self.seconds:g} seconds from {self.start:g}"
            rule = f"what is shown lies in the clip's {clip.num_frames / clip.fps:.1f} seconds"
            raise InputError(self.clip, "start and seconds", shown, rule)
        last = min(last, clip.num_frames - 1)
        save_figure(phase_plot(clip, config=self.config, span=(first, last), title=self.clip.stem), self.out)
        print(f"{self.out}: {(last - first) / clip.fps:.1f} seconds of {self.clip.name}")
        return {"first_frame": first, "last_frame": last, "fps": clip.fps}
