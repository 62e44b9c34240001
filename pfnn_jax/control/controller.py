"""A character that a person drives: any style of a run, mixed, from standing to walking to standing.

`step` is a pure function of one character and one frame: use it in a loop, in `lax.scan` (`drive`), and under `vmap`
for crowds. Inside it is the published loop of `frame`; around that stand what an application needs besides: the mixing
of styles, and a body with rigid bones.

    controller = make_controller(run)
    state = controller.start()
    state = controller.step(state, Command(velocity=..., direction=..., style=controller.style_weights("Zombie")))
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.calibration import find_walks, mean_resting_heights, start
from pfnn_jax.control.character import (
    ControllerParams,
    ControllerSetup,
    ControllerState,
    drawn,
    frame_ahead,
    mixed_style,
    own_share,
    own_speed,
    still_frame,
)
from pfnn_jax.control.embodiment import feet_clearance
from pfnn_jax.control.generation import controller_of, default_speed, told_speed
from pfnn_jax.control.ground import mix
from pfnn_jax.control.ik.foot_lock import FootLockConfig
from pfnn_jax.control.ik.pose import make_rig
from pfnn_jax.control.loop.state import ROOT, straight_row, turn_state
from pfnn_jax.control.loop.step import Command
from pfnn_jax.control.tracking import (
    STANDARD,
    ask,
    keep_pace,
    observe,
    turning,
)
from pfnn_jax.errors import InputError
from pfnn_jax.inference.mixture import check_weights, load_bank, need_style
from pfnn_jax.inference.predictor import assemble_predictor
from pfnn_jax.run import Run, list_styles

STYLE_RATE = 0.06
"""Share per frame of the way from a character's style to the commanded one: nine tenths of it in 0.6 s."""

STYLE_SNAP = 1e-3
"""Weights nearer than this to the commanded ones are set to them, so that styles that are left cost nothing."""

AGNOSTIC = "agnostic"
"""What a network without any style is called."""


@dataclass(frozen=True, eq=False)
class Controller:
    """A run made ready to be driven; `make_controller` makes it.

    Attributes:
        params: its arrays.
        setup: what it is compiled for.
        styles: names of the first rows of the bank.
    """

    params: ControllerParams
    setup: ControllerSetup
    styles: tuple[str, ...]

    @property
    def capacity(self) -> int:
        """C, rows of the bank."""
        return len(self.params.speeds)

    def start(self, position: Any = (0.0, 0.0), yaw: Any = 0.0, style: str | int = 0) -> ControllerState:
        """A character that stands at `position` [2] metres and faces `yaw` radians, in a style by name or number.

        Raises:
            InputError: for an unknown style.
        """
        weights = jnp.asarray(self.style_weights(style))
        return start(self.setup, self.params, jnp.asarray(position, jnp.float32), jnp.float32(yaw), weights)

    def step(self, state: ControllerState, command: Command) -> ControllerState:
        """The state one frame later."""
        return step(self.setup, self.params, state, command)

    def style_weights(self, choice: str | int | Mapping[str, float] | Mapping[int, float]) -> np.ndarray:
        """[C] weights of a style by name or number, or of a mixture by names or numbers and weights that sum to one.

        Raises:
            InputError: for an unknown style, or weights that do not sum to one.
        """
        chosen = dict(choice) if isinstance(choice, Mapping) else {choice: 1.0}
        check_weights(tuple(chosen.values()), "controller", "style weights")
        weights = np.zeros(self.capacity, np.float32)
        for name, weight in chosen.items():
            numbered = not isinstance(name, str)
            if name not in (range(len(self.styles)) if numbered else self.styles):
                rule = f"must be one of {', '.join(self.styles)}, or the number of one"
                raise InputError("controller", "style", name, rule)
            weights[name if numbered else self.styles.index(name)] += weight
        return weights


def make_controller(
    run: Run,
    styles: Sequence[str] | None = None,
    capacity: int | None = None,
    *,
    foot_ik: bool = True,
    regulated: bool = True,
) -> Controller:
    """A controller of a run.

    Args:
        run: as `load_run` returns it. Of a run without styles the network moves as it is, as the one style `AGNOSTIC`.
        styles: names; by default all of the run's.
        capacity: C, rows of the bank, at least the number of styles: spare rows take styles that are learned later
            without another compilation.
        foot_ik: hold feet that are in contact on the ground, and lay arms along the predicted positions.
        regulated: keep commands by pace and turning (`regulation`); off for the published loop alone.

    Raises:
        InputError: for an unknown style, styles of different kinds, or a FiLM run without styles.
    """
    names = tuple(list_styles(run.path) if styles is None else styles)
    need_style(run, names)
    spare = max(capacity or 0, len(names)) - len(names) if names else 0
    bank = None
    if names:
        bank = jax.tree.map(
            lambda leaf: jnp.concatenate([jnp.asarray(leaf), jnp.zeros((spare, *leaf.shape[1:]), leaf.dtype)]),
            load_bank(run, names),
        )
    rig = make_rig(run.skeleton, run.path)
    speeds = [told_speed(run, name) or 0.0 for name in names] + [0.0] * spare
    if not names:
        names, speeds = (AGNOSTIC,), [0.0]
    speed, layout, normaliser = default_speed(run, None), run.layout, run.normaliser
    row = jnp.asarray(normaliser.inputs.mean, jnp.float32)
    params = ControllerParams(
        predictor=assemble_predictor(run.shared, None, normaliser),
        bank=bank,
        speeds=jnp.asarray(speeds, jnp.float32),
        speed=jnp.float32(speed),
        shares=jnp.ones(len(speeds), jnp.float32),
        row=straight_row(layout, row, speed),
        phase=jnp.asarray(normaliser.initial_phase()),
        rest=jnp.asarray(mean_resting_heights(layout, normaliser, rig), jnp.float32),
    )
    regulation = STANDARD if regulated else None
    setup = ControllerSetup(layout, controller_of(run), rig, FootLockConfig() if foot_ik else None, regulation)
    return with_walks(Controller(params, setup, names), names)


def with_walks(controller: Controller, styles: Sequence[str]) -> Controller:
    """The controller with the walks of some of its styles found out by trying, from the speeds in its `params`."""
    rows, params = [controller.styles.index(name) for name in styles], controller.params
    speeds, shares = np.array(params.speeds), np.array(params.shares)
    speeds[rows], shares[rows] = find_walks(controller.setup, params, rows)
    params = replace(params, speeds=jnp.asarray(speeds), shares=jnp.asarray(shares))
    return replace(controller, params=params)


@partial(jax.jit, static_argnums=0)
def step(setup: ControllerSetup, params: ControllerParams, state: ControllerState, command: Command) -> ControllerState:
    """One character, one frame later."""
    style = state.style
    if command.style is not None:
        moved = mix(style, command.style, STYLE_RATE)
        style = jnp.where(jnp.abs(moved - command.style) < STYLE_SNAP, command.style, moved)
    predictor = replace(params.predictor, style=mixed_style(params.bank, style))
    own, share = own_speed(params, style), own_share(params, style)
    fps, config = setup.layout.fps, setup.regulation
    regulated = state.regulated
    if config is not None:
        regulated = keep_pace(regulated, command.velocity, config)

    def due(inner: ControllerState) -> jax.Array:
        return inner.clock > 1.0

    def live(inner: ControllerState) -> ControllerState:
        """One frame of the character's own time."""
        before, regulated = inner.motion, inner.regulated
        asked = command
        if config is not None:
            asked = ask(command, own, share, before, regulated, setup.config, config)
        motion, y = frame_ahead(setup, predictor, own, before, asked)
        angle = jnp.zeros((), y.dtype)
        if config is not None:
            clearance = feet_clearance(motion, setup.rig, params.rest)
            regulated = observe(regulated, before, motion, command, clearance, fps, config)
            angle = turning(regulated, command.velocity, fps, config)
            motion = turn_state(motion, angle)
        ahead = still_frame(setup, params, motion, y, before.directions[ROOT], angle)
        return replace(
            inner, motion=motion, regulated=regulated, behind=inner.ahead, ahead=ahead, clock=inner.clock - 1.0
        )

    state = replace(state, style=style, regulated=regulated, clock=state.clock + regulated.pace)
    return drawn(setup, jax.lax.while_loop(due, live, state))


@partial(jax.jit, static_argnums=0)
def drive(
    setup: ControllerSetup, params: ControllerParams, state: ControllerState, commands: Command
) -> tuple[ControllerState, ControllerState]:
    """A character under a command for every frame: the last state, and all of them, leaves [T, ...]."""

    def frame(state: ControllerState, command: Command):
        state = step(setup, params, state, command)
        return state, state

    return jax.lax.scan(frame, state, commands)
