"""`pfnn-jax export`: networks for game engines."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pfnn_jax.cli.command import Command, Run, check_output, open_run, parse_choice
from pfnn_jax.interop.export.formats import Format


@dataclass(frozen=True, kw_only=True)
class Export(Command):
    """Export a run's network for game engines, with a description of everything that they need to run it.

    Attributes:
        run_path: a run, or `base`.
        format: onnx or stablehlo, a function for one style; or bins, the files of the authors' demos.
        out: folder of the export.
        style: one of the run's styles, or a mixture `A:0.5+B:0.5` whose weights sum to one. By default the motion is
            style-agnostic, or on a FiLM run in the mean of its styles; bins and --film-input export all styles.
        film_input: for FiLM runs: make the style an input of the network, so that an engine can change it.
        tables: of bins: 4 tables over the phase, which determine the network, or the 50 that the authors' demos read.
        opset: version of the ONNX operators, from 15 (Unity Sentis 2.1) to 22; by default 18.
        overwrite: replace an earlier export.
    """

    run_path: Run
    format: Format
    out: Path
    style: str | None = None
    film_input: bool = False
    opset: int | None = None
    tables: Literal[4, 50] = 4
    overwrite: bool = False

    def run(self) -> Any:
        check_output(self.out, self.overwrite)
        path = open_run(self.run_path)
        style = parse_choice(self.style, path)
        from pfnn_jax.cli.progress import stages
        from pfnn_jax.interop.export.run import export_run
        from pfnn_jax.run import load_run

        run = load_run(path)
        with stages("exporting") as stage:
            stage(f"converting the network to {self.format} and checking it")
            description = export_run(
                run.path,
                self.format,
                self.out,
                style=style,
                film_input=self.film_input,
                opset=self.opset,
                tables=self.tables,
                overwrite=self.overwrite,
            )
        names = [style["name"] for style in description["styles"]]
        print(f"{self.out}: {self.format}, {description['layout']['name']}, {', '.join(names) or 'style-agnostic'}")
        network = description["network"]
        shown = {key: network[key] for key in ("kind", "file", "opset", "relative_error") if key in network}
        return {"out": self.out, "format": self.format, "styles": names, **shown}
