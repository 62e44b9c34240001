"""Can the network's own walks replace the rows of the known styles?

Question  the rows of known styles have to be kept with a network. The network can walk in these styles, straight and
          on circles: are the rows of such rollouts as good?
Method    rollouts of 5 seconds in every known style at its walking speed and turn rates of 0, ±30, ±60 and ±90 degrees
          per second, the first 1.5 seconds left out; their turns are restyled, and learned with the clip, with the
          default's dropout, and with noise of .2 on the normalised pose inputs and dropout of .1.
Verdict   (elderly, on networks without noise in pretraining) with noise of .2 while learning 2.68 / 2.84: in the
          controller like the known styles' rows (2.76 / 2.59), in the loop .25 worse; with noise of .3 instead of
          dropout the walk diverges. A network without its styles' rows could be given them in this way, at some cost.
Run       python -m experiments.few_shot.own_rollouts --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from experiments.common.few_shot_recipes import Learning, clip_rows, learn_rows
from experiments.common.turning_folds import Fold, FoldConfig, Method, NetworkKind, run_methods
from experiments.common.turning_table import PAPER
from experiments.common.varied_restyling import BASE, draw_rows, restyle_turns, straight_and_turning
from pfnn_jax.control.generation import starting_row
from pfnn_jax.control.loop.state import initial_state
from pfnn_jax.control.loop.step import LOOP_CONFIGS, Command, advance, network_input, steer
from pfnn_jax.inference.predictor import Predictor, assemble_predictor, evaluate
from pfnn_jax.models.style import Style
from pfnn_jax.motion.features.decode import median_speed
from pfnn_jax.motion.features.encode import Features, join_rows
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.training.data import join_batches
from pfnn_jax.training.restyling import COUNT

TURN_RATES = (0, 30, -30, 60, -60, 90, -90)
"""Degrees per second; the first is the straight walk."""

SECONDS, WARM_UP_SECONDS, STRAIGHT_SECONDS = 5.0, 1.5, 1.0
"""Length of a rollout, of its beginning that is left out, and of its beginning that is straight."""


@partial(jax.jit, static_argnames=("layout",))
def walk(predictor: Predictor, layout: FrameLayout, begin: Any, speed: jax.Array, turn_rates: jax.Array) -> Any:
    """Returns x [R, T, Dx], y [R, T, Dy] and phase [R, T] of the published loop at a speed and R turn rates."""
    config, (x, phase) = LOOP_CONFIGS[layout.name], begin
    frames = round(SECONDS * layout.fps)

    def at_rate(turn_rate: jax.Array) -> Any:
        def frame(carry: Any, number: jax.Array):
            state, yaw = carry
            turning = number >= STRAIGHT_SECONDS * layout.fps
            yaw = yaw + jnp.where(turning, turn_rate, 0.0) / layout.fps
            direction = jnp.stack([jnp.sin(yaw), jnp.cos(yaw)])
            state = steer(layout, state, Command(velocity=speed * direction, direction=direction), config)
            x = network_input(layout, state)
            y = evaluate(predictor, x, state.phase)
            return (advance(layout, state, y, config), yaw), (x, y, state.phase)

        state = initial_state(layout, x, phase, jnp.zeros(2), jnp.zeros(()))
        return jax.lax.scan(frame, (state, jnp.zeros(())), jnp.arange(frames))[1]

    return jax.vmap(at_rate)(turn_rates)


def rollout_rows(fold: Fold, kind: NetworkKind) -> dict[str, tuple[Features, Features]]:
    """Returns the rows of straight and of turning rollouts in every known style."""
    layout, first = fold.layout, round(WARM_UP_SECONDS * fold.layout.fps)
    network = fold.network(kind)
    begin = starting_row(layout, network.normaliser, 1.0)
    rates = jnp.deg2rad(jnp.asarray(TURN_RATES, jnp.float32))
    found = {}
    for number, (style, (straight, _)) in enumerate(straight_and_turning(fold.known_takes(kind)).items()):
        own = jax.tree.map(lambda leaf, number=number: leaf[number], network.bank)
        predictor = assemble_predictor(network.shared, own, network.normaliser)
        speed = jnp.float32(median_speed(layout, straight.y))
        leaves = [np.asarray(leaf)[:, first:] for leaf in walk(predictor, layout, begin, speed, rates)]
        walks = [Features(x, y, phase, np.arange(len(x))) for x, y, phase in zip(*leaves, strict=True)]
        found[style] = walks[0], join_rows(walks[1:])
    return found


def learn_from_rollouts(fold: Fold, kind: NetworkKind, learning: Learning) -> Style:
    """Returns the style that is learned from the clip and restyled rows of rollouts."""
    network, parts = fold.network(kind), rollout_rows(fold, kind)
    restyled = restyle_turns(fold, network, parts, draw_rows(parts, COUNT, fold.seed))
    return learn_rows(fold, network, join_batches([clip_rows(fold, network), restyled]), learning)


METHODS = {
    "turns of own rollouts": Method(partial(learn_from_rollouts, learning=Learning())),
    "turns of own rollouts, noise .2": Method(
        partial(learn_from_rollouts, learning=Learning(main_dropout=0.1, noise=0.2))
    ),
}


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "own_rollouts", METHODS, (PAPER, BASE))
