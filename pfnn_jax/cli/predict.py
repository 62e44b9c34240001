"""`pfnn-jax predict`: a run's network on rows of a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import Command, Run, check_output, open_run, parse_choice
from pfnn_jax.errors import InputError
from pfnn_jax.inference.modes import LayerNorm, Mode


@dataclass(frozen=True, kw_only=True)
class Predict(Command):
    """Evaluate a run's network on rows of a file.

    Attributes:
        run_path: a run, or `base`. Of a run of style transfer, the motion autoencoder is evaluated.
        rows: `.npz` file with `x` in the layout's units and `phase` in radians, or `gating_x` for a gating network.
            `style` [N], or `styles` [N, M] with `weights` [N, M], select each row's own style by its index in the run.
            For a motion autoencoder `x` alone, the even number of frames of one clip.
        out: `.npz` file for the outputs `y`, in the layout's units; of a motion autoencoder also the `hidden` units.
        style: one style of the run, or a mixture as in `generate`, for all rows.
        mode: cubic evaluates the network itself; constant50 and nearest50 a table of 50 slices of a global phase, whose
            index is truncated or rounded.
        layer_norm: statistics of FiLM runs: population, or sample as in the authors' training code.
        overwrite: replace an existing file.
    """

    run_path: Run
    rows: Annotated[Positional[Path], tyro.conf.arg(metavar="IN.npz")]
    out: Path
    style: str | None = None
    mode: Mode = "cubic"
    layer_norm: LayerNorm = "population"
    overwrite: bool = False

    def run(self) -> Any:
        check_output(self.out, self.overwrite, ".npz")
        from pfnn_jax.run_config import TRANSFER, kind_at

        if kind_at(self.run_path) == TRANSFER:
            return self._reconstruct()
        path = open_run(self.run_path)
        style = parse_choice(self.style, path)
        from pfnn_jax.inference.rows import predict_file

        y = predict_file(
            path,
            self.rows,
            self.out,
            style=style,
            mode=self.mode,
            layer_norm=self.layer_norm,
            overwrite=self.overwrite,
        )
        print(f"{self.out}: y {y.shape[0]} x {y.shape[1]}")
        return {"out": self.out, "rows": y.shape[0]}

    def _reconstruct(self) -> Any:
        """Evaluates the autoencoder of a run of style transfer."""
        from pfnn_jax.transfer.predict import reconstruct_file

        for name in ("style", "mode", "layer_norm"):
            if name in self.given:
                option = f"--{name.replace('_', '-')}"
                raise InputError("command line", option, getattr(self, name), "leave it out for a motion autoencoder")
        found = reconstruct_file(self.run_path, self.rows, self.out, overwrite=self.overwrite)
        sizes = [f"{name} {len(array)} x {array.shape[1]}" for name, array in found._asdict().items()]
        print(f"{self.out}: {', '.join(sizes)}")
        return {"out": self.out, "rows": len(found.y)}
