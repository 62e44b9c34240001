"""The command that writes networks for engines."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional as Argument

from pfnn_jax.cli.base import Command
from pfnn_jax.inference.mixture import parse_style
from pfnn_jax.interop.export.run import Format, export_run
from pfnn_jax.run import list_styles


@dataclass(frozen=True, kw_only=True)
class Export(Command):
    """A run's network in a format that engines read, with a description of all that they need beside it.

    Attributes:
        run_path: a run.
        format: onnx or stablehlo, a function with one style inside; or bins, the files of the authors' demos.
        out: the folder to make.
        style: one of the run's styles, or a mixture `A:0.5+B:0.5` whose weights sum to one. By default style-agnostic
            motion (of a FiLM run the mean of its styles); in bins, and with --film-input, all styles.
        film_input: of a FiLM run, leave the style an input of the network, so that an engine can change it.
        overwrite: replace an earlier export.
    """

    run_path: Annotated[Argument[Path], tyro.conf.arg(name="run", metavar="RUN")]
    format: Format
    out: Path
    style: str | None = None
    film_input: bool = False
    overwrite: bool = False

    def run(self) -> Any:
        style = None if self.style is None else parse_style(self.style, list_styles(self.run_path), self.run_path)
        told = export_run(
            self.run_path, self.format, self.out, style=style, film_input=self.film_input, overwrite=self.overwrite
        )
        names = ", ".join(entry["name"] for entry in told["styles"]) or "no style of its own"
        print(f"{self.out}: {self.format}, {told['layout']['name']}, {names}")
        network = {
            key: told["network"][key] for key in ("kind", "file", "opset", "relative_error") if key in told["network"]
        }
        return {"out": self.out, "format": self.format, "styles": [s["name"] for s in told["styles"]], **network}
