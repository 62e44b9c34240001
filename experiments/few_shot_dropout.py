"""Which dropout generalises to turning, for a style learned from seconds of straight walking? (Mason 2018 §7.2)

Parent    Mason 2018 §7.2: a search over the dropout rate of the adapter, assessed visually; 0.3 everywhere else.
Question  how does the error on unseen turns depend on the drop probability before the adapter, and on the one before
          the shared layers? Does the error on straight walks behave in the same way?
Data      8 procedural styles, and a ninth from 3 seconds of straight walking: exact ground truth on turns and on
          other straight walks. Or --dataset, a prepared one, with --clip, a BVH file of a style that is not in it: then
          the straight error is measured on the held-out end of the clip, and the turning error on --turning files.
Expect    (3 seeds) no adapter 2.00 straight and 2.04 turning. Without main dropout, straight .52 .53 .54 .56 .62 for
          adapter dropout .1 .3 .5 .7 .9, turning .72 .71 .70 .70 .73: the straight error is smallest with the least
          dropout, the turning error in the middle, in every seed, but its means lie within 5 %. Main
          dropout of .3 costs far more: .88 to .93 straight, .99 to 1.02 turning. At the paper's learning rate of 1e-4
          this small network learns little: 1.16 to 1.28 straight, 1.24 to 1.36 turning.
Run       python -m experiments.few_shot_dropout --out runs/few_shot_dropout
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from experiments.common.markdown import markdown_table
from pfnn_jax.control.stability import predictor_of
from pfnn_jax.demo.pipeline import DemoConfig, procedural_dataset, straight_walk
from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.plots import loss_curves
from pfnn_jax.evaluation.style_methods import without_adapter
from pfnn_jax.evaluation.style_test import pose_and_velocity_error
from pfnn_jax.inference.predictor import Predictor
from pfnn_jax.inference.rows import evaluate_rows
from pfnn_jax.io.files import write_whole
from pfnn_jax.models.network import Network
from pfnn_jax.motion.clip import mirror_clip
from pfnn_jax.motion.datasets.dataset import Dataset, load_dataset
from pfnn_jax.motion.datasets.labelled import LabelledClip, load_labelled
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.features.encode import Features, clip_features, join_rows
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.labels.phase import mirror_phase
from pfnn_jax.motion.synthetic.walks import STYLES, UNSEEN_STYLE, synthesise
from pfnn_jax.training.config import FewShotConfig, Method, PretrainConfig
from pfnn_jax.training.data import Rows, hold_out, to_batch
from pfnn_jax.training.few_shot_learning import train_grid
from pfnn_jax.training.pretraining import pretrain
from pfnn_jax.viewer.draw.drawing import save_figure

TURNS = (-60.0, -40.0, -20.0, 20.0, 40.0, 60.0)
"""Turn rates of the test takes in degrees per second; the adaptation clips do not turn."""


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        out: folder of results.
        dataset: prepared dataset to pretrain on; None makes the procedural one.
        clip: BVH file of the new style, needed with `dataset`.
        turning: BVH files of the new style that turn, needed with `dataset`.
        mirror: also learn from the mirror image of the clip.
        method: method of few-shot training.
        learning_rate, epochs: settings of few-shot training; at the paper's rate of 1e-4 an adapter of this small
            network learns little in 100 epochs.
        adapter_dropouts, main_dropouts: the rates to compare.
        seeds: repetitions, each with its own network and few-shot training.
        hidden, steps, batch_size, pretrain_rate: settings of pretraining.
        seconds_per_style: seconds of each procedural style.
        seconds: length of the procedural clip.
        test_seconds: length of each procedural test take.
    """

    out: Path
    dataset: Path | None = None
    clip: Path | None = None
    turning: tuple[Path, ...] = ()
    mirror: bool = True
    method: Method = "cp"
    learning_rate: float = 1e-3
    epochs: int = 100
    adapter_dropouts: tuple[float, ...] = (0.1, 0.3, 0.5, 0.7, 0.9)
    main_dropouts: tuple[float, ...] = (0.0, 0.3)
    seeds: int = 3
    hidden: int = 256
    steps: int = 2500
    batch_size: int = 128
    pretrain_rate: float = 1e-3
    seconds_per_style: float = 60.0
    seconds: float = 3.0
    test_seconds: float = 8.0

    def __post_init__(self):
        if self.seeds < 1:
            raise InputError("few_shot_dropout", "seeds", self.seeds, "must be at least 1")
        if self.dataset is not None and (self.clip is None or not self.turning):
            raise InputError("few_shot_dropout", "dataset", self.dataset, "must come with --clip and --turning")


@dataclass(frozen=True, eq=False)
class Task:
    """Rows of the new style: training rows, held-out rows for ranking, and the two tests."""

    learn: list[Features]
    held_out: list[Features]
    tests: dict[str, Features]  # straight, turning


def procedural_task(config: Config, layout: FrameLayout) -> Task:
    """Returns the task of a ninth style: learned from a straight walk, tested on other straight walks and on turns."""
    clip = straight_walk(config.seconds, seed=1000)
    frames, speed = round(config.test_seconds * layout.fps), STYLES[UNSEEN_STYLE].speed

    def takes(rates: Sequence[float], factors: Sequence[float]) -> Features:
        parts = []
        for number, (rate, factor) in enumerate((r, f) for r in rates for f in factors):
            schedule = np.full(frames, np.deg2rad(rate)), np.full(frames, speed * factor)
            walk, labels = synthesise(UNSEEN_STYLE, *schedule, seed=2000 + number)
            parts.append(clip_features(walk, layout, labels))
        return join_rows(parts)

    learn, held_out = hold_out(_parts(clip, layout, config.mirror), FewShotConfig().held_out)
    return Task(learn, held_out, {"straight": takes((0.0,), (0.9, 1.0, 1.1)), "turning": takes(TURNS, (1.0,))})


def recorded_task(config: Config, layout: FrameLayout) -> Task:
    """Returns the task of a style from a BVH file: tested on the held-out end of the clip and on the turning files."""
    assert config.clip is not None  # the configuration refuses a dataset without a clip
    clip = load_labelled(ClipFile(config.clip, config.clip.stem), layout.fps)
    learn, held_out = hold_out(_parts(clip, layout, config.mirror), FewShotConfig().held_out, str(config.clip))
    turns = [load_labelled(ClipFile(path, config.clip.stem), layout.fps) for path in config.turning]
    turning = join_rows([clip_features(take.clip, layout, take.labels, take.gait) for take in turns])
    return Task(learn, held_out, {"straight": held_out[0], "turning": turning})


def _parts(take: LabelledClip, layout: FrameLayout, mirror: bool) -> list[Features]:
    parts = [clip_features(take.clip, layout, take.labels, take.gait)]
    if mirror:
        parts.append(clip_features(mirror_clip(take.clip), layout, mirror_phase(take.labels), take.gait))
    return parts


def pretrained(dataset: Dataset, config: Config, seed: int) -> Network:
    """Pretrains a shared network on all styles of the dataset."""
    settings = PretrainConfig(
        hidden=config.hidden,
        steps=config.steps,
        batch_size=config.batch_size,
        learning_rate=config.pretrain_rate,
        pose_noise=0.0,
        seed=seed,
    )
    return jax.tree.map(np.asarray, pretrain(Rows.from_dataset(dataset), settings).params.shared)


def errors(shared: Network, dataset: Dataset, task: Task, config: Config, seed: int) -> list[dict[str, float]]:
    """Trains all settings at once; returns the rates and test errors of each."""
    grid = FewShotConfig(
        config.method,
        learning_rates=(config.learning_rate,),
        main_dropouts=config.main_dropouts,
        adapter_dropouts=config.adapter_dropouts,
        eval_epochs=(config.epochs,),
        seed=seed,
    )
    learn, held_out = (to_batch(rows, dataset.normaliser) for rows in (task.learn, task.held_out))
    rows = []
    for choice, trained in train_grid(shared, learn, held_out, grid):
        rates = {"main": choice.main_dropout, "adapter": choice.adapter_dropout, "seed": seed}
        found = test_errors(predictor_of(trained, shared, dataset.normaliser), dataset, task)
        rows.append({**rates, "held_out": choice.held_out_error, **found})
    return rows


def test_errors(predictor: Predictor, dataset: Dataset, task: Task) -> dict[str, float]:
    """Returns the mean squared normalised error of joint positions and velocities on every test."""
    std, found = np.asarray(dataset.normaliser.outputs.std), {}
    for name, test in task.tests.items():
        predicted = evaluate_rows(predictor, test.x, test.phase)
        found[name] = float(pose_and_velocity_error(test.y, predicted, dataset.layout, std).mean())
    return found


def summary(rows: list[dict[str, float]], config: Config) -> list[dict[str, Any]]:
    """Returns mean and standard deviation over seeds for every pair of rates, in the configured order."""
    table = []
    for main in config.main_dropouts:
        for adapter in config.adapter_dropouts:
            found = [row for row in rows if np.isclose((row["main"], row["adapter"]), (main, adapter)).all()]
            line: dict[str, Any] = {"main": main, "adapter": adapter}
            for test in ("straight", "turning"):
                values = np.array([row[test] for row in found])
                line |= {test: float(values.mean()), f"{test}_std": float(values.std(ddof=len(values) > 1))}
            table.append(line)
    return table


def main(config: Config) -> dict[str, Any]:
    """Runs all seeds; writes `few_shot_dropout.json`, `.md` and `.png` into the folder `out`."""
    config.out.mkdir(parents=True, exist_ok=True)
    if config.dataset is None:
        settings = DemoConfig(seconds_per_style=config.seconds_per_style)
        dataset = procedural_dataset(config.out / "dataset", settings, overwrite=True)
        task = procedural_task(config, dataset.layout)
    else:
        dataset = load_dataset(config.dataset)
        task = recorded_task(config, dataset.layout)
    rows, untrained = [], []
    for seed in range(config.seeds):
        shared = pretrained(dataset, config, seed)
        untrained.append(test_errors(without_adapter(shared, dataset.normaliser), dataset, task))
        rows += errors(shared, dataset, task, config, seed)
    table = summary(rows, config)
    plain = {name: str(value) if isinstance(value, Path) else value for name, value in asdict(config).items()}
    plain["turning"] = [str(path) for path in config.turning]
    result = {"config": plain, "rows": rows, "no_adapter": untrained, "summary": table}
    write_whole(config.out / "few_shot_dropout.json", json.dumps(result, indent=1) + "\n")
    head = ("main", "adapter", "straight", "turning", "turning, std over seeds")
    lines = [[row[k] for k in ("main", "adapter", "straight", "turning", "turning_std")] for row in table]
    without = [float(np.mean([row[test] for row in untrained])) for test in ("straight", "turning")]
    lines.insert(0, ["no adapter", None, *without, None])
    write_whole(config.out / "few_shot_dropout.md", markdown_table(head, lines))
    curves = {
        f"{test}, main dropout {rate:g}": (
            config.adapter_dropouts,
            [row[test] for row in table if row["main"] == rate],
        )
        for test in ("straight", "turning")
        for rate in config.main_dropouts
    }
    figure = loss_curves(curves, "Normalised squared error", "drop probability before the adapter", logarithmic=False)
    save_figure(figure, config.out / "few_shot_dropout.png")
    return result


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
