"""Pretraining on disk: from a prepared dataset to a run directory, killed and resumed at any moment."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.datasets.dataset import Dataset
from pfnn_jax.motion.features.decode import median_speed
from pfnn_jax.motion.skeleton import skeleton_to_json
from pfnn_jax.run import (
    Run,
    RunConfig,
    create_run,
    load_config,
    load_run,
    load_train_state,
    save_generator,
    save_shared,
    save_style,
    save_train_state,
)
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.data import dataset_rows
from pfnn_jax.training.log import append_metrics, rewind_metrics
from pfnn_jax.training.pretraining import Progress, init_state, styles_of, train
from pfnn_jax.training.steps import TrainState


def pretrain_run(
    dataset: Dataset,
    out: str | Path,
    config: PretrainConfig,
    *,
    resume: bool = False,
    overwrite: bool = False,
    progress_callback: Callable[[Progress], None] = lambda progress: None,
) -> Run:
    """Trains a shared network and a style for each name, and writes them as a run.

    With FiLM the generator is written too, and the styles are the mean Films over all windows of each.

    The training state is saved every `config.save_every` steps; the shared parameters and the styles are written
    once, at the end. A run killed before resumes from its last complete state and repeats the rest bit for bit.

    Args:
        dataset: prepared motion of all styles.
        out: the run directory.
        config: how to train.
        resume: go on with the run in `out`, which must have been started with the same settings.
        overwrite: replace an existing run.
        progress_callback: called after every dispatch.

    Raises:
        InputError: if `out` exists (without `resume` or `overwrite`), or holds other settings than asked; for
            sizes that the dataset's layout cannot have.
        TrainingError: when a loss is not finite; the last good state stays.
    """
    out = Path(out)
    run_config = run_config_of(dataset, config)
    data = dataset_rows(dataset, limit=config.device_bytes)
    state = init_state(config, dataset.layout, len(dataset.styles))
    if resume:
        state = _resumed(out, run_config, state)
    else:
        create_run(out, run_config, dataset.normaliser, overwrite)

    def save(state: TrainState, progress: Progress) -> None:
        append_metrics(out, progress._asdict())
        if progress.step % config.save_every < config.steps_per_dispatch or progress.step == progress.steps:
            save_train_state(out, state, progress.step)
        progress_callback(progress)

    state = train(state, data, config, dataset.styles, progress_callback=save)
    _save_result(out, state, dataset, styles_of(state, data, config))
    return load_run(out)


def run_config_of(dataset: Dataset, config: PretrainConfig) -> RunConfig:
    """The configuration that a run of this dataset carries.

    Raises:
        InputError: for sizes that its layout cannot have.
    """
    layout = dataset.layout
    try:
        network = config.network(layout)
    except ValueError as error:
        raise InputError(dataset.path, f"layout {layout.name}", str(error).removesuffix("."), "see --help") from error
    return RunConfig(
        network=network,
        adapter=config.adapter,
        layout=layout.name,
        num_joints=layout.num_joints,
        styles=tuple(dataset.styles),
        skeleton=skeleton_to_json(dataset.skeleton),
        pretrain={**asdict(config), "dataset": str(dataset.path), "frames": dict(dataset.frames)},
        generator=config.generator(layout),
    )


def _resumed(out: Path, wanted: RunConfig, state: TrainState) -> TrainState:
    """The last saved state of the run in `out`, or the fresh one if it was killed before its first save."""
    found, asked = _plain(load_config(out)), _plain(wanted)
    for name in sorted(asked.keys() - {"versions"}):
        if found[name] != asked[name]:
            value = f"{_differing(found[name], asked[name])} differs from what was asked"
            raise InputError(out, name, value, "a run is resumed with the settings it began with")
    loaded = load_train_state(out, jax.eval_shape(lambda: state))
    rewind_metrics(out, 0 if loaded is None else int(loaded.step))
    return state if loaded is None else loaded


def _plain(config: RunConfig) -> dict[str, Any]:
    return json.loads(json.dumps(asdict(config)))


def _differing(old: Any, new: Any) -> str:
    """The entries in which two values differ, with the old ones."""
    if isinstance(old, dict) and isinstance(new, dict):
        return ", ".join(f"{key} {old.get(key)}" for key in sorted(old | new) if old.get(key) != new.get(key))
    return str(old)


def _save_result(out: Path, state: TrainState, dataset: Dataset, bank: Any) -> None:
    save_shared(out, state.shared)
    if load_config(out).generator is not None:
        save_generator(out, state.modulation)
    for index, style in enumerate(dataset.styles):
        adapter = jax.tree.map(lambda leaf, i=index: np.asarray(leaf[i]), bank)
        y = dataset.arrays(style)[1]
        info = {
            "source": str(dataset.path),
            "frames": dataset.frames[style],
            "speed": median_speed(dataset.layout, y[::10]),
            "steps": int(state.step),
        }
        save_style(out, style, adapter, info, overwrite=True)
