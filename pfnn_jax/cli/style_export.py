"""`pfnn-jax style export`: a style as one file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import Command, Run, check_output, open_run
from pfnn_jax.cli.style_show import print_card
from pfnn_jax.io.tensors import SUFFIX


@dataclass(frozen=True, kw_only=True)
class StyleExport(Command):
    """Write a style of a run as one file, which fits every copy of the run's network.

    Attributes:
        run_path: a run, or `base`.
        name: of one of its styles.
        out: file to write.
        licence: under which others may use the style, for example "CC BY 4.0". By default what the run says of it;
            nothing for a style that was learned here.
        overwrite: replace an existing file.
    """

    run_path: Run
    name: Annotated[Positional[str], tyro.conf.arg(metavar="NAME")]
    out: Annotated[Path, tyro.conf.arg(metavar="FILE.safetensors")]
    licence: Annotated[str | None, tyro.conf.arg(metavar="TEXT")] = None
    overwrite: bool = False

    def run(self) -> Any:
        from pfnn_jax.run_config import style_note

        check_output(self.out, self.overwrite, SUFFIX)
        path = open_run(self.run_path)
        style_note(path, self.name)
        from pfnn_jax.workflows.share_style import export_style

        card = export_style(path, self.name, self.out, licence=self.licence, overwrite=self.overwrite)
        print_card(self.out, card)
        return card
