"""How many characters can be driven at once: whole steps of the controller, with and without foot IK."""

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
"""The systems of Mason 2018 and 2022: layout and kind of style."""

STYLES = ("neutral", "proud")

EVERY_FRAME = TrackingConfig(min_time_scale=1.0, max_time_scale=1.0)
"""A character at this time scale evaluates its network once in every step. Otherwise it does so more or less often,
by how fast a network walks that was hardly trained."""

STRIDE, STEPS = 120, 5
"""Frames after which a character is in its stride, and steps in one repetition."""


def crowd_figures(hidden: int, num_characters: tuple[int, ...], repetitions: int) -> list[Figure]:
    """Characters per second of controller steps, for crowds of several sizes, each in a mixture of two styles.

    The networks have the papers' sizes and a step of training on procedural walkers of 21 joints: what they are worth
    as walkers makes no difference to their time.

    Args:
        hidden: H of the networks.
        num_characters: sizes of the crowds.
        repetitions: of every figure.
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
            section = f"crowd, {system}"
            figures += [
                figure(section, f"{number} {name}", STEPS * number / value, "1/s") for name, value in seconds.items()
            ]
    return figures


def _run(folder: Path, layout: str, adapter: AdapterConfig, hidden: int) -> Run:
    takes = [clip for style in STYLES for clip in synthetic_clips(style, 10.0, clip_seconds=5.0)]
    dataset = prepare(takes, folder / "data", PrepareConfig(layout=layout))
    # A generator makes Films, once: its size makes no difference here.
    config = PretrainConfig(adapter=adapter, steps=1, hidden=hidden, generator_filters=8, generator_hidden=8)
    return pretrain_run(dataset, folder / "run", config)


def _crowd(controller: Controller, number: int) -> tuple:
    """Some steps of a crowd in the midst of a walk, and their arguments: all parameters are shared, nothing else is."""
    setup = replace(controller.setup, tracking=EVERY_FRAME)

    def crowd_steps(params, states: ControllerState, commands: Command) -> ControllerState:
        one = jax.vmap(partial(step, setup, params))
        return jax.lax.scan(lambda states, _: (one(states, commands), None), states, length=STEPS)[0]

    ahead, style = jnp.asarray([0.0, 1.0]), controller.style_weights(dict.fromkeys(STYLES, 0.5))
    command = Command(velocity=ahead, direction=ahead, style=jnp.asarray(style))
    alone = controller.start()
    for _ in range(STRIDE):  # from standing into the walk
        alone = step(setup, controller.params, alone, command)
    states, commands = (
        jax.tree.map(lambda leaf: jnp.tile(leaf[None], (number, *(1,) * leaf.ndim)), one) for one in (alone, command)
    )
    compiled = jax.jit(crowd_steps)
    return compiled, controller.params, states, commands
