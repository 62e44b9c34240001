"""Initialisation of a controller: foot heights, speed calibration, and characters that stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.compiling import jit_quickly
from pfnn_jax.control.controller_state import (
    ControllerParams,
    ControllerSetup,
    ControllerState,
    Footing,
    carry_frame,
    feet_distance,
    network_step,
    standing_pose,
    style_speed,
)
from pfnn_jax.control.ik.foot_lock import initial_locks
from pfnn_jax.control.ik.pose import Rig, forward_kinematics, pose_from_world
from pfnn_jax.control.loop.rollout import warm_up
from pfnn_jax.control.loop.state import ROOT, carry_state, initial_state
from pfnn_jax.control.loop.step import Command
from pfnn_jax.control.standing import init_standing, mix_stances
from pfnn_jax.control.tracking import MIN_WALK_SPEED, init_tracking
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.motion.ground import facing_of, to_world

TRIAL_GAINS = (0.2, 0.28, 0.4, 0.55, 0.75, 1.0, 1.4, 2.0)
"""Requested speeds that `calibrate_speeds` tries, as multiples of a style's natural speed."""

DEMO_WALK_SPEEDS = {"pfnn2017": 1.5}
"""Metres per second that the published demo of a layout requests for a walk."""

UNLIMITED_SPEED = 1e3
"""Metres per second; the natural speed of a style that is still unknown, so that look-ahead is not limited."""

WARM_UP_FRAMES = 90
"""Frames of the hidden walk from the mean pose to the gait of a style. Calibration measures the next 90 frames."""

AHEAD = np.array([0.0, 1.0], np.float32)


def foot_heights(layout: FrameLayout, normaliser: Normaliser, rig: Rig) -> np.ndarray:
    """Returns the heights [4] in metres of left heel, left toe, right heel and right toe on the ground.

    In most frames of any gait a foot joint is near the ground, about one standard deviation below its mean height.
    """
    mean, std = (
        np.asarray(values)[layout.output_slice("joint_position")].reshape(-1, 3)[list(rig.feet), 1] * layout.length_unit
        for values in (normaliser.outputs.mean, normaliser.outputs.std)
    )
    return mean - std


def calibrate_speeds(
    setup: ControllerSetup, params: ControllerParams, rows: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Finds the natural speed of styles and the gains with which to request it, by trial rollouts.

    Networks do not walk at the speed that is requested: some walk slower, and some that were trained on walks and runs
    drift from a walk into a run at a walk's speed. Each style is tried at several requested speeds. Commands differ
    from the natural speed, so the choice is the request for which it and both of its neighbours come nearest to the
    natural speed; the greatest is only tried as a neighbour. The natural speed of a style without a recorded one is
    that of its response to the published demo's walk, or else to the mean speed of the data.

    Args:
        setup: of a controller.
        params: of the same controller; their bank has C rows, and `params.speeds` are the recorded speeds.
        rows: S rows of the bank, the styles to calibrate.

    Returns:
        Natural speeds [S] in metres per second, and gains [S].
    """
    chosen = np.asarray(rows, int)
    recorded = np.asarray(params.speeds)[chosen]
    fallback = DEMO_WALK_SPEEDS.get(setup.layout.name, float(params.default_speed))
    gains = np.asarray(TRIAL_GAINS if np.any(recorded > 0.0) else (1.0,))
    requested = np.where(recorded[:, None] > 0.0, recorded[:, None] * gains, fallback).astype(np.float32)
    styles = np.eye(len(params.speeds), dtype=np.float32)[chosen]
    limits = np.where(recorded > 0.0, recorded, UNLIMITED_SPEED).astype(np.float32)
    measured = np.asarray(_measure_now(setup, params, styles, limits, requested))
    measured = np.maximum(measured, MIN_WALK_SPEED)  # NaN stays NaN: a diverging rollout
    natural = np.where(recorded > 0.0, recorded, np.where(np.isfinite(measured[:, 0]), measured[:, 0], fallback))
    return natural, _best_request(requested, measured, natural) / natural


def _best_request(requested: np.ndarray, measured: np.ndarray, natural: np.ndarray) -> np.ndarray:
    """Returns the requested speed [S] of [S, A] that is most robustly answered by a style's natural speed [S].

    The error of a request is that of the worst of it and its two neighbours. For a style of which all rollouts
    diverge, it is the natural speed.
    """
    error = np.nan_to_num(np.abs(np.log(measured / natural[:, None])), nan=np.inf)
    padded = np.pad(error, ((0, 0), (1, 1)), mode="edge")
    worst = np.maximum(np.maximum(padded[:, :-2], padded[:, 2:]), error)
    best = np.argmin(worst[:, : max(requested.shape[1] - 1, 1)], axis=1)
    return np.where(np.isfinite(error).any(1), requested[np.arange(len(requested)), best], natural)


@partial(jax.jit, static_argnums=0)
def measure_walk_speed(
    setup: ControllerSetup, params: ControllerParams, styles: np.ndarray, limits: np.ndarray, requested: np.ndarray
) -> jax.Array:
    """Returns the mean speeds [S, A] in metres per second of straight walks; NaN for a diverging rollout.

    Args:
        setup, params: of a controller.
        styles: [S, C] weights.
        limits: [S] natural speeds that limit the look-ahead.
        requested: [S, A] speeds to request.
    """
    layout = setup.layout

    def measure(style: jax.Array, limit: jax.Array, speed: jax.Array) -> jax.Array:
        predictor = params.mixed_predictor(style)
        origin, yaw = jnp.zeros(2, jnp.float32), jnp.zeros((), jnp.float32)
        state = initial_state(layout, params.initial_row, params.initial_phase, origin, yaw)
        command = Command(velocity=speed * AHEAD, direction=jnp.asarray(AHEAD))
        states, _ = warm_up(partial(network_step, setup, predictor, limit), state, command, 2 * WARM_UP_FRAMES)
        steps = jnp.linalg.norm(states.positions[:, ROOT] - states.positions[:, ROOT - 1], axis=-1) * layout.fps
        return jnp.mean(steps[WARM_UP_FRAMES:])

    return jax.vmap(jax.vmap(measure, in_axes=(None, None, 0)))(*map(jnp.asarray, (styles, limits, requested)))


_measure_now = jit_quickly(measure_walk_speed, static_argnums=0)


@partial(jax.jit, static_argnums=0)
def start_standing(
    setup: ControllerSetup, params: ControllerParams, position: jax.Array, yaw: jax.Array, style: jax.Array
) -> ControllerState:
    """Returns a character that stands at a position [2] metres, facing `yaw` [] radians, in a style [C].

    Without command tracking it walks from its first frame on. The network of a mixture waits in a frame of the style
    of the greatest weight.
    """
    assert params.stances is not None
    speed, direction = style_speed(params, style), facing_of(yaw)
    waiting = jax.tree.map(lambda leaf: jnp.take(leaf, jnp.argmax(style), axis=0), params.waiting)
    motion, frame = carry_state(waiting.motion, yaw, position), carry_frame(waiting.frame, yaw, position)
    time_scale = 1.0 if setup.tracking is None else 0.0
    stance = mix_stances(params.stances, style)
    # The root, where the hips are on the ground, is at the position.
    tracked = setup.tracking is not None
    standing = init_standing(stance, position - to_world(stance.hips, direction), direction, stopped=tracked)
    pose = pose_from_world(setup.rig, frame.joints[0], frame.rotations)
    if tracked:
        nowhere = Footing(targets=standing.feet, toe_shares=jnp.ones(2))
        pose = standing_pose(setup, pose, nowhere, direction, stance, standing)
    joints, world = forward_kinematics(setup.rig, pose)
    return ControllerState(
        motion=replace(motion, target_velocity=speed.natural * direction, target_direction=direction),
        previous=frame,
        next=frame,
        progress=jnp.float32(1.0),
        style=style,
        tracking=init_tracking(speed.natural * AHEAD, feet_distance(setup.rig, frame.joints), time_scale),
        root=frame.root,
        facing=frame.facing,
        contacts=jnp.ones_like(frame.contacts) if tracked else frame.contacts,
        feet=initial_locks(setup.rig),
        standing=standing,
        pose=pose,
        joints=joints,
        world_rotations=world,
    )
