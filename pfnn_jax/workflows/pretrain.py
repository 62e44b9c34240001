"""Pretraining on disk: from a prepared dataset to a run directory, which can be killed and resumed at any moment."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.io.locks import writing
from pfnn_jax.models.network import Network
from pfnn_jax.models.style import Style
from pfnn_jax.motion.datasets.dataset import Dataset, load_dataset
from pfnn_jax.motion.features.decode import median_speed
from pfnn_jax.motion.features.encode import Features
from pfnn_jax.motion.skeleton import skeleton_to_json
from pfnn_jax.run import (
    Run,
    create_run,
    load_run,
    load_train_state,
    save_generator,
    save_shared,
    save_style,
    save_train_state,
)
from pfnn_jax.run_config import RunConfig, load_config, save_config, train_progress
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.data import Rows, evenly_spaced
from pfnn_jax.training.few_shot_learning import row_errors
from pfnn_jax.training.hosts import wait_for_all
from pfnn_jax.training.log import append_metrics, rewind_metrics
from pfnn_jax.training.loop import Progress, TrainState, no_progress
from pfnn_jax.training.pretraining import init_state, pretrain, styles_of
from pfnn_jax.training.restyling import StyleDifferences, find_differences, save_differences
from pfnn_jax.training.sharding import collect, data_mesh, in_host_memory, is_spread

LENGTHS = ("epochs", "steps")
"""Settings that may change when a run is resumed: it can be trained longer."""

ERROR_ROWS = 1024
"""Rows on which the error of each style is measured at the end, evenly spaced."""

SPEED_ROWS = 8000
"""Rows of each style, evenly spaced, whose median speed is that of the style."""

DIFFERENCE_ROWS, ALL_DIFFERENCE_ROWS = 8000, 160_000
"""Rows of each style, evenly spaced, among which differences are sought; rows of all styles at most, for memory."""


def pretrain_run(
    dataset: Dataset | str | Path,
    out: str | Path,
    config: PretrainConfig | None = None,
    *,
    resume: bool = False,
    overwrite: bool = False,
    progress_callback: Callable[[Progress], Any] = no_progress,
) -> Run:
    """Trains a shared network and a style for each name in a dataset, and writes them as a run.

    With FiLM the generator is written too, and the styles are its mean FiLM styles over windows of each
    (`mean_styles`). Each style's `error` is kept with it (`style_error`), so that styles learned later can be compared.

    The training state is saved every `config.save_every` steps; the shared parameters and the styles are written
    once, at the end. A run killed before resumes from its last complete state and repeats the rest bit for bit. A
    finished run is trained longer by resuming it with more steps or epochs; styles that were learned few-shot for its
    earlier network do not fit the new one and are refused by name. Where the layout has a global phase and styles do
    more than walk straight, the run also keeps their differences, from which later styles learn to turn.

    Args:
        dataset: prepared motion of all styles, or its folder.
        out: the run directory.
        config: how to train; `PretrainConfig()` by default.
        resume: continue the run in `out`, which must have been started with the same settings; only `epochs` and
            `steps` may be larger.
        overwrite: replace an existing run.
        progress_callback: called after every `config.steps_per_dispatch` steps.

    Raises:
        InputError: if `out` exists (without `resume` or `overwrite`), or holds a run with other settings; for sizes
            that the dataset's layout cannot have, and for a style with fewer rows than a minibatch; if another process
            is writing the run.
        TrainingError: when a loss is not finite; the last good state stays.
        LostProcessError: if another process that trains along (`join_pretraining`) has ended; likewise.
    """
    dataset = dataset if isinstance(dataset, Dataset) else load_dataset(Path(dataset))
    config, out = PretrainConfig() if config is None else config, Path(out)
    run_config = run_config_of(dataset, config)
    _check_rows(dataset, config)
    with writing(out):
        _train(dataset, out, config, run_config, resume, overwrite, progress_callback)
    if jax.process_count() > 1:
        wait_for_all("written")
    return load_run(out)


def join_pretraining(dataset: Dataset | str | Path, config: PretrainConfig | None = None) -> None:
    """Takes part in the training of another process, until the run is written.

    Of the processes that `jax.distributed` has connected, the first calls `pretrain_run`, and all others this. They
    need the dataset, with the same content, and not the run: where the first process resumes, it sends them the state.

    Args:
        dataset: prepared motion of all styles, or its folder.
        config: as given to `pretrain_run`.

    Raises:
        InputError: if the dataset or the config is not that of the first process.
        LostProcessError: if another process has ended.
        TrainingError: when a loss is not finite.
    """
    dataset = dataset if isinstance(dataset, Dataset) else load_dataset(Path(dataset))
    config = PretrainConfig() if config is None else config
    _check_rows(dataset, config)

    def send(state: TrainState, progress: Progress) -> None:
        if _is_save_due(config, progress):
            collect(state)

    rows = Rows.from_dataset(dataset, max_bytes=config.device_bytes)
    collect(pretrain(rows, config, state_callback=send))
    wait_for_all("written")


def _is_save_due(config: PretrainConfig, progress: Progress) -> bool:
    """Returns whether the state is saved after a chunk of steps."""
    return progress.step % config.save_every < config.steps_per_dispatch or progress.step == progress.steps


def _train(
    dataset: Dataset,
    out: Path,
    config: PretrainConfig,
    run_config: RunConfig,
    resume: bool,
    overwrite: bool,
    progress_callback: Callable[[Progress], Any],
) -> None:
    """Trains from the first step or from the last save, and writes the run."""
    if resume:
        _check_resumable(out, run_config)
    else:
        create_run(out, run_config, dataset.normaliser, overwrite)
    rows = Rows.from_dataset(dataset, max_bytes=config.device_bytes)
    state = _resume(out, run_config, config, dataset) if resume else None

    def save(state: TrainState, progress: Progress) -> None:
        append_metrics(out, progress._asdict())
        if _is_save_due(config, progress):
            save_train_state(out, collect(state), progress.step, progress.steps)

    state = collect(pretrain(rows, config, state=state, progress_callback=progress_callback, state_callback=save))
    differences = dataset_differences(dataset, config.seed)
    if differences is not None:
        save_differences(out, differences)
    _save_result(out, state, dataset, styles_of(state, rows))


def dataset_differences(dataset: Dataset, seed: int, styles: Sequence[str] | None = None) -> StyleDifferences | None:
    """Returns what styles of a dataset do but walk straight, from evenly spaced rows; see `find_differences`.

    Args:
        dataset: prepared motion.
        seed: of the choice of rows.
        styles: names; by default all of the dataset.
    """
    if dataset.layout.phase_size:
        return None
    names, rows = dataset.styles if styles is None else styles, {}
    most = min(DIFFERENCE_ROWS, ALL_DIFFERENCE_ROWS // len(names))
    for name in names:
        x, y, phase = dataset.stored_arrays(name)
        chosen = evenly_spaced(len(x), most)
        rows[name] = Features(x[chosen], y[chosen], phase[chosen], chosen)
    return find_differences(rows, dataset.layout, dataset.normaliser, seed=seed)


def style_error(shared: Network, style: Style, dataset: Dataset, name: str) -> tuple[float, str]:
    """Returns the one-step error of a style on rows of its own, and the split that they are from.

    The measure is that of few-shot learning's held-out error: squared, normalised, mean over outputs and rows, without
    dropout. Rows of the validation split were never trained on. A dataset without one leaves the training rows, whose
    error is a lower bound.

    Args:
        shared: pretrained network.
        style: parameters of the style.
        dataset: that the network was trained on.
        name: of the style.
    """
    split = "validation" if dataset.rows.get("validation", {}).get(name) else "train"
    rows = Rows.from_dataset(dataset, [name], split=split, max_bytes=0)
    count = dataset.rows[split][name]
    trained = jax.tree.map(lambda leaf: np.asarray(leaf)[None], style)
    return float(row_errors(trained, shared, rows.take(evenly_spaced(count, ERROR_ROWS))).mean()), split


def run_config_of(dataset: Dataset, config: PretrainConfig) -> RunConfig:
    """Returns the configuration of a run of this dataset.

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


def _check_rows(dataset: Dataset, config: PretrainConfig) -> None:
    style, rows = min(dataset.frames.items(), key=lambda item: item[1])
    if rows < config.batch_size:
        raise InputError(
            dataset.path, f"rows of style {style}", rows, f"must be at least batch_size {config.batch_size}"
        )


def _check_resumable(out: Path, wanted: RunConfig) -> None:
    """Refuses to resume a run that was started with other settings, or to train it for fewer steps than it has."""
    found, wanted_entries = _plain(load_config(out)), _plain(wanted)
    found["pretrain"].setdefault("precision", PretrainConfig().precision)  # runs of earlier versions have none
    for entries in (found["pretrain"], wanted_entries["pretrain"]):
        for name in LENGTHS:
            entries.pop(name, None)
    for name in sorted(wanted_entries.keys() - {"versions"}):
        if found[name] != wanted_entries[name]:
            value = f"{_differing(found[name], wanted_entries[name])} differs from the settings given now"
            raise InputError(out, name, value, "must be the settings that the run was started with")
    progress, steps = train_progress(out), wanted.pretrain["steps"]
    if progress is not None and steps is not None and steps < progress[0]:
        raise InputError(out, "steps", steps, f"must be at least {progress[0]}, the steps already taken")


def _resume(out: Path, wanted: RunConfig, config: PretrainConfig, dataset: Dataset) -> TrainState | None:
    """Returns the last saved state of the run, or None if it was killed before its first save."""
    abstract = jax.eval_shape(lambda: init_state(config, dataset.layout, len(dataset.styles)))
    with in_host_memory(is_spread(abstract, data_mesh(config.batch_size))):
        loaded = load_train_state(out, abstract)
    rewind_metrics(out, 0 if loaded is None else int(loaded.step))
    save_config(out, wanted)
    return loaded


def _plain(config: RunConfig) -> dict[str, Any]:
    return json.loads(json.dumps(asdict(config)))


def _differing(old: Any, new: Any) -> str:
    """Returns the entries in which two values differ, with the old ones."""
    if isinstance(old, dict) and isinstance(new, dict):
        return ", ".join(f"{key} {old.get(key)}" for key in sorted(old | new) if old.get(key) != new.get(key))
    return str(old)


def _save_result(out: Path, state: TrainState, dataset: Dataset, bank: Any) -> None:
    save_shared(out, state.params.shared)
    if load_config(out).generator is not None:
        save_generator(out, state.params.modulation)
    for index, name in enumerate(dataset.styles):
        style = jax.tree.map(lambda leaf, i=index: np.asarray(leaf[i]), bank)
        y = dataset.stored_arrays(name)[1]
        error, split = style_error(state.params.shared, style, dataset, name)
        info = {
            "source": dataset.path.resolve().name,
            "frames": dataset.frames[name],
            "speed": median_speed(dataset.layout, y[evenly_spaced(len(y), SPEED_ROWS)]),
            "steps": int(state.step),
            "error": error,
            "error_split": split,
        }
        save_style(out, name, style, info, overwrite=True)
