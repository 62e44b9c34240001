"""What limits data-parallel pretraining on 1, 8, 64 and 512 devices? (docs/scale.md)

Parent    the networks of Mason 2018 (PFNN with CP adapters) and Mason 2022 (LPN with FiLM), at the papers' sizes and
          with ten times the styles and ten times the width.
Question  how much does a step compute, keep, read and send, and what of it does XLA confirm on 1, 2 and 8 host devices?
Expect    XLA's count of operations of a device between its share of the products and that share plus Adam and the
          penalty, which every device computes; and one sum over devices of all gradients of a step. Of a bank of full
          adapters that is spread, a device holds its share, and nothing as large as the bank travels.
Run       python -m experiments.scale --out runs/scale
          Steps are compiled and not run: nothing here is a time. A few minutes on two cores.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
import tyro
from jax.sharding import NamedSharding, PartitionSpec

from experiments.common.markdown import markdown_table
from pfnn_jax.io.files import write_whole
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.film_generator import FiLMGenerator
from pfnn_jax.models.network import num_parameters
from pfnn_jax.motion.datasets.splits import WINDOW_ROWS
from pfnn_jax.motion.features.layout import LAYOUTS, FrameLayout
from pfnn_jax.training.config import PretrainConfig, num_clip_columns
from pfnn_jax.training.data import Batch
from pfnn_jax.training.losses import Objective
from pfnn_jax.training.pretraining import init_state
from pfnn_jax.training.sharding import DATA, data_mesh, shard_step
from pfnn_jax.training.steps import Frozen, PretrainParams, equal_dropout, make_pretrain_step

Model = Literal["pfnn", "lpn"]

BYTES = 4
"""Bytes of a float32 number."""

ADAM = 7
"""Numbers that Adam moves for each parameter in a step: gradient, parameter and two moments in, three out."""

MODELS: dict[Model, tuple[str, int, AdapterConfig]] = {
    "pfnn": ("mason2018", 31, AdapterConfig(rank=30)),
    "lpn": ("mason2022", 25, AdapterConfig("film")),
}
"""Layout, number of joints and form of the styles of each model."""

Placement = Literal["whole", "outputs", "styles"]

PLACEMENTS: tuple[Placement, ...] = ("whole", "outputs", "styles")
"""Of a bank: whole on every device; a share of every style's outputs on each, as training does; some styles on each."""

BANK_STYLES = 16
"""Styles of the bank of full adapters that is counted."""

STYLES: dict[Model, int] = {"pfnn": 8, "lpn": 95}
"""Number of styles in the papers."""


@dataclass(frozen=True)
class Config:
    """The experiment; the defaults are the papers' sizes.

    Attributes:
        out: folder of results.
        hidden: H.
        batch_size: frames of a minibatch.
        factor: by which styles and width grow in the second half of the table.
        devices: numbers of host devices on which XLA compiles a step.
    """

    out: Path
    hidden: int = 512
    batch_size: int = 32
    factor: int = 10
    devices: tuple[int, ...] = (1, 2, 8)


@dataclass(frozen=True)
class Costs:
    """What one training step costs, computed from sizes alone.

    Attributes:
        trained: parameters that a step changes: the shared network, and one style or the generator.
        kept: parameters of the network and all styles, or the generator.
        operations: of the products of one frame, forward and backward, additions and multiplications.
        gradient_bytes: that are summed over devices in a step.
        state_bytes: parameters and moments of Adam, on every device.
        adam_bytes: that Adam moves between processor and memory in a step, on every device.
        frame_bytes: of one frame of data.
    """

    trained: int
    kept: int
    operations: float
    gradient_bytes: int
    state_bytes: int
    adam_bytes: int
    frame_bytes: int


def main(config: Config) -> dict[str, Any]:
    """Writes scale.json and scale.md; returns what the former holds."""
    config.out.mkdir(parents=True, exist_ok=True)
    computed = {}
    for model, styles in STYLES.items():
        for factor in (1, config.factor):
            costs = costs_of(model, styles * factor, config.hidden * factor, config.batch_size)
            computed[f"{model}, {styles * factor} styles, H = {config.hidden * factor}"] = asdict(costs)
    bank = {placement: count_bank_on(config, placement) for placement in PLACEMENTS}
    counted = {model: {count: count_on(config, model, count) for count in config.devices} for model in STYLES}
    result = {"batch_size": config.batch_size, "computed": computed, "counted by XLA": counted, "bank": bank}
    write_whole(config.out / "scale.json", json.dumps(result, indent=1))
    names = [field for field in Costs.__dataclass_fields__]
    rows = [[name, *(f"{costs[field]:.3g}" for field in names)] for name, costs in computed.items()]
    write_whole(config.out / "scale.md", markdown_table(["network", *names], rows))
    return result


def pretraining(model: Model, hidden: int, batch_size: int) -> tuple[FrameLayout, PretrainConfig]:
    """Returns the layout of a model and the settings of its training."""
    name, joints, form = MODELS[model]
    return LAYOUTS[name](joints), PretrainConfig(form, hidden=hidden, batch_size=batch_size)


def costs_of(model: Model, num_styles: int, hidden: int, batch_size: int) -> Costs:
    """Returns the costs of a step of a model; only shapes are made."""
    layout, config = pretraining(model, hidden, batch_size)
    state = jax.eval_shape(lambda: init_state(config, layout, num_styles))
    shared, modulation = num_parameters(state.params.shared), num_parameters(state.params.modulation)
    is_generator = isinstance(state.params.modulation, FiLMGenerator)
    trained = shared + (modulation if is_generator else modulation // num_styles)
    return Costs(
        trained=trained,
        kept=shared + modulation,
        operations=frame_operations(state.params, config),
        gradient_bytes=BYTES * trained,
        state_bytes=3 * BYTES * (shared + modulation),
        adam_bytes=ADAM * BYTES * trained,
        frame_bytes=BYTES * (layout.input_size + layout.output_size + max(layout.phase_size, 1)),
    )


def frame_operations(params: PretrainParams, config: PretrainConfig) -> float:
    """Returns the operations of the products of a frame, forward and backward, its share of the clips included.

    Every weight costs a multiplication and an addition forward and twice as many backward. The first layer, whose
    input needs no gradient, and biases are counted like the rest.
    """
    dense = 6.0 * num_parameters(params.shared)
    if not isinstance(params.modulation, FiLMGenerator):
        num_styles = jax.tree.leaves(params.modulation)[0].shape[0]
        return dense + 6.0 * num_parameters(params.modulation) / num_styles
    generator = params.modulation
    weights = [num_parameters(kernel) for kernel in (generator.conv1, generator.conv2)]
    matrices = num_parameters(generator.dense1) + num_parameters(generator.dense2)
    clip = weights[0] * WINDOW_ROWS + weights[1] * WINDOW_ROWS / 2 + matrices  # the second sees pooled pairs
    return dense + 6.0 * clip * config.num_clips / config.batch_size


def count_on(config: Config, model: Model, count: int) -> dict[str, float]:
    """Returns what XLA counts in a step on a number of host devices."""
    return on_devices(count, "--count", model, config.hidden, config.batch_size)


def count_bank_on(config: Config, placement: Placement) -> dict[str, float]:
    """Returns what XLA counts in a step with a bank of full adapters, on the largest number of host devices."""
    return on_devices(max(config.devices), "--count-bank", placement, config.hidden, config.batch_size)


def on_devices(count: int, *arguments: object) -> dict[str, float]:
    """Returns what this program counts on a number of host devices, which are made in a process of their own."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={count}"
    environment = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    program = [sys.executable, "-m", "experiments.scale", *map(str, arguments)]
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def count(model: Model, hidden: int, batch_size: int) -> dict[str, float]:
    """Returns the operations of one device in a step, and the bytes that are summed over devices."""
    layout, config = pretraining(model, hidden, batch_size)
    step: Any = make_pretrain_step(optax.adam(1e-4), Objective(l1=0.01), equal_dropout(0.3))
    mesh = data_mesh(batch_size)
    whole = split = None
    if mesh is not None:
        step = shard_step(step, mesh)
        whole, split = (NamedSharding(mesh, PartitionSpec(*axes)) for axes in ((), (DATA,)))

    state, frozen, frames = jax.eval_shape(
        lambda: (init_state(config, layout, 4), Frozen(jax.random.key(0)), empty_batch(layout, config))
    )
    split = jax.tree.map(lambda leaf: split if leaf.shape[0] % jax.device_count() == 0 else whole, frames)
    shardings = None if mesh is None else (whole, split, whole)
    compiled = jax.jit(step, in_shardings=shardings).lower(state, frames, frozen).compile()
    costs: Any = compiled.cost_analysis()
    return {"operations": float(costs["flops"]), "summed bytes": summed_bytes(compiled.as_text() or "")}


def empty_batch(layout: FrameLayout, config: PretrainConfig) -> Batch:
    """Returns a minibatch of zeros."""
    size = config.batch_size
    x, y = (jnp.zeros((size, columns)) for columns in (layout.input_size, layout.output_size))
    phase = jnp.zeros((size, layout.phase_size) if layout.phase_size else size)
    clips = jnp.zeros((config.num_clips, WINDOW_ROWS, num_clip_columns(layout))) if config.num_clips else None
    return Batch(x, y, phase, clips)


def count_bank(placement: Placement, hidden: int, batch_size: int) -> dict[str, float]:
    """Returns bytes and operations of one device in a step of a PFNN with full adapters, placed in one of three ways.

    `held` are network, bank and moments; `temporary` is what the step needs besides; `travelling` are the results of
    all exchanges between devices.
    """
    layout, config = (
        LAYOUTS["mason2018"](31),
        PretrainConfig(AdapterConfig("full"), hidden=hidden, batch_size=batch_size),
    )
    mesh = data_mesh(batch_size)
    assert mesh is not None
    step: Any = make_pretrain_step(optax.adam(1e-4), Objective(l1=0.01), equal_dropout(0.3))
    state, frozen, frames = jax.eval_shape(
        lambda: (init_state(config, layout, BANK_STYLES), Frozen(jax.random.key(0)), empty_batch(layout, config))
    )

    def placed(path: Any, leaf: Any) -> NamedSharding:
        large = "modulation" in jax.tree_util.keystr(path) and leaf.ndim > 2
        axes = {"whole": (), "outputs": (*[None] * (leaf.ndim - 1), DATA), "styles": (DATA,)}[placement]
        return NamedSharding(mesh, PartitionSpec(*axes if large else ()))

    places = jax.tree_util.tree_map_with_path(placed, state)
    whole, split = (NamedSharding(mesh, PartitionSpec(*axes)) for axes in ((), (DATA,)))
    shardings: Any = {"in_shardings": (places, split, whole), "out_shardings": (places, whole)}
    compiled = jax.jit(step, **shardings, donate_argnums=0).lower(state, frames, frozen).compile()
    memory: Any = compiled.memory_analysis()
    costs: Any = compiled.cost_analysis()
    return {
        "held": memory.argument_size_in_bytes,
        "temporary": memory.temp_size_in_bytes,
        "travelling": summed_bytes(compiled.as_text() or "", "all-reduce|all-gather|all-to-all|reduce-scatter"),
        "operations": float(costs["flops"]),
    }


def summed_bytes(program: str, kinds: str = "all-reduce") -> int:
    """Returns the bytes of all results of sums over devices, or of other exchanges, in a compiled program."""
    results = re.findall(rf"= (.*?) (?:{kinds})(?:-start)?\(", program)
    shapes = [shape for result in results for shape in re.findall(r"[fu]32\[([\d,]*)\]", result)]
    return sum(BYTES * int(np.prod([int(size) for size in shape.split(",") if size])) for shape in shapes)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--count"]:
        model, hidden, batch_size = sys.argv[2:]
        json.dump(count(cast(Model, model), int(hidden), int(batch_size)), sys.stdout)
    elif sys.argv[1:2] == ["--count-bank"]:
        placement, hidden, batch_size = sys.argv[2:]
        json.dump(count_bank(cast(Placement, placement), int(hidden), int(batch_size)), sys.stdout)
    else:
        main(tyro.cli(Config))
