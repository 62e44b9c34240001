"""A character driven by commands: any mixture of a run's styles, standing, walking and turning.

`step` is a pure function of one character and one frame: use it in a loop, in `lax.scan` (`rollout_commands`), and
under `vmap` for crowds. It wraps the published loop (`loop.step`) in command tracking (`tracking`), the mixing of
styles, and a body with rigid bones.

    controller = make_controller(run)
    state = controller.start()
    state = controller.step(state, Command(velocity=..., direction=..., style=controller.style_weights("Zombie")))
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.calibration import foot_heights, start_standing
from pfnn_jax.control.compiling import jit_quickly
from pfnn_jax.control.controller_state import (
    ControllerParams,
    ControllerSetup,
    ControllerState,
    draw_body,
    feet_distance,
    follow_body,
    network_step,
    predicted_frame,
    standing_point,
    style_speed,
)
from pfnn_jax.control.forms import zeros_of
from pfnn_jax.control.ik.foot_lock import FootLockConfig
from pfnn_jax.control.ik.pose import make_rig
from pfnn_jax.control.kept_calibration import kept_calibration
from pfnn_jax.control.loop.state import ROOT, straight_row, turn_state
from pfnn_jax.control.loop.step import LOOP_CONFIGS, Command, LoopConfig, held_command
from pfnn_jax.control.run_settings import default_speed, loop_config, mean_speed, recorded_speed
from pfnn_jax.control.standing import StandingConfig
from pfnn_jax.control.tracking import (
    StyleSpeed,
    TrackingConfig,
    heading_correction,
    is_moving,
    network_command,
    update_time_scale,
    update_tracking,
)
from pfnn_jax.control.vectors import lerp
from pfnn_jax.errors import InputError
from pfnn_jax.inference.mixture import need_style, stack_styles
from pfnn_jax.inference.predictor import Predictor, assemble_predictor
from pfnn_jax.inference.style_choice import check_weights
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.network import Network, config_of
from pfnn_jax.models.placement import commit
from pfnn_jax.models.style import Style, init_style
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.run import Run, load_style
from pfnn_jax.run_config import list_styles

STYLE_RATE = 0.06
"""Share per frame by which a character's style moves towards the commanded one: 90 % of the way in 0.6 s."""

STYLE_SNAP = 1e-3
"""Weights nearer than this to the commanded ones are set to them, so that no trace of an old style stays."""

AGNOSTIC = "agnostic"
"""Name of the only style of a network without styles."""


class Embodiment(Protocol):
    """The layout, skeleton and normaliser of a network: a `Run` and a `Dataset` are one."""

    @property
    def layout(self) -> FrameLayout: ...

    @property
    def skeleton(self) -> Skeleton: ...

    @property
    def normaliser(self) -> Normaliser: ...


@dataclass(frozen=True, eq=False)
class Controller:
    """A run that is ready to be driven, as `make_controller` returns it.

    Attributes:
        params: its arrays.
        setup: its static part, for which its functions are compiled.
        styles: names of the first rows of the bank.
    """

    params: ControllerParams
    setup: ControllerSetup
    styles: tuple[str, ...]

    @property
    def capacity(self) -> int:
        """Returns C, the number of rows of the bank."""
        return len(self.params.speeds)

    def start(
        self,
        position: Any = (0.0, 0.0),
        yaw: Any = 0.0,
        style: str | int | Mapping[str, float] | Mapping[int, float] = 0,
    ) -> ControllerState:
        """Returns a character that stands at `position` [2] metres and faces `yaw` radians.

        Args:
            position, yaw: on the ground, and about +Y; 0 faces +Z.
            style: as for `style_weights`.

        Raises:
            InputError: for an unknown style, or weights that do not sum to one.
        """
        weights = jnp.asarray(self.style_weights(style))
        return _start_now(self.setup, self.params, jnp.asarray(position, jnp.float32), jnp.float32(yaw), weights)

    def step(self, state: ControllerState, command: Command) -> ControllerState:
        """Returns the state one frame later."""
        return _step_now(self.setup, self.params, state, command)

    def style_weights(self, choice: str | int | Mapping[str, float] | Mapping[int, float]) -> np.ndarray:
        """Returns the weights [C] of a style by name or row, or of a mixture of styles with weights that sum to one.

        Raises:
            InputError: for an unknown style, or weights that do not sum to one.
        """
        chosen = dict(choice) if isinstance(choice, Mapping) else {choice: 1.0}
        check_weights(tuple(chosen.values()), "controller", "style weights")
        weights = np.zeros(self.capacity, np.float32)
        for name, weight in chosen.items():
            by_row = not isinstance(name, str)
            if name not in (range(len(self.styles)) if by_row else self.styles):
                rule = f"must be one of {', '.join(self.styles)}, or the row of one"
                raise InputError("controller", "style", name, rule)
            weights[name if by_row else self.styles.index(name)] += weight
        return weights


def make_controller(
    run: Run,
    styles: Sequence[str] | None = None,
    capacity: int | None = None,
    *,
    later: AdapterConfig | None = None,
    foot_ik: bool = True,
    tracking: TrackingConfig | None = TrackingConfig(),  # noqa: B008 - frozen
) -> Controller:
    """Returns the controller of a run.

    Args:
        run: as `load_run` returns it. A run without styles has the one style `AGNOSTIC`: its network as it is.
        styles: names; by default all of the run's.
        capacity: C, rows of the bank, at least the number of styles: styles that are learned later fill the spare rows
            without another compilation.
        later: form of those styles; by default that of the others.
        foot_ik: lock feet that are in contact to the ground, and lay arms along the predicted positions.
        tracking: constants of command tracking (`tracking`), or None for the published loop alone.

    Raises:
        InputError: for an unknown style, styles of different kinds, or a FiLM run without styles.
    """
    names = tuple(list_styles(run.path) if styles is None else styles)
    need_style(run, names)
    recorded = {name: recorded_speed(run, name) for name in names}
    return assemble_controller(
        run.shared,
        {name: load_style(run, name) for name in names},
        run,
        speeds={name: speed for name, speed in recorded.items() if speed is not None},
        default_speed=default_speed(run, None),
        loop=loop_config(run),
        capacity=capacity,
        later=later,
        foot_ik=foot_ik,
        tracking=tracking,
    )


def assemble_controller(
    network: Network,
    styles: Mapping[str, Style],
    body: Embodiment,
    *,
    speeds: Mapping[str, float] | None = None,
    default_speed: float | None = None,
    loop: LoopConfig | None = None,
    capacity: int | None = None,
    later: AdapterConfig | None = None,
    foot_ik: bool = True,
    tracking: TrackingConfig | None = TrackingConfig(),  # noqa: B008 - frozen
) -> Controller:
    """Returns the controller of parameters in memory.

    Args:
        network: style-agnostic parameters.
        styles: by name, of one kind or of kinds that only add to layers. Without any, the network as it is is the one
            style `AGNOSTIC`.
        body: layout, skeleton and normaliser of the network.
        speeds: metres per second of styles in their data, by name, where known.
        default_speed: metres per second, for the other styles; by default that of the mean row of the data.
        loop: constants of the published loop, by default those of the layout.
        capacity, later, foot_ik, tracking: as for `make_controller`.

    Raises:
        InputError: for styles of different kinds, or a skeleton without the roles that a controller needs.
    """
    layout, normaliser, speeds = body.layout, body.normaliser, speeds or {}
    if tracking is not None:
        tracking = replace(tracking, fps=float(layout.fps))
    rig = make_rig(body.skeleton, getattr(body, "path", "skeleton"))
    loop = loop or LOOP_CONFIGS[layout.name]
    standing = StandingConfig(fps=float(layout.fps))
    setup = ControllerSetup(layout, loop, rig, FootLockConfig() if foot_ik else None, tracking, standing)
    rows = max(capacity or 0, len(styles)) if styles else 1
    default_speed = mean_speed(layout, normaliser) if default_speed is None else default_speed
    mean_row = jnp.asarray(normaliser.inputs.mean, jnp.float32)
    also = [] if later is None else [_empty_style(later, network)]
    params = ControllerParams(
        predictor=assemble_predictor(network, None, normaliser),
        bank=jax.tree.map(jnp.asarray, padded_bank(stack_styles(styles, "controller", also), rows)) if styles else None,
        speeds=jnp.asarray(padded_bank(np.asarray([speeds.get(name, 0.0) for name in styles], np.float32), rows)),
        default_speed=jnp.float32(default_speed),
        speed_gains=jnp.asarray(np.ones(rows, np.float32)),
        initial_row=_straight_row(layout, mean_row, default_speed),
        initial_phase=jnp.asarray(normaliser.initial_phase()),
        foot_heights=jnp.asarray(foot_heights(layout, normaliser, rig), jnp.float32),
    )
    names = tuple(styles) or (AGNOSTIC,)
    return with_calibrated_speeds(Controller(params, setup, names))


_straight_row = jax.jit(straight_row, static_argnums=0)


def _empty_style(config: AdapterConfig, network: Network) -> Style:
    """Returns a style of zeros of a kind; only its form matters."""
    sizes = config_of(network)
    return zeros_of(lambda key: init_style(config, sizes, key=key), jax.random.key(0))


def padded_bank(tree: Any, rows: int, value: float = 0.0) -> Any:
    """Returns leaves [S, ...] with a value up to `rows`: [rows, ...]; in NumPy, because JAX would compile it."""

    def pad(leaf: Any) -> np.ndarray:
        leaf = np.asarray(leaf)
        return np.concatenate([leaf, np.full((rows - len(leaf), *leaf.shape[1:]), value, leaf.dtype)])

    return jax.tree.map(pad, tree)


def with_calibrated_speeds(controller: Controller) -> Controller:
    """Returns the controller with the speeds of its styles calibrated, from the speeds in its `params`, and with the
    stances of these styles."""
    styles, rows = len(controller.styles), controller.capacity
    found = kept_calibration(controller.setup, controller.params, range(styles))
    arrays: dict[str, Any] = {
        "speeds": jnp.asarray(padded_bank(found.speeds, rows)),
        "speed_gains": jnp.asarray(padded_bank(found.gains, rows, 1.0)),
        "stances": commit(padded_bank(found.stances, rows)),
        "waiting": commit(padded_bank(found.waiting, rows)),
    }
    return replace(controller, params=replace(controller.params, **arrays))


@partial(jax.jit, static_argnums=0)
def step(setup: ControllerSetup, params: ControllerParams, state: ControllerState, command: Command) -> ControllerState:
    """Returns the state of one character one frame later.

    Source: the loop of Mason et al. 2018, section 5.1, and 2022, section 4.4, with command tracking.
    """
    style = state.style if command.style is None else _moved_style(state.style, command.style)
    predictor, speed = params.mixed_predictor(style), style_speed(params, style)
    tracking = state.tracking
    if setup.tracking is not None:
        state = follow_body(setup, state, is_moving(command))
        tracking = update_time_scale(tracking, command, setup.tracking)
    progress = state.progress + tracking.time_scale
    state = replace(state, style=style, tracking=tracking, progress=progress)
    advance = partial(_advance_network, setup, params, predictor, speed, command)
    state = jax.lax.while_loop(lambda inner: inner.progress > 1.0, advance, state)
    return draw_body(setup, params, state, command)


_start_now, _step_now = (jit_quickly(function, static_argnums=0) for function in (start_standing, step))


def _moved_style(style: jax.Array, target: jax.Array) -> jax.Array:
    """Returns the weights [C] after one frame on their way to the target [C]."""
    moved = lerp(style, target, STYLE_RATE)
    return jnp.where(jnp.abs(moved - target) < STYLE_SNAP, target, moved)


def _advance_network(
    setup: ControllerSetup,
    params: ControllerParams,
    predictor: Predictor,
    speed: StyleSpeed,
    command: Command,
    state: ControllerState,
) -> ControllerState:
    """Returns the state after one network frame."""
    before, tracking, config = state.motion, state.tracking, setup.tracking
    facing = before.directions[ROOT]
    if config is None:
        motion, y = network_step(setup, predictor, speed.natural, before, command)
        angle = jnp.zeros((), y.dtype)
    else:
        held = replace(held_command(before, setup.loop), style=command.style)
        tracked = network_command(command, facing, speed, tracking, config)
        requested = jax.tree.map(partial(jnp.where, is_moving(command)), tracked, held)
        motion, y = network_step(setup, predictor, speed.natural, before, requested)
        distance, stands = feet_distance(setup.rig, motion.joint_positions), state.standing.weight >= 1.0
        tracking = update_tracking(tracking, before, motion, command, distance, stands, config)
        angle = heading_correction(tracking, command, config)
        motion = turn_state(motion, angle, standing_point(setup, params, motion, y))
    frame = predicted_frame(setup, params, motion, y, facing, angle)
    progress = state.progress - 1.0
    return replace(state, motion=motion, tracking=tracking, previous=state.next, next=frame, progress=progress)


@partial(jax.jit, static_argnums=0)
def rollout_commands(
    setup: ControllerSetup, params: ControllerParams, state: ControllerState, commands: Command
) -> tuple[ControllerState, ControllerState]:
    """Runs a character under one command per frame, leaves [T, ...]; returns the last state, and all [T, ...]."""

    def frame(state: ControllerState, command: Command):
        state = step(setup, params, state, command)
        return state, state

    return jax.lax.scan(frame, state, commands)
