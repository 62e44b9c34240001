"""Pretraining on disk: from a prepared dataset to a run directory, killed and resumed at any moment."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from pfnn_jax.errors import InputError, TrainingError
from pfnn_jax.models.adapters import init_bank
from pfnn_jax.models.film_generator import film_generator
from pfnn_jax.models.network import init_network
from pfnn_jax.motion.datasets.dataset import Dataset
from pfnn_jax.motion.features.decode import median_speed
from pfnn_jax.motion.features.layout import FrameLayout
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
from pfnn_jax.training.config import PretrainConfig, equal_dropout
from pfnn_jax.training.data import Batch, Rows, StyleData, dataset_rows, make_gather
from pfnn_jax.training.films import mean_films
from pfnn_jax.training.log import append_metrics, rewind_metrics
from pfnn_jax.training.order import StepOrder, order_of, stream_batches
from pfnn_jax.training.steps import (
    PretrainState,
    init_pretrain_state,
    make_pretrain_step,
    make_run_batches,
    make_run_steps,
)


class Progress(NamedTuple):
    """What one dispatch reports."""

    step: int
    steps: int
    loss: float
    frames_per_second: float


def init_state(config: PretrainConfig, layout: FrameLayout, num_styles: int) -> PretrainState:
    """The state at step 0 for S styles of a layout; depends on the arguments alone."""
    shared_key, style_key = jax.random.split(jax.random.key(config.seed))
    sizes, generator = config.network(layout), config.generator(layout)
    shared, optimiser = init_network(sizes, key=shared_key), optax.adam(config.learning_rate)
    if generator is not None:
        return init_pretrain_state(shared, film_generator(generator).init(style_key), optimiser, is_bank=False)
    bank = init_bank(config.adapter, config.hidden, sizes.num_control_points, num_styles, key=style_key)
    return init_pretrain_state(shared, bank, optimiser)


def styles_of(state: PretrainState, data: Rows, config: PretrainConfig) -> Any:
    """What training learned of every style, stacked [S, ...]: the bank, or of a generator the mean Films.

    Args:
        state: of training.
        data: that it was trained on; the generator reads all windows of every style.
        config: of training.
    """
    generator = config.generator(data.layout)
    if generator is None:
        return state.modulation
    return mean_films(film_generator(generator), state.modulation, data)


def total_steps(config: PretrainConfig, order: StepOrder) -> int:
    """Steps of the whole training."""
    return config.epochs * order.steps_per_epoch if config.steps is None else config.steps


def train(
    state: PretrainState,
    data: Rows,
    config: PretrainConfig,
    styles: tuple[str, ...],
    *,
    on_dispatch: Callable[[PretrainState, Progress], Any] = lambda state, progress: None,
) -> PretrainState:
    """Train from a state, new or loaded, to the end of the configured steps.

    A step depends on the state, the data and its own number alone, so that a resumed run repeats itself bit for bit.

    Args:
        state: donated; read the returned one.
        data: rows of S styles. Kept on the device where they fit `config.device_bytes`, else read batch by batch.
        config: the same that made `state`.
        styles: S names, for messages.
        on_dispatch: called after every dispatch with the state and its metrics, e.g. to save.

    Raises:
        TrainingError: when a loss is not finite, before `on_dispatch` sees that state.
        ValueError: if a style has fewer rows than a batch, or windows or bones are needed and absent.
    """
    order = order_of(data, config.batch_size, config.seed, config.num_clips)
    generator = config.generator(data.layout)
    step = make_pretrain_step(
        optax.adam(config.learning_rate),
        config.objective(data),
        equal_dropout(config.dropout),
        None if generator is None else film_generator(generator),
    )
    run_key = jax.random.fold_in(jax.random.key(config.seed), 1)
    begin, steps = int(state.step), total_steps(config, order)
    dispatches = dispatch_sizes(begin, steps, config.steps_per_dispatch)
    run = make_dispatch(step, data, order, dispatches, run_key, config.device_bytes)
    for first, count in dispatches:
        started = time.perf_counter()
        state, losses = run(state, first, count)
        losses = np.asarray(losses)
        check_finite(losses, first, styles)
        rate = losses.size * config.batch_size / (time.perf_counter() - started)
        on_dispatch(state, Progress(first + count, steps, float(losses.mean()), rate))
    return state


def dispatch_sizes(begin: int, steps: int, size: int) -> list[tuple[int, int]]:
    """(first step, number of steps) of every dispatch from step `begin` on; they end at multiples of `size`."""
    edges = [begin, *range((begin // size + 1) * size, steps, size), steps]
    return [(a, b - a) for a, b in zip(edges[:-1], edges[1:], strict=True) if b > a]


def make_dispatch(
    step: Callable, data: Rows, order: StepOrder, dispatches: list[tuple[int, int]], run_key: Any, limit: int
):
    """(state, first step, number of steps) -> (state, losses [n]), with the data on the device where it fits `limit`.

    The function must be called for `dispatches` one after another.
    """
    rolled = not order.num_clips  # clips go through convolutions
    if isinstance(data, StyleData) and data.nbytes <= limit:
        on_device = Batch(*(jnp.asarray(rows) for rows in (data.x, data.y, data.phase)))
        run_steps = make_run_steps(step, make_gather(data.layout), rolled=rolled)
        return lambda state, first, count: run_steps(state, on_device, order.draw(first, count), run_key)
    run_batches, batches = make_run_batches(step, rolled=rolled), stream_batches(data, order, dispatches)
    return lambda state, first, count: run_batches(state, next(batches), run_key)


def check_finite(losses: np.ndarray, first_step: int, styles: tuple[str, ...]) -> None:
    """Refuses losses [n] that are not finite.

    Raises:
        TrainingError: naming the step and its style.
    """
    bad = np.flatnonzero(~np.isfinite(losses))
    if bad.size:
        step = first_step + int(bad[0])
        raise TrainingError(step, styles[step % len(styles)], float(losses[bad[0]]))


def pretrain(
    dataset: Dataset,
    out: str | Path,
    config: PretrainConfig,
    *,
    resume: bool = False,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda progress: None,
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
        on_progress: called after every dispatch.

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

    def on_dispatch(state: PretrainState, progress: Progress) -> None:
        append_metrics(out, progress._asdict())
        if progress.step % config.save_every < config.steps_per_dispatch or progress.step == progress.steps:
            save_train_state(out, state, progress.step)
        on_progress(progress)

    state = train(state, data, config, dataset.styles, on_dispatch=on_dispatch)
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


def _resumed(out: Path, wanted: RunConfig, state: PretrainState) -> PretrainState:
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


def _save_result(out: Path, state: PretrainState, dataset: Dataset, bank: Any) -> None:
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
