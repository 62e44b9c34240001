"""The full pipeline on procedural data: pretraining on 8 styles, a ninth style from 3 seconds, its motion, a report."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.controller import Controller, assemble_controller
from pfnn_jax.control.generation import GeneratedWalk, track_walks
from pfnn_jax.demo.config import DemoConfig
from pfnn_jax.demo.judging import KNOWN, LEARNED, NO_ADAPTER, PAPER, judge_characters, turning_takes
from pfnn_jax.demo.report import write_demo_report
from pfnn_jax.evaluation.driven_takes import ROUND_UP_TAKES
from pfnn_jax.io.files import refuse_existing
from pfnn_jax.models.style import Style
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.datasets.clip_rows import labelled_features
from pfnn_jax.motion.datasets.dataset import Dataset
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.labels.phase import write_phase
from pfnn_jax.motion.paths import figure_eight
from pfnn_jax.motion.synthetic.walks import PRETRAINING_STYLES, STYLES, UNSEEN_STYLE, synthesise, synthetic_clips
from pfnn_jax.run import Run, load_style
from pfnn_jax.training.config import MASON2018_FEW_SHOT, PretrainConfig
from pfnn_jax.training.data import Rows
from pfnn_jax.training.few_shot_learning import few_shot
from pfnn_jax.workflows.learn import default_config, learn_style
from pfnn_jax.workflows.pretrain import pretrain_run

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
    run = pretrain_run(
        dataset,
        out / "run",
        pretraining(config),
        overwrite=overwrite,
        progress_callback=lambda progress: losses.append((progress.step, progress.loss)),
    )
    stage(f"learning {UNSEEN_STYLE} from {config.clip_seconds:g} s")
    clip_file, labelled = write_clip(out / "clip", config, overwrite)
    learned = learn_style(run, clip_file, replace(default_config(run), seed=config.seed), overwrite=True)
    stage("learning it by the paper's recipe")
    controller = make_characters(run, learn_as_paper(run, labelled, config))
    stage("walking turns that it has not seen")
    seed = config.seed + 2000
    takes = dict.fromkeys((NO_ADAPTER, PAPER, LEARNED), turning_takes(UNSEEN_STYLE, run, seed))
    judged = judge_characters(controller, run, takes | {KNOWN: turning_takes(KNOWN, run, seed)})
    stage("walking a figure-eight")
    walks = walk(controller, run, out / "motion", config, overwrite)
    seconds["in all"] = time.perf_counter() - started
    result = {
        "config": asdict(config),
        "seconds": seconds,
        "device": jax.devices()[0].device_kind,
        "pretraining": {"steps": [step for step, _ in losses], "loss": [loss for _, loss in losses]},
        "few_shot": learned,
        "judged": judged,
    }
    write_demo_report(out, result, labelled, walks, overwrite=overwrite)
    return result


def pretraining(config: DemoConfig) -> PretrainConfig:
    """Returns how the demo's network is trained."""
    names = ("hidden", "steps", "batch_size", "learning_rate", "seed")
    return PretrainConfig(**{name: getattr(config, name) for name in names})


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


def learn_as_paper(run: Run, labelled: LabelledClip, config: DemoConfig) -> Style:
    """Returns the ninth style as Mason 2018 learns it: from the clip alone."""
    parts = labelled_features(labelled, run.layout, mirror=True)
    rows = Rows.from_features({UNSEEN_STYLE: parts}, run.layout, run.normaliser, run.skeleton.parents)
    recipe = replace(MASON2018_FEW_SHOT, rank=run.config.adapter.rank, seed=config.seed)
    return few_shot(run.shared, rows, recipe)


def make_characters(run: Run, paper: Style) -> Controller:
    """Returns a controller with a style for each row of the judged table."""
    learned = load_style(run, UNSEEN_STYLE)
    styles = {NO_ADAPTER: jax.tree.map(jnp.zeros_like, learned), PAPER: paper, LEARNED: learned}
    speeds = dict.fromkeys(styles, STYLES[UNSEEN_STYLE].speed) | {KNOWN: STYLES[KNOWN].speed}
    return assemble_controller(run.shared, styles | {KNOWN: load_style(run, KNOWN)}, run, speeds=speeds)


def walk(
    controller: Controller, run: Run, folder: Path, config: DemoConfig, overwrite: bool = False
) -> Mapping[str, GeneratedWalk]:
    """Generates walks on a figure-eight in the learned style, without style, and in a pretraining style; writes BVH."""
    folder.mkdir(parents=True, exist_ok=True)
    shown = {"learned": LEARNED, "agnostic": NO_ADAPTER, "neutral": KNOWN}
    labels = {"learned": UNSEEN_STYLE, "agnostic": "agnostic", "neutral": KNOWN}
    weights = [controller.style_weights(style) for style in shown.values()]
    options = {"seconds": config.walk_seconds, "lanes": ROUND_UP_TAKES}  # as many as walk turns: nothing is compiled
    made = track_walks(controller, weights, figure_eight(FIGURE_EIGHT_RADIUS), run, **options)
    walks = {}
    for name, made_walk in zip(shown, made, strict=True):
        walks[name] = replace(made_walk, clip=replace(made_walk.clip, style=labels[name]))
        write_bvh(folder / f"{labels[name]}_figure_eight.bvh", walks[name].clip, overwrite=overwrite)
    return walks
