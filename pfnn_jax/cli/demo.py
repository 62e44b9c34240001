"""`pfnn-jax demo`: the full pipeline on procedural motion."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pfnn_jax.cli.command import FLAT, Command
from pfnn_jax.demo.config import DemoConfig


@dataclass(frozen=True, kw_only=True)
class Demo(Command):
    """Run the full pipeline on procedural motion: pretraining, a new style from 3 seconds, generated walks, a report.

    Attributes:
        out: folder for all results.
        overwrite: replace what the folder holds.
        config: sizes.
    """

    out: Path = Path("demo")
    overwrite: bool = False
    config: Annotated[DemoConfig, FLAT] = field(default_factory=DemoConfig)

    def run(self) -> Any:
        from pfnn_jax.cli.progress import stages
        from pfnn_jax.io.files import refuse_existing

        if self.out.is_file() or (self.out.is_dir() and any(self.out.iterdir())):
            refuse_existing(self.out, self.overwrite)
        with stages("demo") as stage:
            from pfnn_jax.demo.pipeline import demo

            result = demo(self.out, self.config, overwrite=self.overwrite, on_stage=stage)
        print(f"Open {self.out / 'report.html'} in a browser.")
        return result
