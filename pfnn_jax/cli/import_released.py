"""`pfnn-jax import-released`: a run from the authors' weights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import Command


@dataclass(frozen=True, kw_only=True)
class ImportReleased(Command):
    """Make a run from the authors' released weights, or from files that `export --format bins` has written.

    Attributes:
        kind: pfnn (Holden 2017), cp (the files of Mason 2018's demo, with their description), or lpn (Mason 2022, with
            its 100 styles); autoencoder (Holden 2016) makes a run of style transfer.
        directory: folder of `.bin` files: any four or more of the fifty tables for pfnn and cp, all files for lpn; for
            autoencoder, of `network_core.npz` and `preprocess_core.npz`.
        out: folder of the run.
        overwrite: replace an existing run.
    """

    kind: Positional[Literal["pfnn", "cp", "lpn", "autoencoder"]]
    directory: Annotated[Positional[Path], tyro.conf.arg(metavar="DIR")]
    out: Path
    overwrite: bool = False

    def run(self) -> Any:
        from pfnn_jax.workflows.runs import import_released, list_styles

        if self.kind == "autoencoder":
            transfer = import_released(self.kind, self.directory, self.out, overwrite=self.overwrite)
            print(f"{transfer.path}: {transfer.config.layout}")
            return {"run": transfer.path, "styles": 0, **transfer.config.training}
        run = import_released(self.kind, self.directory, self.out, overwrite=self.overwrite)
        styles = len(list_styles(run.path))
        print(f"{run.path}: {run.config.layout}" + (f", {styles} styles" if styles else ""))
        return {"run": run.path, "styles": styles, **run.config.pretrain}
