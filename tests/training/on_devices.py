"""Trains on several host devices; `test_sharding.py` runs it in a process of its own, which fixes their number.

Prints one line of JSON: what each training gave, by name.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from typing import Any
from unittest import mock

import jax
import numpy as np
import optax

from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.training import sharding
from pfnn_jax.training.config import PretrainConfig, TuningConfig
from pfnn_jax.training.data import Batch, Rows
from pfnn_jax.training.hosts import is_first
from pfnn_jax.training.loop import TrainState
from pfnn_jax.training.losses import Objective
from pfnn_jax.training.order import order_of
from pfnn_jax.training.pretraining import init_state, pretrain
from pfnn_jax.training.sharding import data_mesh, replicate, shard_step, split_steps
from pfnn_jax.training.steps import Frozen, equal_dropout, make_pretrain_step
from pfnn_jax.training.tuning import tune_generator
from tests.training.toy import body_rows, on_host, toy_rows

BATCH = 16
SMALL: dict[str, Any] = {
    "hidden": 8,
    "batch_size": BATCH,
    "steps": 4,
    "steps_per_dispatch": 2,
    "learning_rate": 1e-3,
    "generator_filters": 4,
    "generator_width": 5,
    "generator_hidden": 8,
}
CP = PretrainConfig(AdapterConfig(rank=3), **SMALL)
FULL = PretrainConfig(AdapterConfig("full"), **SMALL)
FILM = PretrainConfig(AdapterConfig("film"), clips_per_batch=8, **SMALL)


def main() -> None:
    devices, rows, body = jax.devices(), toy_rows(), body_rows()
    one, all_of_them = devices[:1], devices
    first_half: list[TrainState] = []
    chosen: list[TrainState] = []
    found = {
        "devices": len(devices),
        "one": training(CP, rows, one),
        "all": training(CP, rows, all_of_them, keep=lambda state: first_half.append(on_host(state))),
        "chosen": training(CP, rows, devices[1:2], keep=chosen.append),
        "chosen devices": [device.id for device in jax.tree.leaves(chosen[-1].params)[0].devices()],
        "default": training(CP, rows, None),
        "streamed": training(PretrainConfig(**{**vars(CP), "device_bytes": 0}), rows, all_of_them),
        "resumed": training(CP, rows, devices[:2], state=jax.tree.map(jax.numpy.asarray, first_half[0])),
        "full on one": training(FULL, rows, one),
        "full spread": spread_training(FULL, rows, all_of_them),
        "film on one": training(FILM, body, one),
        "film on all": training(FILM, body, all_of_them),
        "tuned on one": tuning(one),
        "tuned on all": tuning(all_of_them),
        "flops": {str(count): flops(devices[:count]) for count in (1, 2, len(devices))},
    }
    json.dump(found, sys.stdout)


def training(
    config: PretrainConfig,
    rows: Rows,
    devices: Any,
    state: TrainState | None = None,
    keep: Callable[[TrainState], Any] = lambda state: None,
) -> dict[str, Any]:
    """Returns losses of the dispatches and all numbers of the last state."""
    losses = []

    def report(state: TrainState, progress: Any) -> None:
        losses.append(progress.loss)
        keep(state)

    last = sharding.collect(pretrain(rows, config, state=state, devices=devices, state_callback=report))
    return {"losses": losses, "state": numbers((last.params, last.opt_state)) if is_first() else []}


def spread_training(config: PretrainConfig, rows: Rows, devices: Any) -> dict[str, Any]:
    """Trains with the arrays of the bank of full adapters spread, and the smaller ones on every device."""
    abstract = jax.eval_shape(lambda: init_state(config, rows.layout, len(rows.styles)))
    limit = max(4 * leaf.size for leaf in jax.tree.leaves(abstract.params.shared))
    states: list[TrainState] = []
    with mock.patch.object(sharding, "SPREAD_BYTES", limit):
        found = training(config, rows, devices, keep=states.append)
    bank = jax.tree.leaves((states[-1].params.modulation, states[-1].opt_state.modulation))
    large = [leaf for leaf in bank if leaf.nbytes > limit]
    shares = [leaf.addressable_shards[0].data.nbytes / leaf.nbytes for leaf in large]
    return {**found, "large arrays": len(large), "shares": shares}


def tuning(devices: Any) -> dict[str, Any]:
    state = init_state(FILM, body_rows().layout, 3)
    config = TuningConfig(steps=2, batch_size=BATCH, clips_per_batch=2)  # fewer clips than devices
    rows = body_rows(num_frames=(30,))
    tuned = tune_generator(state.params.shared, state.params.modulation, rows, config, devices=devices)
    return {"losses": tuned.losses.tolist(), "state": numbers(tuned.generator)}


def flops(devices: Any) -> float:
    """Returns the floating-point operations of one step on each device, as XLA counts them."""
    rows, mesh = toy_rows(), data_mesh(BATCH, devices)
    step = make_pretrain_step(optax.adam(1e-3), Objective(), equal_dropout(0.3))
    state, frozen = init_state(CP, rows.layout, len(rows.styles)), Frozen(jax.random.key(0))
    draw, data = order_of(rows, BATCH, 0).draw(0, 1), rows.in_memory().parts[0]
    if mesh is not None:
        state, frozen, data = replicate((state, frozen, data), mesh)
        draw, step = split_steps(draw, mesh), shard_step(step, mesh)

    def one(state: TrainState, numbers: Any, data: Batch, frozen: Frozen) -> Any:
        return step(state, jax.tree.map(lambda leaf: leaf[numbers], data), frozen)

    numbers = draw.rows[0]
    return float(jax.jit(one).lower(state, numbers, data, frozen).compile().cost_analysis()["flops"])  # pyright: ignore[reportOptionalSubscript]


def numbers(tree: Any) -> list[float]:
    return np.concatenate([np.asarray(leaf, np.float64).reshape(-1) for leaf in jax.tree.leaves(tree)]).tolist()


if __name__ == "__main__":
    main()
