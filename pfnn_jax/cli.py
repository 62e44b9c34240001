"""The command `pfnn-jax`: parsing, and one function call for each sub-command."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from pfnn_jax.errors import InputError, TrainingError
from pfnn_jax.evaluation.benchmark import print_benchmark, run_benchmark
from pfnn_jax.evaluation.clips import evaluate_clips
from pfnn_jax.evaluation.demo import DemoConfig, demo
from pfnn_jax.evaluation.report import to_plain
from pfnn_jax.motion.bvh import read_bvh, write_bvh, write_whole
from pfnn_jax.motion.dataset import load_dataset, prepare
from pfnn_jax.motion.phase import label_phase, write_phase
from pfnn_jax.motion.preparation import PrepareConfig
from pfnn_jax.motion.sources import ClipFile, is_symmetric, list_clips
from pfnn_jax.progress import clip_progress, stage_progress, training_progress
from pfnn_jax.runtime.generate import Mode, generate
from pfnn_jax.runtime.learn import learn_style
from pfnn_jax.runtime.paths import make_path
from pfnn_jax.runtime.released import import_released_pfnn
from pfnn_jax.runtime.rows import RowMode, predict_file
from pfnn_jax.training.few_shot import PAPER, FewShotConfig
from pfnn_jax.training.loop import pretrain
from pfnn_jax.training.pretraining import PretrainConfig
from pfnn_jax.training.run import load_run

FLAT = tyro.conf.arg(name="")  # --hidden, not --config.hidden
Argument = tyro.conf.Positional


@dataclass(frozen=True, kw_only=True)
class Command:
    """What every command takes.

    Attributes:
        json: write the result to this file, for scripts.
    """

    json: Path | None = None


@dataclass(frozen=True, kw_only=True)
class Demo(Command):
    """The whole way on procedural motion: pretraining, a new style from 3 seconds, its motion, a report.

    Attributes:
        out: folder for everything.
        overwrite: replace what is there.
        config: sizes.
    """

    out: Path = Path("demo")
    overwrite: bool = False
    config: Annotated[DemoConfig, FLAT] = field(default_factory=DemoConfig)

    def run(self) -> Any:
        with stage_progress() as on_stage:
            result = demo(self.out, self.config, overwrite=self.overwrite, on_stage=on_stage)
        print(f"Open {self.out / 'report.html'} in a browser.")
        return result


@dataclass(frozen=True, kw_only=True)
class Prepare(Command):
    """From folders of BVH files to a dataset that training reads.

    Attributes:
        source: folder of BVH files: one folder per style, or a known data set.
        out: the dataset's folder.
        kind: convention of the file names; auto finds it.
        styles: styles to keep; all by default.
        roles: JSON that names the joints' roles where they are not found by themselves.
        overwrite: replace an existing dataset.
        config: how clips become rows.
    """

    source: Annotated[Argument[Path], tyro.conf.arg(metavar="FOLDER")]
    out: Path
    kind: Literal["auto", "bandai", "100style", "xia", "pfnn", "folders"] = "auto"
    styles: tuple[str, ...] = ()
    roles: Path | None = None
    overwrite: bool = False
    config: Annotated[PrepareConfig, FLAT] = field(default_factory=PrepareConfig)

    def run(self) -> Any:
        clips = [clip for clip in list_clips(self.source, self.kind) if not self.styles or clip.style in self.styles]
        with clip_progress() as progress:
            dataset = prepare(
                clips, self.out, self.config, roles_file=self.roles, overwrite=self.overwrite, progress=progress
            )
        for skipped in dataset.skipped:
            print(f"left out: {skipped['file']}: {skipped['reason']}")
        print(f"{self.out}: {len(dataset.styles)} styles of {dataset.frames_per_style} frames each")
        return {"styles": dataset.styles, "frames_per_style": dataset.frames_per_style, "skipped": dataset.skipped}


@dataclass(frozen=True, kw_only=True)
class Pretrain(Command):
    """From a dataset to a run: a network shared by all styles, and an adapter for each.

    Attributes:
        dataset: folder that `prepare` has written.
        out: the run's folder.
        resume: go on with a run that was stopped, with the same settings.
        overwrite: replace an existing run.
        config: how to train.
    """

    dataset: Annotated[Argument[Path], tyro.conf.arg(metavar="DATASET")]
    out: Path
    resume: bool = False
    overwrite: bool = False
    config: Annotated[PretrainConfig, FLAT] = field(default_factory=PretrainConfig)

    def run(self) -> Any:
        with training_progress() as on_progress:
            run = pretrain(
                load_dataset(self.dataset),
                self.out,
                self.config,
                resume=self.resume,
                overwrite=self.overwrite,
                on_progress=on_progress,
            )
        print(f"{run.path}: styles {', '.join(run.config.styles)}")
        return {"run": run.path, "styles": run.config.styles}


@dataclass(frozen=True, kw_only=True)
class FewShot(Command):
    """Learn a new style from one clip, the shared network frozen.

    Attributes:
        run_path: a pretrained run.
        clip: BVH file; a `.phase` file beside it is used, else phases are found.
        name: name of the new style.
        start: first frame of the file to use, at its own rate.
        stop: the frame before which to end; by default the file's end.
        mirror: also learn from the mirrored clip; by default unless the name is a style known to be asymmetric.
        roles: JSON that names the joints' roles.
        recipe: the best of our measurements, or the paper's (CP, 100 epochs at 1e-4).
        overwrite: replace a style of this name.
        config: the grid of settings; ignored, but for the seed, with `--recipe paper`.
    """

    run_path: Annotated[Argument[Path], tyro.conf.arg(name="run", metavar="RUN")]
    clip: Annotated[Argument[Path], tyro.conf.arg(metavar="CLIP.bvh")]
    name: str
    start: int = 0
    stop: int | None = None
    mirror: bool | None = None
    roles: Path | None = None
    recipe: Literal["default", "paper"] = "default"
    overwrite: bool = False
    config: Annotated[FewShotConfig, FLAT] = field(default_factory=FewShotConfig)

    def run(self) -> Any:
        config = self.config if self.recipe == "default" else replace(PAPER, seed=self.config.seed)
        clip = ClipFile(self.clip, self.name, start=self.start, stop=self.stop)
        mirror = is_symmetric(self.name) if self.mirror is None else self.mirror
        info = learn_style(
            load_run(self.run_path), clip, config, mirror=mirror, roles_file=self.roles, overwrite=self.overwrite
        )
        choice = ", ".join(f"{name.replace('_', ' ')} {value:g}" for name, value in info["choice"].items())
        print(f"{self.name}: {info['frames']} frames, {info['seconds']:.1f} s; chosen: {choice}")
        return info


@dataclass(frozen=True, kw_only=True)
class Generate(Command):
    """Motion in a style along a path, as a BVH file.

    Attributes:
        run_path: a run.
        style: one of its styles; style-agnostic motion by default.
        path: straight, circle, figure-eight, or a CSV file of points x,z in metres.
        size: length of a straight path or radius of the others, metres.
        speed: metres per second.
        seconds: how long; by default as long as the path takes.
        mode: the exact spline, or a table of 50 slices.
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
    overwrite: bool = False

    def run(self) -> Any:
        _refuse_existing(self.out, self.overwrite)
        path = make_path(self.path, self.size)
        made = generate(
            load_run(self.run_path), self.style, path, speed=self.speed, seconds=self.seconds, mode=self.mode
        )
        write_bvh(self.out, made.clip, overwrite=self.overwrite)
        seconds = made.clip.num_frames / made.clip.fps
        print(f"{self.out}: {seconds:.1f} s")
        return {"out": self.out, "seconds": seconds, "frames": made.clip.num_frames}


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
        for style, errors in result.items():
            groups = "  ".join(f"{name} {value:.3f}" for name, value in errors.items() if isinstance(value, float))
            print(f"{style}: {groups}")
        return result


@dataclass(frozen=True, kw_only=True)
class LabelPhase(Command):
    """Find the phase of a clip and write it as a `.phase` file, which a person can correct.

    Attributes:
        clip: BVH file.
        out: the `.phase` file: one value in cycles for each frame of the BVH file; 0 = right foot contact.
        roles: JSON that names the joints' roles.
        overwrite: replace an existing file.
    """

    clip: Annotated[Argument[Path], tyro.conf.arg(metavar="CLIP.bvh")]
    out: Path
    roles: Path | None = None
    overwrite: bool = False

    def run(self) -> Any:
        _refuse_existing(self.out, self.overwrite)
        labels = label_phase(read_bvh(self.clip, roles_file=self.roles))
        write_phase(self.out, labels, overwrite=self.overwrite)
        steps = len(labels.contacts_right) + len(labels.contacts_left)
        print(f"{self.out}: {steps} steps, {int(labels.labelled.sum())} of {labels.num_frames} frames labelled")
        return {"steps": steps, "labelled": int(labels.labelled.sum()), "frames": labels.num_frames}


@dataclass(frozen=True, kw_only=True)
class ImportReleased(Command):
    """Make a run from the authors' released weights.

    Attributes:
        kind: pfnn (Holden 2017).
        directory: folder of `.bin` tables, any four or more of the fifty.
        out: the run's folder.
        overwrite: replace an existing run.
    """

    kind: Argument[Literal["pfnn"]]
    directory: Annotated[Argument[Path], tyro.conf.arg(metavar="DIR")]
    out: Path
    overwrite: bool = False

    def run(self) -> Any:
        run = import_released_pfnn(self.directory, self.out, self.overwrite)
        print(f"{run.path}: {run.config.layout}, recovered from tables {run.config.pretrain.get('indices', '')}")
        return {"run": run.path, **run.config.pretrain}


@dataclass(frozen=True, kw_only=True)
class Predict(Command):
    """Evaluate a run's network on rows.

    Attributes:
        run_path: a run.
        rows: `.npz` file with `x` in the layout's units and `phase` in radians.
        out: `.npz` file that gets `y` in the layout's units.
        style: one of the run's styles; style-agnostic by default.
        mode: the exact spline, or the 50-slice table, truncated or nearest.
        overwrite: replace an existing file.
    """

    run_path: Annotated[Argument[Path], tyro.conf.arg(name="run", metavar="RUN")]
    rows: Annotated[Argument[Path], tyro.conf.arg(metavar="IN.npz")]
    out: Path
    style: str | None = None
    mode: RowMode = "cubic"
    overwrite: bool = False

    def run(self) -> Any:
        y = predict_file(self.run_path, self.rows, self.out, style=self.style, mode=self.mode, overwrite=self.overwrite)
        print(f"{self.out}: y {y.shape[0]} x {y.shape[1]}")
        return {"out": self.out, "rows": y.shape[0]}


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    """Time training, few-shot, one frame, crowds and preparation on this machine, each beside its naive form."""

    def run(self) -> Any:
        result = run_benchmark()
        print_benchmark(result)
        return result


def _refuse_existing(path: Path, overwrite: bool) -> None:
    """Before long work, so that it is not done in vain."""
    if path.exists() and not overwrite:
        raise InputError(path, "output", "exists", "existing output is replaced only with --overwrite")


def _write_json(path: Path, result: Any) -> None:
    write_whole(path, json.dumps(to_plain(result), indent=2, allow_nan=False) + "\n")


COMMANDS = {
    "demo": Demo,
    "prepare": Prepare,
    "pretrain": Pretrain,
    "few-shot": FewShot,
    "generate": Generate,
    "evaluate": Evaluate,
    "label-phase": LabelPhase,
    "import-released": ImportReleased,
    "predict": Predict,
    "benchmark": Benchmark,
}


def parse(args: Sequence[str] | None) -> Any:
    """The command that a command line names, its settings checked.

    Raises:
        InputError: if a setting breaks a rule of its configuration.
    """
    try:
        return tyro.extras.subcommand_cli_from_dict(
            COMMANDS, args=args, prog="pfnn-jax", description="Stylised character locomotion from short clips."
        )
    except InputError:
        raise
    except ValueError as error:  # from the configurations' own checks
        raise InputError("command line", "settings", str(error).removesuffix("."), "see --help") from error


def main(args: Sequence[str] | None = None) -> None:
    """Runs a command line; bad input ends with one line on standard error and exit code 2."""
    try:
        command = parse(args)
        result = command.run()
        if command.json is not None:
            _write_json(command.json, result)
    except (InputError, TrainingError) as error:
        print(f"pfnn-jax: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
