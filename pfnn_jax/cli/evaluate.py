"""`pfnn-jax evaluate`: one-step errors of a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import Command, Reading, Run, open_run, print_notes
from pfnn_jax.motion.reading import ReadOptions


@dataclass(frozen=True, kw_only=True)
class Evaluate(Command):
    """Measure one-step errors of a run on clips that it has not seen, by style and by group of outputs.

    Attributes:
        run_path: a run, or `base`.
        source: folder of clips (BVH, GLB, glTF, VRM), or one file.
        style: style of the run to test on all clips; by default the one that each clip is named after.
        roles: JSON file that names the joints' roles.
        reading: what is known about the files, where it is not found or wrong.
    """

    run_path: Run
    source: Annotated[Positional[Path], tyro.conf.arg(metavar="FOLDER")]
    style: str | None = None
    roles: Path | None = None
    reading: Reading = ReadOptions()

    def run(self) -> Any:
        from pfnn_jax.motion.datasets.sources import list_clips

        path = open_run(self.run_path)
        clips = list_clips(self.source, reading=self.reading)
        from pfnn_jax.evaluation.clips import evaluate_clips
        from pfnn_jax.run import load_run

        result = evaluate_clips(load_run(path), clips, self.style, self.roles)
        print("mean squared one-step error / variance of the training data: lower is better, 1.0 = predicting the mean")
        for style, errors in result.items():
            for file, note in errors.get("notes", {}).items():
                print_notes(file, [note])
            print(f"{style}: {_groups(errors)}")
            if "without_style" in errors:
                print(f"{style}, without a style: {_groups(errors['without_style'])}")
            if errors.get("all", 0.0) > 1.0:
                print(f"warning: {style}: an error above 1.0 is worse than predicting the mean")
        return result


def _groups(errors: dict[str, Any]) -> str:
    return "  ".join(f"{name} {value:.3f}" for name, value in errors.items() if isinstance(value, float))
