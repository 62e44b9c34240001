"""Benchmark of crowds: full controller steps of many characters at once, with and without foot IK."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp

from pfnn_jax.benchmarks.timing import Figure, figure, interleave
from pfnn_jax.control.controller import Controller, make_controller, step
from pfnn_jax.control.controller_state import ControllerState
from pfnn_jax.control.loop.step import Command
from pfnn_jax.control.tracking import TrackingConfig
from pfnn_jax.models.config import AdapterConfig, AdapterKind
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.synthetic.walks import synthetic_clips
from pfnn_jax.run import Run
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.workflows.pretrain import pretrain_run

SYSTEMS: dict[str, tuple[str, AdapterKind]] = {
    "PFNN with CP": ("mason2018", "cp"),
    "LPN with FiLM": ("mason2022", "film"),
}
"""Layout and kind of style of the systems of Mason 2018 and 2022."""

STYLES = ("neutral", "proud")

EVERY_FRAME = TrackingConfig(min_time_scale=1.0, max_time_scale=1.0)
"""Fixes the time scale, so that every character evaluates its network once per step. Otherwise the number of
evaluations would depend on the walking speed of a network that is hardly trained."""

AIMS = {("PFNN with CP", 1024): {"with IK": 40_000.0, "without": 50_000.0}}
"""Required characters' frames per second, by system and size of the crowd."""

STRIDE, STEPS = 120, 5
"""Frames until a character walks steadily, and steps per repetition."""


def crowd_figures(hidden: int, num_characters: tuple[int, ...], repetitions: int) -> list[Figure]:
    """Measures the controller steps per second of crowds of several sizes, every character in a mixture of two styles.

    The networks have the papers' sizes and are trained for one step on procedural walkers of 21 joints: how well they
    walk does not affect the time of a step.

    Args:
        hidden: H of the networks.
        num_characters: sizes of the crowds.
        repetitions: number of measurements of every figure.
    """
    figures = []
    for system, (layout, kind) in SYSTEMS.items():
        with tempfile.TemporaryDirectory() as folder:
            run = _run(Path(folder), layout, AdapterConfig(kind), hidden)
            controllers = {
                name: make_controller(run, foot_ik=foot_ik) for name, foot_ik in (("with IK", True), ("without", False))
            }
        for number in num_characters:
            works = {name: partial(*_crowd(controller, number)) for name, controller in controllers.items()}
            seconds = interleave(works, repetitions)
            aims = AIMS.get((system, number), {})
            figures += [
                figure(f"crowd, {system}", f"{number} {name}", STEPS * number / value, "1/s", at_least=aims.get(name))
                for name, value in seconds.items()
            ]
    return figures


def _run(folder: Path, layout: str, adapter: AdapterConfig, hidden: int) -> Run:
    takes = [clip for style in STYLES for clip in synthetic_clips(style, 10.0, clip_seconds=5.0)]
    dataset = prepare(takes, folder / "data", PrepareConfig(layout=layout))
    # The generator only computes the styles' FiLM parameters once, so its size does not matter here.
    config = PretrainConfig(adapter=adapter, steps=1, hidden=hidden, generator_filters=8, generator_hidden=8)
    return pretrain_run(dataset, folder / "run", config)


def _crowd(controller: Controller, number: int) -> tuple:
    """Returns the compiled steps of a walking crowd and their arguments; all characters share the parameters."""
    setup = replace(controller.setup, tracking=EVERY_FRAME)

    def crowd_steps(params, states: ControllerState, commands: Command) -> ControllerState:
        one = jax.vmap(partial(step, setup, params))
        return jax.lax.scan(lambda states, _: (one(states, commands), None), states, length=STEPS)[0]

    ahead, style = jnp.asarray([0.0, 1.0]), controller.style_weights(dict.fromkeys(STYLES, 0.5))
    command = Command(velocity=ahead, direction=ahead, style=jnp.asarray(style))
    alone = controller.start()
    for _ in range(STRIDE):  # from standing to steady walking
        alone = step(setup, controller.params, alone, command)
    states, commands = (
        jax.tree.map(lambda leaf: jnp.tile(leaf[None], (number, *(1,) * leaf.ndim)), one) for one in (alone, command)
    )
    compiled = jax.jit(crowd_steps)
    return compiled, controller.params, states, commands
