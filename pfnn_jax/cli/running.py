"""Commands that use a run: motion, errors, rows, released weights, times."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import Positional as Argument

from pfnn_jax.benchmarks.suite import print_benchmark, run_benchmark
from pfnn_jax.cli.base import Command, check_file
from pfnn_jax.control.drive_along import drive_along
from pfnn_jax.control.generation import Mode, generate
from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.clips import evaluate_clips
from pfnn_jax.inference.mixture import parse_style
from pfnn_jax.inference.rows import LayerNorm, RowMode, predict_file
from pfnn_jax.interop.released.holden2017 import import_released_pfnn
from pfnn_jax.interop.released.mason2018 import import_released_cp
from pfnn_jax.interop.released.mason2022 import import_released_lpn
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.paths import make_path
from pfnn_jax.run import list_styles, load_run


@dataclass(frozen=True, kw_only=True)
class Generate(Command):
    """Motion in a style along a path, as a BVH file.

    Attributes:
        run_path: a run.
        style: one of its styles, or a mixture `A:0.5+B:0.3+C:0.2` whose weights sum to one. By default style-agnostic
            motion, and on a FiLM run the mean of its styles.
        path: straight, circle, figure-eight, or a CSV file of points x,z in metres.
        size: length of a straight path or radius of the others, metres.
        speed: metres per second.
        seconds: how long; by default as long as the path takes.
        mode: the network as it is, or a table of 50 slices of a global phase.
        foot_ik: hold feet in place while they are in contact.
        regulated: keep to speed and way as a character on the page does, from standing on; by default the published
            loop, which leaves both to the network.
        out: the BVH file, in centimetres.
        overwrite: replace an existing file.
    """

    run_path: Annotated[Argument[Path], tyro.conf.arg(name="run", metavar="RUN")]
    out: Path
    style: str | None = None
    path: str = "figure-eight"
    size: float | None = None
    speed: float | None = None
    seconds: float | None = None
    mode: Mode = "cubic"
    foot_ik: bool = False
    regulated: bool = False
    overwrite: bool = False

    def run(self) -> Any:
        check_file(self.out, ".bvh", self.overwrite)
        if self.regulated and self.mode != "cubic":
            raise InputError("command line", "mode", self.mode, "must be cubic to be regulated")
        path, run = make_path(self.path, self.size), load_run(self.run_path)
        style = None if self.style is None else parse_style(self.style, list_styles(run.path), run.path)
        given: Any = {"speed": self.speed, "seconds": self.seconds, "foot_ik": self.foot_ik}
        if self.regulated:
            clip = drive_along(run, style, path, **given)
        else:
            clip = generate(run, style, path, mode=self.mode, **given).clip
        write_bvh(self.out, clip, overwrite=self.overwrite)
        seconds = clip.num_frames / clip.fps
        print(f"{self.out}: {seconds:.1f} s")
        return {"out": self.out, "seconds": seconds, "frames": clip.num_frames}


@dataclass(frozen=True, kw_only=True)
class Evaluate(Command):
    """One-step errors of a run on clips it has not seen, by style and by group of outputs.

    Attributes:
        run_path: a run.
        source: folder of BVH files, or one file.
        style: style of the run to test; by default each clip's own.
        roles: JSON that names the joints' roles.
    """

    run_path: Annotated[Argument[Path], tyro.conf.arg(name="run", metavar="RUN")]
    source: Annotated[Argument[Path], tyro.conf.arg(metavar="FOLDER")]
    style: str | None = None
    roles: Path | None = None

    def run(self) -> Any:
        result = evaluate_clips(load_run(self.run_path), list_clips(self.source), self.style, self.roles)
        print("mean squared one-step errors over the training data's variance: less is better, 1 is answering its mean")
        for style, errors in result.items():
            groups = "  ".join(f"{name} {value:.3f}" for name, value in errors.items() if isinstance(value, float))
            print(f"{style}: {groups}")
        return result


@dataclass(frozen=True, kw_only=True)
class ImportReleased(Command):
    """Make a run from the authors' released weights, or from files that `export --format bins` has written.

    Attributes:
        kind: pfnn (Holden 2017), cp (the files of Mason 2018's demo, with their description), or lpn (Mason 2022, with
            its 100 styles).
        directory: folder of `.bin` files; of pfnn and cp any four or more of the fifty tables, of lpn all.
        out: the run's folder.
        overwrite: replace an existing run.
    """

    kind: Argument[Literal["pfnn", "cp", "lpn"]]
    directory: Annotated[Argument[Path], tyro.conf.arg(metavar="DIR")]
    out: Path
    overwrite: bool = False

    def run(self) -> Any:
        make = {"pfnn": import_released_pfnn, "cp": import_released_cp, "lpn": import_released_lpn}[self.kind]
        run = make(self.directory, self.out, self.overwrite)
        styles = len(list_styles(run.path))
        print(f"{run.path}: {run.config.layout}" + (f", {styles} styles" if styles else ""))
        return {"run": run.path, "styles": styles, **run.config.pretrain}


@dataclass(frozen=True, kw_only=True)
class Predict(Command):
    """Evaluate a run's network on rows.

    Attributes:
        run_path: a run.
        rows: `.npz` file with `x` in the layout's units and `phase` in radians, or `gating_x` for a gating network.
            `style` [N] or `styles` [N, M] with `weights` [N, M] tell each row's own: indices into the run's styles.
        out: `.npz` file that gets `y` in the layout's units.
        style: one of the run's styles or a mixture, as in `generate`, for all rows.
        mode: the network as it is, or the 50-slice table of a global phase, truncated or nearest.
        layer_norm: of FiLM styles: population statistics, or sample statistics as in the authors' training.
        overwrite: replace an existing file.
    """

    run_path: Annotated[Argument[Path], tyro.conf.arg(name="run", metavar="RUN")]
    rows: Annotated[Argument[Path], tyro.conf.arg(metavar="IN.npz")]
    out: Path
    style: str | None = None
    mode: RowMode = "cubic"
    layer_norm: LayerNorm = "population"
    overwrite: bool = False

    def run(self) -> Any:
        check_file(self.out, ".npz", self.overwrite)
        style = None if self.style is None else parse_style(self.style, list_styles(self.run_path), self.run_path)
        y = predict_file(
            self.run_path,
            self.rows,
            self.out,
            style=style,
            mode=self.mode,
            layer_norm=self.layer_norm,
            overwrite=self.overwrite,
        )
        print(f"{self.out}: y {y.shape[0]} x {y.shape[1]}")
        return {"out": self.out, "rows": y.shape[0]}


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    """Time training, few-shot, one frame, crowds and preparation on this machine, each beside its naive form."""

    def run(self) -> Any:
        result = run_benchmark()
        print_benchmark(result)
        return result
