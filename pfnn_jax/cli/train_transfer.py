"""`pfnn-jax train-transfer`: a network that puts any clip into one style."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import FLAT, Command, Reading
from pfnn_jax.motion.reading import ReadOptions
from pfnn_jax.transfer.config import TransformationTrainingConfig


@dataclass(frozen=True, kw_only=True)
class TrainTransfer(Command):
    """Train a network that puts any clip into one style, for `transfer --run`. One run holds many styles.

    Attributes:
        data: folder of clips, with one folder per style, or a known data set. The clips of other styles are the
            contents to train on.
        style: one of its styles.
        out: folder of the run; one that exists gets the style as one more.
        autoencoder: run whose autoencoder a new run takes; by default that of the package.
        kind: naming convention of the files; auto recognises it.
        roles: JSON file that names the joints' roles.
        reading: what is known about the files, where it is not found or wrong.
        overwrite: replace a style of this name.
        config: how to train.
    """

    data: Annotated[Positional[Path], tyro.conf.arg(metavar="DATA")]
    style: str
    out: Path
    autoencoder: Annotated[Path | None, tyro.conf.arg(metavar="RUN")] = None
    kind: Literal["auto", "bandai", "100style", "xia", "pfnn", "folders"] = "auto"
    roles: Path | None = None
    reading: Reading = ReadOptions()
    overwrite: bool = False
    config: Annotated[TransformationTrainingConfig, FLAT] = field(default_factory=TransformationTrainingConfig)

    def run(self) -> Any:
        from pfnn_jax.cli.progress import progress
        from pfnn_jax.motion.datasets.sources import list_clips, select_styles

        clips = list_clips(self.data, self.kind, self.reading)
        select_styles(clips, [self.style], self.data)
        from pfnn_jax.workflows.transfer_training import train_transfer

        with progress("training") as report:
            info = train_transfer(
                clips,
                self.style,
                self.out,
                self.config,
                autoencoder=self.autoencoder,
                roles_file=self.roles,
                overwrite=self.overwrite,
                progress_callback=lambda share, what: report(share, 1.0, what),
            )
        for note in info["notes"]:
            print(f"note: {note}")
        print(f"{self.style}: {len(info['sources'])} clips, {info['contents']} contents; {info['seconds']:.1f} s")
        before, after = (info["metrics"][name].get("loss") for name in ("held_out_before", "held_out"))
        if after is not None:
            print(f"held-out loss {after:.3f}, before training {before:.3f}")
        print(f"next: {self._next()}")
        return info

    def _next(self) -> str:
        """Returns the command that puts a clip into the style."""
        words = ["--run", str(self.out), "--style", self.style, "--out", f"{self.style}_CLIP.bvh"]
        return shlex.join(["pfnn-jax", "transfer", "CLIP.bvh", *words])
