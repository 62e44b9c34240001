"""The stance of a style, found in its own walk, and the frame of that walk in which its network waits for the next.

The pose of the body is the mean over a walk; the feet stand side by side, as far apart and turned out as in the walk,
flat at the heights at which the data's feet rest, or else at those of their contacts. The hips are as high as the walk
has them at most, when it passes over a straight leg, or as both legs reach, and moved so that the trunk is balanced
over the feet.
"""

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
    PredictedFrame,
    WaitingFrame,
    carry_frame,
    feet_distance,
    network_step,
    predicted_frame,
    style_speed,
)
from pfnn_jax.control.ik.pose import Rig, forward_kinematics, pose_from_world
from pfnn_jax.control.loop.state import ROOT, CharacterState, carry_state, initial_state
from pfnn_jax.control.loop.step import Command
from pfnn_jax.control.standing import GROUND, Stance
from pfnn_jax.motion.ground import facing_of, to_local, turn, yaw_of
from pfnn_jax.motion.kinematics import quat_conjugate, quat_from_yaw, quat_multiply, quat_rotate

WARM_UP_FRAMES, WALK_FRAMES = 90, 120
"""Frames of the hidden walk before, and of, the part in which the stance is found: at least one cycle."""

REACH = 0.97
"""Share of its length to which a standing leg is stretched at most: up to there IK is exact (`two_bone.SOFT`)."""

LEAST_WIDTH, MOST_WIDTH = 0.6, 2.5
"""Of the distance between the feet, as a multiple of that between the hip joints: some styles walk on a line."""

MOST_TURNED_OUT = 0.5
"""Radians from the facing to a standing foot."""

MIN_STOOD = 0.02
"""Share of a walk's frames in contact below which a foot's height is taken from the data of all styles."""

AHEAD = np.array([0.0, 1.0], np.float32)


def find_stances(setup: ControllerSetup, params: ControllerParams, rows: Sequence[int]) -> tuple[Stance, WaitingFrame]:
    """Returns the stances of styles, and the frames in which their networks wait, leaves [S, ...], in NumPy.

    Args:
        setup, params: of a controller with C rows, with calibrated speeds.
        rows: S rows of the bank, the styles.
    """
    weights = np.eye(len(params.speeds), dtype=np.float32)[np.asarray(rows, int)]
    frames, waiting = jax.tree.map(np.asarray, _walks_now(setup, params, weights))
    heights = np.asarray(params.foot_heights, np.float64).reshape(2, 2)
    walks = (jax.tree.map(lambda leaf: leaf[row].astype(np.float64), frames) for row in range(len(rows)))  # noqa: B023
    stances = [_stance_of(setup.rig, walk, heights) for walk in walks]
    # A style whose network diverges must not make mixtures without it diverge.
    stance = jax.tree.map(lambda *leaves: np.nan_to_num(np.stack(leaves)).astype(np.float32), *stances)
    return stance, waiting


@partial(jax.jit, static_argnums=0)
def _walks(
    setup: ControllerSetup, params: ControllerParams, weights: np.ndarray
) -> tuple[PredictedFrame, WaitingFrame]:
    """Returns the frames, on rigid bones, of straight walks of styles [S, C], and the frame in which each waits."""
    layout, rig = setup.layout, setup.rig

    def walk(weights: jax.Array) -> tuple[PredictedFrame, WaitingFrame]:
        speed, predictor = style_speed(params, weights), params.mixed_predictor(weights)
        state = initial_state(layout, params.initial_row, params.initial_phase, jnp.zeros(2), jnp.zeros(()))
        command = Command(velocity=speed.gain * speed.natural * AHEAD, direction=jnp.asarray(AHEAD))
        step = partial(network_step, setup, predictor, speed.natural)

        def frame(state: CharacterState, _: None):
            after, y = step(state, command)
            return after, (after, y, state.directions[ROOT])

        def predicted(after: CharacterState, y: jax.Array, facing: jax.Array) -> WaitingFrame:
            return WaitingFrame(motion=after, frame=predicted_frame(setup, params, after, y, facing, jnp.zeros(())))

        # One loop for both parts: the network's step is then compiled once.
        frames = jax.lax.scan(frame, state, length=WARM_UP_FRAMES + WALK_FRAMES)[1]
        found = jax.vmap(predicted)(*jax.tree.map(lambda leaf: leaf[WARM_UP_FRAMES:], frames))
        first = jnp.argmin(jax.vmap(partial(feet_distance, rig))(found.frame.joints))
        waiting = jax.tree.map(lambda leaf: leaf[first], found)
        angle = -yaw_of(waiting.frame.facing)
        shift = -turn(waiting.frame.root, angle)
        motion, placed = carry_state(waiting.motion, angle, shift), carry_frame(waiting.frame, angle, shift)
        return jax.vmap(partial(_on_rigid_bones, rig))(found.frame), WaitingFrame(motion=motion, frame=placed)

    return jax.vmap(walk)(jnp.asarray(weights))


_walks_now = jit_quickly(_walks, static_argnums=0)


def _on_rigid_bones(rig: Rig, frame: PredictedFrame) -> PredictedFrame:
    """Returns a predicted frame with its joints [J, 3] on the rig's bones, as a drawn body has them.

    The feet among the predicted joints can be centimetres higher.
    """
    pose = pose_from_world(rig, frame.joints[0], frame.rotations)
    return replace(frame, joints=forward_kinematics(rig, pose)[0])


def _stance_of(rig: Rig, walk: PredictedFrame, foot_heights: np.ndarray) -> Stance:
    """Returns the stance of a walk, leaves [T, ...], given the heights [2, 2] of heels and toes on the ground."""
    # Weights that vanish at both ends: the mean hardly depends on how many cycles the walk has.
    weights = np.hanning(WALK_FRAMES + 2)[1:-1]
    weights = weights / weights.sum()
    world = quat_multiply(quat_from_yaw(-yaw_of(walk.facing))[:, None], walk.rotations)
    above = world[:, np.maximum(rig.parents, 0)]
    local = np.concatenate([world[:, :1], quat_multiply(quat_conjugate(above), world)[:, 1:]], axis=1)
    rotations = _mean_rotation(local, weights)
    ground = np.array([1.0, 0.0, 1.0])
    joints = to_local(walk.joints - ground * walk.root[:, None, [0, 0, 1]], walk.facing)
    feet = joints[:, list(rig.feet)].reshape(-1, 2, 2, 3)
    stood = weights[:, None, None] * walk.contacts.reshape(-1, 2, 2) ** 4
    share = stood.sum(0)
    heights = np.where(share > MIN_STOOD, _weighted_quartile(feet[..., 1], stood), foot_heights)
    if rig.resting_heights is not None:
        heights = np.array(rig.resting_heights)
    flat = stood.min(-1) + 1e-3 * weights[:, None]
    positions, turned = _joints_of(rig, rotations)
    standing_feet = _feet_of(rig, feet, flat / flat.sum(0), heights, positions)
    hips = -_trunk(rig, positions)
    height = min(joints[:, 0, 1].max(), _highest(rig, positions, hips, standing_feet))
    found = {
        "rotations": rotations,
        "height": height,
        "hips": hips,
        "feet": standing_feet,
        "chest": turned[rig.chest or 0],
    }
    return Stance(**{name: jnp.asarray(value) for name, value in found.items()})


def _weighted_quartile(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Returns the lower quartiles over the first axis of values [T, ...] with weights [T, ...].

    A joint that is in contact is higher while the foot rolls over it than while the foot is flat.
    """
    order = np.argsort(values, axis=0)
    values, weights = (np.take_along_axis(array, order, axis=0) for array in (values, weights))
    below = np.cumsum(weights, axis=0) < 0.25 * weights.sum(0)
    return np.take_along_axis(values, below.sum(0)[None], axis=0)[0]


def _mean_rotation(rotations: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Returns the mean [J, 4] of rotations [T, J, 4] that are near each other."""
    same = np.sum(rotations * rotations[:1], axis=-1, keepdims=True) >= 0.0
    mean = np.einsum("t,tji->ji", weights, np.where(same, rotations, -rotations))
    return mean / np.maximum(np.linalg.norm(mean, axis=-1, keepdims=True), 1e-6)


def _joints_of(rig: Rig, rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns positions [J, 3] relative to the hips and world rotations [J, 4] of local rotations [J, 4]."""
    positions, world = np.zeros((rig.num_joints, 3)), np.array(rotations)
    for joint, parent in enumerate(rig.parents):
        if parent >= 0:
            positions[joint] = positions[parent] + quat_rotate(world[parent], np.array(rig.offsets[joint]))
            world[joint] = quat_multiply(world[parent], rotations[joint])
    return positions, world


def _feet_of(rig: Rig, feet: np.ndarray, flat: np.ndarray, heights: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Returns the standing feet [2, 2, 3] of a walk's feet [T, 2, 2, 3], given when they are flat [T, 2], their heights
    [2, 2] there, and joint positions [J, 3] of the stance."""
    sides = np.einsum("tf,tf->f", flat, feet.mean(2)[..., 0])
    (left, *_), (right, *_) = rig.legs
    between = 0.5 * np.linalg.norm(positions[left] - positions[right])
    half = np.clip(0.5 * (sides[0] - sides[1]), LEAST_WIDTH * between, MOST_WIDTH * between)
    along = (feet[:, :, 1] - feet[:, :, 0])[..., GROUND]
    along = along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-6)
    yaw = np.clip(yaw_of(np.einsum("tf,tfi->fi", flat, along)), -MOST_TURNED_OUT, MOST_TURNED_OUT)
    sizes = np.linalg.norm(feet[0, :, 1] - feet[0, :, 0], axis=-1)
    size = np.sqrt(np.maximum(sizes**2 - (heights[:, 1] - heights[:, 0]) ** 2, 0.0))
    ahead = 0.5 * size[:, None] * facing_of(yaw)
    middle = np.array([[half, 0.0], [-half, 0.0]])
    ground = np.stack([middle - ahead, middle + ahead], axis=1)
    return np.stack([ground[..., 0], heights, ground[..., 1]], axis=-1)


def _trunk(rig: Rig, positions: np.ndarray) -> np.ndarray:
    """Returns the middle [2] of the trunk on the ground relative to the hips: between hips and shoulders."""
    shoulders = [positions[arm[0]] for arm in rig.arms] or [positions[0]]
    return 0.5 * np.mean(shoulders, axis=0)[GROUND]


def _highest(rig: Rig, positions: np.ndarray, hips: np.ndarray, feet: np.ndarray) -> float:
    """Returns the greatest height of the hips from which both heels are reached."""
    highest = []
    for foot, (hip, knee, heel, _) in zip(feet, rig.legs, strict=True):
        bones = positions[knee] - positions[hip], positions[heel] - positions[knee]
        reach = REACH * sum(float(np.linalg.norm(bone)) for bone in bones)
        level = positions[hip][GROUND] + hips - foot[0][GROUND]
        highest.append(foot[0, 1] + np.sqrt(max(reach**2 - float(level @ level), 1e-6)) - positions[hip, 1])
    return min(highest)
