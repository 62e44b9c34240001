"""Commands that learn: the demo, pretraining, a new style."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import Positional as Argument

from pfnn_jax.cli.base import FLAT, Command
from pfnn_jax.cli.progress import stage_progress, training_progress
from pfnn_jax.demo.pipeline import DemoConfig, demo
from pfnn_jax.motion.datasets.dataset import load_dataset
from pfnn_jax.motion.datasets.sources import ClipFile, is_symmetric
from pfnn_jax.run import Run, load_run
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.few_shot_learning import FILM_FEW_SHOT, MASON2018_FEW_SHOT, FewShotConfig
from pfnn_jax.training.tuning import TuningConfig
from pfnn_jax.workflows.learn import learn_style, tune_style
from pfnn_jax.workflows.pretrain import pretrain_run


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
        with training_progress() as progress_callback:
            run = pretrain_run(
                load_dataset(self.dataset),
                self.out,
                self.config,
                resume=self.resume,
                overwrite=self.overwrite,
                progress_callback=progress_callback,
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
        recipe: the best of our measurements, which is a Film where the run's styles are Films; the paper's of 2018
            (CP, 100 epochs at 1e-4); or tuning of the run's FiLM generator (2022).
        overwrite: replace a style of this name.
        config: the grid of settings; ignored, but for the seed, with the other recipes.
        tuning: settings of `--recipe generator`.
    """

    run_path: Annotated[Argument[Path], tyro.conf.arg(name="run", metavar="RUN")]
    clip: Annotated[Argument[Path], tyro.conf.arg(metavar="CLIP.bvh")]
    name: str
    start: int = 0
    stop: int | None = None
    mirror: bool | None = None
    roles: Path | None = None
    recipe: Literal["default", "paper", "generator"] = "default"
    overwrite: bool = False
    config: Annotated[FewShotConfig, FLAT] = field(default_factory=FewShotConfig)
    tuning: TuningConfig = field(default_factory=TuningConfig)

    def run(self) -> Any:
        clip = ClipFile(self.clip, self.name, start=self.start, stop=self.stop)
        mirror = is_symmetric(self.name) if self.mirror is None else self.mirror
        run, options = load_run(self.run_path), {"roles_file": self.roles, "overwrite": self.overwrite}
        if self.recipe == "generator":
            info = tune_style(run, clip, replace(self.tuning, seed=self.config.seed), mirror=mirror, **options)
            print(f"{self.name}: {info['frames']} frames, {info['seconds']:.1f} s; loss {info['loss']:.4g}")
            return info
        info = learn_style(run, clip, self._grid(run), mirror=mirror, **options)
        choice = ", ".join(f"{name.replace('_', ' ')} {value:g}" for name, value in info["choice"].items())
        print(f"{self.name}: {info['frames']} frames, {info['seconds']:.1f} s; chosen: {choice}")
        return info

    def _grid(self, run: Run) -> FewShotConfig:
        """The settings asked for; where none were, those for the run's kind of styles."""
        seed = self.config.seed
        if self.recipe == "paper":
            return replace(MASON2018_FEW_SHOT, seed=seed)
        if run.config.adapter.kind == "film" and self.config == FewShotConfig(seed=seed):
            return replace(FILM_FEW_SHOT, seed=seed)
        return self.config
