"""The full pipeline on procedural data: pretraining on 8 styles, a ninth style from 3 seconds, its motion, a report."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pfnn_jax.demo.config import DemoConfig
from pfnn_jax.demo.report import write_demo_report
from pfnn_jax.evaluation.style_methods import compare_methods
from pfnn_jax.evaluation.style_test import StyleTest, Takes, join_takes
from pfnn_jax.io.files import refuse_existing
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.datasets.clip_rows import labelled_features
from pfnn_jax.motion.datasets.dataset import Dataset
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.features.encode import clip_features
from pfnn_jax.motion.labels.phase import write_phase
from pfnn_jax.motion.paths import figure_eight
from pfnn_jax.motion.synthetic.walks import PRETRAINING_STYLES, STYLES, UNSEEN_STYLE, synthesise, synthetic_clips
from pfnn_jax.run import Run
from pfnn_jax.training.config import FewShotConfig, PretrainConfig
from pfnn_jax.workflows.generate import generate_walk
from pfnn_jax.workflows.learn import learn_style
from pfnn_jax.workflows.pretrain import pretrain_run

TURNS = (-60.0, -40.0, -20.0, 20.0, 40.0, 60.0)
"""Turn rates of the test takes in degrees per second; the adaptation clip does not turn."""

FIGURE_EIGHT_RADIUS = 1.2
"""Metres; at a walk of 0.8 m/s this is a turn rate of 38 degrees per second, first to one side, then to the other."""


def demo(
    out: str | Path,
    config: DemoConfig,
    *,
    overwrite: bool = False,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> dict[str, Any]:
    """Runs the demo and writes everything into one folder.

    Args:
        out: folder of `dataset/`, `run/`, `clip/`, `motion/`, `report.json`, `report.html`.
        config: sizes.
        overwrite: whether to replace the files of an earlier demo.
        on_stage: called with the name of each stage before it starts.

    Returns:
        The content of `report.json`.

    Raises:
        InputError: if `out` is not empty and `overwrite` is not set.
    """
    out, started = Path(out), time.perf_counter()
    if out.exists() and any(out.iterdir()):
        refuse_existing(out, overwrite)
    seconds: dict[str, float] = {}

    def stage(name: str) -> None:
        seconds[name] = time.perf_counter() - started
        on_stage(name)

    stage("synthesising 8 styles")
    dataset = procedural_dataset(out / "dataset", config, overwrite)
    stage("pretraining")
    losses: list[tuple[int, float]] = []
    settings = PretrainConfig(
        hidden=config.hidden,
        steps=config.steps,
        batch_size=config.batch_size,
        learning_rate=config.learning_rate,
        seed=config.seed,
    )
    run = pretrain_run(
        dataset,
        out / "run",
        settings,
        overwrite=overwrite,
        progress_callback=lambda progress: losses.append((progress.step, progress.loss)),
    )
    stage(f"learning {UNSEEN_STYLE} from {config.clip_seconds:g} s")
    clip_file, labelled = write_clip(out / "clip", config, overwrite)
    learned = learn_style(run, clip_file, FewShotConfig(seed=config.seed), overwrite=True)
    stage("comparing methods of learning it")
    rows = compare_methods(
        run.shared,
        run.normaliser,
        labelled_features(labelled, run.layout, mirror=True),
        style_test(run, labelled, config),
        epochs=config.epochs,
        seed=config.seed,
    )
    stage("walking a figure-eight")
    walks = walk(run, out / "motion", config, overwrite)
    seconds["in all"] = time.perf_counter() - started
    result = {
        "config": asdict(config),
        "seconds": seconds,
        "device": jax.devices()[0].device_kind,
        "pretraining": {"steps": [step for step, _ in losses], "loss": [loss for _, loss in losses]},
        "few_shot": learned,
        "methods": rows,
    }
    write_demo_report(out, result, labelled, walks, overwrite=overwrite)
    return result


def procedural_dataset(out: Path, config: DemoConfig, overwrite: bool = False) -> Dataset:
    """Prepares the dataset of the 8 pretraining styles, with their exact phases."""
    clips = [
        clip for style in PRETRAINING_STYLES for clip in synthetic_clips(style, config.seconds_per_style, config.seed)
    ]
    return prepare(clips, out, PrepareConfig(seed=config.seed), overwrite=overwrite)


def straight_walk(seconds: float, seed: int) -> LabelledClip:
    """Returns a straight walk of the unseen style at its natural speed."""
    frames = round(seconds * 60) + 1
    clip, labels = synthesise(UNSEEN_STYLE, np.zeros(frames), np.full(frames, STYLES[UNSEEN_STYLE].speed), seed=seed)
    return LabelledClip(clip, labels)


def write_clip(folder: Path, config: DemoConfig, overwrite: bool = False) -> tuple[ClipFile, LabelledClip]:
    """Writes the adaptation clip in the form of user data: a BVH file and a `.phase` file with its exact phase."""
    labelled = straight_walk(config.clip_seconds, seed=config.seed + 1000)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{UNSEEN_STYLE}_straight.bvh"
    write_bvh(path, labelled.clip, overwrite=overwrite)
    write_phase(path.with_suffix(".phase"), labelled.labels, overwrite=overwrite)
    return ClipFile(path, UNSEEN_STYLE, "walk"), labelled


def style_test(run: Run, labelled: LabelledClip, config: DemoConfig) -> StyleTest:
    """Returns the test on exact ground truth: unseen turns to both sides at several rates, and straight walks."""
    layout = run.layout
    frames = round(config.test_seconds * layout.fps)
    speed = np.full(frames, STYLES[UNSEEN_STYLE].speed)

    def takes(rates: tuple[float, ...], factors: tuple[float, ...]) -> Takes:
        parts, names = [], []
        for rate in rates:
            for factor in factors:
                turn_rate = np.full(frames, np.deg2rad(rate))
                seed = config.seed + 2000 + len(names)
                clip, labels = synthesise(UNSEEN_STYLE, turn_rate, speed * factor, seed=seed)
                parts.append(clip_features(clip, layout, labels))
                names.append(f"{rate:g} degrees/s at {factor:g} of the natural speed")
        return join_takes(parts, names)

    clip = clip_features(labelled.clip, layout, labelled.labels)
    std = np.asarray(run.normaliser.outputs.std)
    straight, turning = takes((0.0,), (1.0, 0.9, 1.1)), takes(TURNS, (1.0,))
    return StyleTest(layout, run.skeleton, clip, straight, turning, std, circle_seconds=10.0)


def walk(run: Run, folder: Path, config: DemoConfig, overwrite: bool = False) -> dict[str, Any]:
    """Generates walks on a figure-eight in the learned style, without style, and in a pretraining style; writes BVH."""
    folder.mkdir(parents=True, exist_ok=True)
    walks = {}
    for name, style in (("learned", UNSEEN_STYLE), ("agnostic", None), ("neutral", "neutral")):
        walks[name] = generate_walk(run, style, figure_eight(FIGURE_EIGHT_RADIUS), seconds=config.walk_seconds)
        write_bvh(folder / f"{style or 'agnostic'}_figure_eight.bvh", walks[name].clip, overwrite=overwrite)
    return walks
