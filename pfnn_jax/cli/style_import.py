"""`pfnn-jax style import`: the style of a file, into a run."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import Command, Run, open_run
from pfnn_jax.cli.style_show import print_card


@dataclass(frozen=True, kw_only=True)
class StyleImport(Command):
    """Save the style of a file in a run, if it was learned for that run's network.

    Attributes:
        run_path: a run, or `base`.
        file: as `pfnn-jax style export` writes it.
        name: of the style in the run; by default as in the file.
        overwrite: replace a style of this name.
    """

    run_path: Run
    file: Annotated[Positional[Path], tyro.conf.arg(metavar="FILE")]
    name: str | None = None
    overwrite: bool = False

    def run(self) -> Any:
        from pfnn_jax.run_config import check_new_style
        from pfnn_jax.workflows.style_card import read_style_card

        path, card = open_run(self.run_path), read_style_card(self.file)
        check_new_style(path, self.name or card.name, self.overwrite)
        from pfnn_jax.workflows.share_style import import_style

        card = import_style(path, self.file, self.name, overwrite=self.overwrite)
        print_card(self.file, card)
        out = f"{card.name}_walk.bvh"
        print(f"next: {shlex.join(['pfnn-jax', 'generate', str(self.run_path), '--style', card.name, '--out', out])}")
        return card
