"""Which method of learning a style from one straight walk generalises to real turns?

Parent    Mason 2018 §7-8, which had no ground truth for turns and assessed results visually.
Question  which method of adding a style generalises from a few seconds of straight walking to turning?
Data      Bandai-Namco-2: 7 styles, each with straight walks and 90° turns. For each style: pretrain on the other six,
          adapt on at most 5 seconds of one straight walk (another one for each seed), test on all its turning takes
          and on its other straight walks. Settings and numbers of epochs are chosen on the last fifth of the adaptation
          clip and by rollouts on circles; nothing is chosen on the turning takes.
Expect    (3 seeds, errors on turns) no adapter .196, the paper's recipe .101, CP at 1e-4 without dropout .098, CP as
          `few-shot` chooses it .097, bias and diagonal .101, full .147, fine-tuning 5 / 25 / 100 epochs .103 / .149 /
          .282, from scratch 1.36, CP chosen by held-out frames alone .120, CP on the style's own turns .043. All
          measures: docs/results_appendix.md. About 2.7 minutes per fold on 2 cores.
Run       python -m experiments.leave_one_style_out --data FOLDER --out runs/leave_one_style_out
          Each fold is written when it is finished; run again with the same --out to resume.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from experiments.common.leave_one_style_out_table import write_summary
from experiments.common.style_takes import Take, TrainedNetwork, adaptation_clip, balanced, load_takes, pretrain_on
from pfnn_jax.control.stability import predictor_of
from pfnn_jax.evaluation.style_methods import GRIDS, compare_methods
from pfnn_jax.evaluation.style_test import StyleTest, join_takes
from pfnn_jax.io.files import write_whole
from pfnn_jax.motion.features.encode import Features
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.training.config import FewShotConfig, PretrainConfig
from pfnn_jax.training.data import to_batch
from pfnn_jax.training.few_shot_learning import train_grid


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        data: folder of Bandai-Namco-2 BVH files.
        out: folder of results.
        styles: held-out styles; all of the folder's by default.
        seeds: number of repetitions; each has its own networks, shuffling and adaptation clip.
        steps, batch_size: settings of pretraining.
        learning_rate: learning rate of pretraining; 10 times the paper's, because batches are 8 times larger and steps
            fewer.
        hidden: H.
        epochs: longest few-shot training; later `eval_epochs` are dropped.
        seconds: length of the adaptation clip.
        neutral: the style on which the one-style network is pretrained.
        circle_seconds: length of the walks on circles.
        takes: largest number of takes of each style and content, 0 for all.
    """

    data: Path
    out: Path
    styles: tuple[str, ...] = ()
    seeds: int = 3
    steps: int = 2000
    batch_size: int = 256
    learning_rate: float = 1e-3
    hidden: int = 512
    epochs: int = 100
    seconds: float = 5.0
    neutral: str = "normal"
    circle_seconds: float = 20.0
    takes: int = 0


@dataclass(frozen=True, eq=False)
class Fold:
    """The data that all methods share for one held-out style and seed."""

    clip: tuple[Features, Features]  # the adaptation clip and its mirror image
    test: StyleTest
    turns: tuple[Take, ...]


def pretrained(parts: dict[str, Features], layout: FrameLayout, config: Config, seed: int) -> TrainedNetwork:
    """Pretrains a network on the rows of some styles."""
    settings = PretrainConfig(
        hidden=config.hidden,
        steps=config.steps,
        batch_size=config.batch_size,
        learning_rate=config.learning_rate,
        pose_noise=0.0,
        seed=seed,
    )
    return pretrain_on(parts, layout, settings)


def make_fold(takes: Sequence[Take], style: str, seed: int, layout, skeleton, std, config: Config) -> Fold:
    """Returns the adaptation clip of this seed and the test takes."""
    own = [take for take in takes if take.style == style]
    walks = [take for take in own if take.content == "walk"]
    turns = [take for take in own if "turn" in take.content]
    walk = walks[seed % len(walks)]
    others = [take for take in walks if take is not walk]
    clip = adaptation_clip(walk, round(config.seconds * layout.fps))
    straight = join_takes([take.rows for take in others], [take.name for take in others])
    turning = join_takes([take.rows for take in turns], [take.name for take in turns])
    test = StyleTest(layout, skeleton, clip[0], straight, turning, std, config.circle_seconds)
    return Fold(clip=clip, test=test, turns=tuple(turns))


def bound(shared, normaliser: Normaliser, fold: Fold, config: Config, seed: int) -> dict[str, Any]:
    """Measures CP trained on half of the style's own turns and tested on the other half, in both directions.

    The result is a bound for methods that do not see turns.
    """
    epochs = min(10, config.epochs)
    grid = FewShotConfig("cp", 30, (1e-3,), (0.0,), (0.3,), eval_epochs=(epochs,), seed=seed)
    results = []
    for half in (0, 1):
        learn = [part for take in fold.turns[half::2] for part in (take.rows, take.mirrored)]
        adapter = train_grid(shared, to_batch(learn, normaliser), to_batch(fold.clip, normaliser), grid)[0].trained
        others = fold.turns[1 - half :: 2]
        test = replace(fold.test, turning=join_takes([take.rows for take in others], [take.name for take in others]))
        results.append(test.measure(predictor_of(adapter, shared, normaliser)))
    return _mean(results)


def _mean(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Averages numbers and merges tables per take."""
    merged = {}
    for key in results[0]:
        values = [result[key] for result in results]
        if isinstance(values[0], dict):
            joined = {k: v for value in values for k, v in value.items()}
            merged[key] = joined if key == "per_take" else _mean(values)
        else:
            merged[key] = None if None in values else float(np.mean(values))
    return merged


def run_fold(takes, style: str, seed: int, layout, skeleton, neutral, config: Config) -> dict[str, Any]:
    """Returns all rows of one held-out style and seed."""
    started = time.perf_counter()
    styles = sorted({take.style for take in takes} - {style})
    network = pretrained(balanced(takes, styles, seed), layout, config, seed)
    shared, normaliser = network.shared, network.normaliser
    pretrain_seconds = time.perf_counter() - started
    fold = make_fold(takes, style, seed, layout, skeleton, normaliser.outputs.std, config)
    rows = compare_methods(shared, normaliser, fold.clip, fold.test, epochs=config.epochs, seed=seed)
    if neutral is not None and style != config.neutral:
        grids = {"CP": GRIDS["CP"]}
        options = {"grids": grids, "epochs": config.epochs, "seed": seed}
        one_style = compare_methods(neutral.shared, neutral.normaliser, fold.clip, fold.test, **options)
        rows["CP, pretrained on one style"] = one_style["CP"]
    rows["CP on its own turns (bound)"] = {"measures": bound(shared, normaliser, fold, config, seed)}
    seconds = time.perf_counter() - started
    return {
        "style": style,
        "seed": seed,
        "frames": len(fold.test.clip.x),
        "pretrain_loss": network.loss,
        "pretrain_seconds": pretrain_seconds,
        "seconds": seconds,
        "rows": rows,
    }


def main(config: Config) -> None:
    """Runs the missing folds, and writes the tables and plots of all folds."""
    config.out.mkdir(parents=True, exist_ok=True)
    takes, layout, skeleton = load_takes(config.data, config.takes)
    styles = config.styles or tuple(sorted({take.style for take in takes}))
    for seed in range(config.seeds):
        neutral = None
        for style in styles:
            file = config.out / f"fold_{style}_{seed}.json"
            if file.exists():
                continue
            if neutral is None:
                neutral = pretrained(balanced(takes, [config.neutral], seed), layout, config, seed)
            fold = run_fold(takes, style, seed, layout, skeleton, neutral, config)
            write_whole(file, json.dumps(fold, indent=1))
            error = fold["rows"]["CP"]["measures"]["turning"]["pose_velocity"]
            print(f"{style} seed {seed}: CP {error:.3f} on turns, {fold['seconds']:.0f} s", flush=True)
    folds = [json.loads(file.read_text()) for file in sorted(config.out.glob("fold_*.json"))]
    write_summary(config.out, folds, {k: str(v) for k, v in asdict(config).items()})


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
