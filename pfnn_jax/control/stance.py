"""The stance of a style, found in its own walk, and the frame of that walk in which its network waits for the next.

The upper body, the height of the hips and the lean are the mean over a walk; the feet stand side by side, as far apart
and turned out as in the walk, and flat at the height at which they are in contact. The hips are lowered until both legs
reach, and moved so that the trunk is balanced over the feet.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.controller_state import (
    ControllerParams,
    ControllerSetup,
    PredictedFrame,
    WaitingFrame,
    carry_frame,
    feet_distance,
    network_step,
    predicted_frame,
    style_speed,
)
from pfnn_jax.control.ik.pose import Pose, Rig, forward_kinematics, pose_from_world
from pfnn_jax.control.loop.rollout import warm_up
from pfnn_jax.control.loop.state import ROOT, carry_state, initial_state
from pfnn_jax.control.loop.step import Command
from pfnn_jax.control.standing import Stance
from pfnn_jax.control.vectors import length, to_3d, unit
from pfnn_jax.motion.ground import facing_of, to_local, turn, yaw_of
from pfnn_jax.motion.kinematics import quat_from_yaw, quat_multiply

WARM_UP_FRAMES, WALK_FRAMES = 90, 120
"""Frames of the hidden walk before, and of, the part in which the stance is found: at least one cycle."""

REACH = 0.97
"""Share of its length to which a standing leg is stretched at most: up to there IK is exact (`two_bone.SOFT`)."""

LEAST_WIDTH, MOST_WIDTH = 0.6, 2.5
"""Of the distance between the feet, as a multiple of that between the hip joints: some styles walk on a line."""

MOST_TURNED_OUT = 0.5
"""Radians from the facing to a standing foot."""

AHEAD = np.array([0.0, 1.0], np.float32)


@partial(jax.jit, static_argnums=0)
def find_stances(
    setup: ControllerSetup, params: ControllerParams, weights: jax.Array
) -> tuple[Stance, WaitingFrame]:
    """Returns the stances of styles, and the frames in which their networks wait, leaves [S, ...].

    Args:
        setup, params: of a controller, with calibrated speeds.
        weights: [S, C] of the styles.
    """
    return jax.vmap(partial(_find_stance, setup, params))(weights)


def _find_stance(
    setup: ControllerSetup, params: ControllerParams, weights: jax.Array
) -> tuple[Stance, WaitingFrame]:
    layout, speed = setup.layout, style_speed(params, weights)
    predictor = params.mixed_predictor(weights)
    state = initial_state(layout, params.initial_row, params.initial_phase, jnp.zeros(2), jnp.zeros(()))
    command = Command(velocity=speed.gain * speed.natural * AHEAD, direction=jnp.asarray(AHEAD))
    step = partial(network_step, setup, predictor, speed.natural)
    states, ys = jax.tree.map(
        lambda leaf: leaf[WARM_UP_FRAMES:], warm_up(step, state, command, WARM_UP_FRAMES + WALK_FRAMES)
    )
    frames = jax.vmap(lambda motion, y: predicted_frame(setup, params, motion, y, motion.directions[ROOT - 1], 0.0))(
        states, ys
    )
    waits = jnp.argmin(jax.vmap(partial(feet_distance, setup.rig))(frames.joints))
    motion, frame = jax.tree.map(lambda leaf: leaf[waits], (states, frames))
    angle = -yaw_of(frame.facing)
    shift = -turn(frame.root, angle)
    waiting = WaitingFrame(motion=carry_state(motion, angle, shift), frame=carry_frame(frame, angle, shift))
    stance = _stance_of(setup.rig, frames, params.foot_heights.reshape(2, 2))
    # A style whose network diverges must not make mixtures without it diverge.
    return jax.tree.map(jnp.nan_to_num, stance), waiting


def _stance_of(rig: Rig, frames: PredictedFrame, foot_heights: jax.Array) -> Stance:
    """Returns the stance of a walk, leaves [T, ...], given the heights [2, 2] of heels and toes on the ground."""
    # Weights that vanish at both ends: the mean hardly depends on how many cycles the walk has.
    weights = jnp.asarray(np.hanning(WALK_FRAMES + 2)[1:-1], frames.joints.dtype)
    weights = weights / jnp.sum(weights)
    world = quat_multiply(quat_from_yaw(-yaw_of(frames.facing))[:, None], frames.rotations)
    local = jax.vmap(lambda rotations: pose_from_world(rig, jnp.zeros(3), rotations).rotations)(world)
    rotations = _mean_rotation(local, weights)
    joints = jax.vmap(lambda root, facing, joints: to_local(joints - to_3d(root)[None], facing))(
        frames.root, frames.facing, frames.joints
    )
    feet = joints[:, np.array(rig.feet)].reshape(-1, 2, 2, 3)
    stood = weights[:, None, None] * frames.contacts.reshape(-1, 2, 2) ** 4
    share = jnp.sum(stood, axis=0)
    heights = jnp.sum(stood * feet[..., 1], axis=0) / jnp.maximum(share, 1e-6)
    heights = jnp.where(share > 0.02, heights, foot_heights)
    flat = stood.min(-1) + 1e-3 * weights[:, None]
    flat = flat / jnp.sum(flat, axis=0)
    positions, _ = forward_kinematics(rig, Pose(hips=jnp.zeros(3), rotations=rotations))
    standing_feet = _feet_of(rig, feet, flat, heights, positions)
    height = jnp.sum(weights * joints[:, 0, 1])
    hips = -_trunk(rig, positions)
    height = jnp.minimum(height, _highest(rig, positions, hips, standing_feet))
    return Stance(rotations=rotations, height=height, hips=hips, feet=standing_feet)


def _mean_rotation(rotations: jax.Array, weights: jax.Array) -> jax.Array:
    """Returns the mean [J, 4] of rotations [T, J, 4] that are near each other."""
    same = jnp.sum(rotations * rotations[:1], axis=-1, keepdims=True) >= 0.0
    mean = jnp.einsum("t,tji->ji", weights, jnp.where(same, rotations, -rotations))
    return mean / jnp.maximum(length(mean)[:, None], 1e-6)


def _feet_of(rig: Rig, feet: jax.Array, flat: jax.Array, heights: jax.Array, positions: jax.Array) -> jax.Array:
    """Returns the standing feet [2, 2, 3] of a walk's feet [T, 2, 2, 3], given when they are flat [T, 2], their heights
    [2, 2] there, and joint positions [J, 3] of the stance."""
    sides = jnp.einsum("tf,tf->f", flat, feet.mean(2)[..., 0])
    (left, *_), (right, *_) = rig.legs
    between = 0.5 * length(positions[left] - positions[right])
    half = jnp.clip(0.5 * (sides[0] - sides[1]), LEAST_WIDTH * between, MOST_WIDTH * between)
    along = feet[:, :, 1] - feet[:, :, 0]
    yaw = yaw_of(jnp.einsum("tf,tfi->fi", flat, jax.vmap(jax.vmap(lambda v: unit(v[np.array([0, 2])])))(along)))
    yaw = jnp.clip(yaw, -MOST_TURNED_OUT, MOST_TURNED_OUT)
    sizes = jnp.asarray([np.linalg.norm(rig.offsets[toe]) if toe != heel else 0.0 for _, _, heel, toe in rig.legs])
    size = jnp.sqrt(jnp.maximum(sizes**2 - (heights[:, 1] - heights[:, 0]) ** 2, 0.0))
    ahead = 0.5 * size[:, None] * facing_of(yaw)
    middle = jnp.stack([jnp.stack([half, -half]), jnp.zeros(2)], axis=-1)
    ground = jnp.stack([middle - ahead, middle + ahead], axis=1)
    return jnp.stack([ground[..., 0], heights, ground[..., 1]], axis=-1)


def _trunk(rig: Rig, positions: jax.Array) -> jax.Array:
    """Returns the middle [2] of the trunk on the ground relative to the hips: between hips and shoulders."""
    shoulders = [positions[arm[0]] for arm in rig.arms]
    middle = sum(shoulders) / (2 * len(shoulders)) if shoulders else positions[0]
    return middle[np.array([0, 2])]


def _highest(rig: Rig, positions: jax.Array, hips: jax.Array, feet: jax.Array) -> jax.Array:
    """Returns the greatest height [] of the hips from which both heels are reached."""
    highest = []
    for foot, (hip, knee, heel, _) in zip(feet, rig.legs, strict=True):
        reach = REACH * (length(positions[knee] - positions[hip]) + length(positions[heel] - positions[knee]))
        level = positions[hip][np.array([0, 2])] + hips - foot[0][np.array([0, 2])]
        rise = jnp.sqrt(jnp.maximum(reach**2 - jnp.sum(level**2), 1e-6))
        highest.append(foot[0, 1] + rise - positions[hip, 1])
    return jnp.minimum(*highest)
