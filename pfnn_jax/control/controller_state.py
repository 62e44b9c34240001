"""The arrays and static setup of a controller, the state of one character, and its pose between two network frames.

The network is evaluated once per frame of network time. A displayed frame lies between two such frames
(`PredictedFrame`), between which joint positions, rotations and contacts are interpolated before rigid bones and the
foot lock are applied (`interpolate_pose`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.control.ik.foot_lock import FootLockConfig, FootLocks, lock_feet
from pfnn_jax.control.ik.limb import reach_arms
from pfnn_jax.control.ik.pose import Pose, Rig, forward_kinematics, pose_from_world
from pfnn_jax.control.loop.state import CharacterState, contacts_of_output, joint_root, read_block
from pfnn_jax.control.loop.step import Command, LoopConfig, published_step
from pfnn_jax.control.tracking import MIN_WALK_SPEED, StyleSpeed, TrackingConfig, TrackingState, limit_lookahead
from pfnn_jax.control.vectors import lerp
from pfnn_jax.inference.predictor import Predictor, evaluate
from pfnn_jax.models.style import Style
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.ground import turn_towards, yaw_of
from pfnn_jax.motion.kinematics import quat_exp, quat_from_forward_up, quat_from_yaw, quat_multiply
from pfnn_jax.motion.labels.contacts import MAX_HEIGHT, MAX_SPEED


@struct.dataclass(kw_only=True)
class ControllerParams:
    """The arrays of a controller.

    Attributes:
        predictor: network and statistics, without a style.
        bank: C styles, leaves [C, ...]; rows beyond the named ones are zeros. None for a run without styles.
        speeds: [C] m/s, natural speeds of the styles; 0 where unknown.
        default_speed: [] m/s, for styles without a recorded speed.
        speed_gains: [C] speed to request from the network for each style, as a multiple of its natural speed, so that
            it walks at that speed (`calibration.calibrate_speeds`).
        initial_row: [Dx] row of inputs, in layout units, that the warm-up starts from.
        initial_phase: [] radians or [G], the gating input of that row.
        foot_heights: [4] metres, height of left heel, left toe, right heel, right toe on the ground.
    """

    predictor: Predictor
    bank: Style | None
    speeds: jax.Array
    default_speed: jax.Array
    speed_gains: jax.Array
    initial_row: jax.Array
    initial_phase: jax.Array
    foot_heights: jax.Array

    def mixed_predictor(self, weights: jax.Array) -> Predictor:
        """Returns the predictor of the mixture of the bank's styles by weights [C]."""
        return replace(self.predictor, style=None if self.bank is None else self.bank.mix_dynamic(weights))


@dataclass(frozen=True)
class ControllerSetup:
    """The static part of a controller, for which its functions are compiled.

    Attributes:
        layout: of the network's rows.
        loop: constants of the published loop.
        rig: of the body.
        foot_lock: when feet are locked, or None for a body as the network predicts it.
        tracking: constants of command tracking, or None for the published loop alone.
    """

    layout: FrameLayout
    loop: LoopConfig
    rig: Rig
    foot_lock: FootLockConfig | None
    tracking: TrackingConfig | None


@struct.dataclass(kw_only=True)
class PredictedFrame:
    """One predicted frame.

    Attributes:
        root, facing: [2] metres, and a unit vector, of the root that the joints are relative to.
        joints: [J, 3] metres in the world, blended as the published loop blends them.
        rotations: [J, 4] in the world, wxyz.
        contacts: [4] in [0, 1]: left heel, left toe, right heel, right toe.
    """

    root: jax.Array
    facing: jax.Array
    joints: jax.Array
    rotations: jax.Array
    contacts: jax.Array


@struct.dataclass(kw_only=True)
class ControllerState:
    """The state of one character between two displayed frames.

    Attributes:
        motion: state of the published loop, after the frame `next`.
        previous, next: the two predicted frames that the displayed frame lies between.
        progress: [] in (0, 1], position between the two, in network frames.
        style: [C] weights, moving towards the commanded ones.
        tracking: time scale, and the rest of the state of command tracking.
        root, facing: [2] metres on the ground, and the unit vector that the character faces.
        contacts: [4] in [0, 1]: left heel, left toe, right heel, right toe.
        feet: state of the foot locks.
        pose: the displayed body, with rigid bones.
        joints, world_rotations: [J, 3] metres and [J, 4] wxyz of the pose, in the world.
    """

    motion: CharacterState
    previous: PredictedFrame
    next: PredictedFrame
    progress: jax.Array
    style: jax.Array
    tracking: TrackingState
    root: jax.Array
    facing: jax.Array
    contacts: jax.Array
    feet: FootLocks
    pose: Pose
    joints: jax.Array
    world_rotations: jax.Array

    @property
    def time_scale(self) -> jax.Array:
        """Returns the seconds [] of network time per second of real time."""
        return self.tracking.time_scale


def style_speed(params: ControllerParams, weights: jax.Array) -> StyleSpeed:
    """Returns the natural speed of a mixture of styles and the gain by which to request it.

    Both the natural and the requested speed are means over the styles. Weights may be negative, speeds are not.
    """
    speeds = jnp.where(params.speeds > 0.0, params.speeds, params.default_speed)
    natural = jnp.maximum(jnp.dot(weights, speeds), MIN_WALK_SPEED)
    requested = jnp.maximum(jnp.dot(weights, params.speed_gains * speeds), 0.0)
    return StyleSpeed(natural=natural, gain=requested / natural)


def network_step(
    setup: ControllerSetup, predictor: Predictor, natural_speed: jax.Array, state: CharacterState, command: Command
) -> tuple[CharacterState, jax.Array]:
    """Computes one frame of the published loop (`published_step`) with the look-ahead speed limited for a style's
    natural speed [] m/s."""
    if setup.tracking is not None:
        state = limit_lookahead(state, natural_speed, setup.tracking)
    return published_step(partial(evaluate, predictor), setup.layout, state, command, setup.loop)


def predicted_frame(
    setup: ControllerSetup,
    params: ControllerParams,
    motion: CharacterState,
    y: jax.Array,
    facing: jax.Array,
    angle: jax.Array,
) -> PredictedFrame:
    """Returns the predicted frame of an output.

    Args:
        setup, params: of the controller.
        motion: state of the loop after the frame.
        y: [Dy] output, in layout units.
        facing: [2] facing of the root that y is relative to.
        angle: [] radians by which the character has been rotated since.
    """
    index = joint_root(setup.layout)
    return PredictedFrame(
        root=motion.positions[index],
        facing=motion.directions[index],
        joints=motion.joint_positions,
        rotations=_turn_rotations(_predicted_rotations(setup.layout, y, facing), angle),
        contacts=_predicted_contacts(setup, params, motion, y),
    )


def interpolate_pose(setup: ControllerSetup, state: ControllerState) -> ControllerState:
    """Returns the state with the displayed body at its position between two predicted frames."""
    before, after, share = state.previous, state.next, state.progress
    predicted = lerp(before.joints, after.joints, share)
    contacts = lerp(before.contacts, after.contacts, share)
    pose = pose_from_world(setup.rig, predicted[0], _mix_rotations(before.rotations, after.rotations, share))
    feet = state.feet
    if setup.foot_lock is not None:
        # While the character is standing, held feet stay held regardless of the predicted contacts.
        kept = jnp.where(state.time_scale > 0.0, contacts, jnp.where(feet.held, 1.0, contacts))
        pose, feet = lock_feet(setup.rig, reach_arms(setup.rig, pose, predicted), kept, feet, setup.foot_lock)
    joints, world = forward_kinematics(setup.rig, pose)
    return replace(
        state,
        root=lerp(before.root, after.root, share),
        facing=turn_towards(before.facing, after.facing, share),
        contacts=contacts,
        feet=feet,
        pose=pose,
        joints=joints,
        world_rotations=world,
    )


def feet_clearance(setup: ControllerSetup, params: ControllerParams, joints: jax.Array) -> jax.Array:
    """Returns the height [] in metres of the higher foot above the ground, by the lower of its heel and toe.

    Args:
        setup, params: of the controller.
        joints: [J, 3] metres in the world.
    """
    heights = joints[np.array(setup.rig.feet), 1] - params.foot_heights
    return jnp.max(jnp.min(heights.reshape(2, 2), axis=1))


def _predicted_rotations(layout: FrameLayout, y: jax.Array, facing: jax.Array) -> jax.Array:
    """Returns the joint rotations [J, 4] in the world of an output y [Dy] relative to a root facing [2]."""
    if layout.has_output("joint_rotation"):
        local = quat_exp(read_block(layout, y, "joint_rotation", 3))
    else:
        local = quat_from_forward_up(*(read_block(layout, y, name, 3) for name in ("joint_forward", "joint_up")))
    return _turn_rotations(local, yaw_of(facing))


def _turn_rotations(rotations: jax.Array, angle: jax.Array) -> jax.Array:
    """Returns rotations [J, 4] in the world, turned by an angle [] radians about +Y."""
    return quat_multiply(quat_from_yaw(angle)[None], rotations)


def _mix_rotations(old: jax.Array, new: jax.Array, share: jax.Array) -> jax.Array:
    """Interpolates rotations [J, 4] that are near each other linearly by a share []; beyond 1 it extrapolates."""
    same = jnp.sum(old * new, axis=-1, keepdims=True) >= 0.0
    mixed = old + share * (jnp.where(same, new, -new) - old)
    return mixed * jax.lax.rsqrt(jnp.maximum(jnp.sum(mixed * mixed, axis=-1, keepdims=True), 1e-12))


def _predicted_contacts(
    setup: ControllerSetup, params: ControllerParams, motion: CharacterState, y: jax.Array
) -> jax.Array:
    """Returns the contacts [4] in [0, 1] of left heel, left toe, right heel and right toe.

    For a layout without contacts they follow from the feet's motion by the rule that labels clips (`motion.contacts`):
    a foot joint is in contact while it is slow and not far above its height on the ground.
    """
    contacts = contacts_of_output(setup.layout, y)
    if contacts is not None:
        return contacts
    rig, feet = setup.rig, np.array(setup.rig.feet)
    velocity = motion.joint_velocities[feet]
    speed = jnp.sqrt(jnp.sum(velocity * velocity, axis=-1) + 1e-12) / (MAX_SPEED * rig.leg_length)
    height = (motion.joint_positions[feet, 1] - params.foot_heights) / (MAX_HEIGHT * rig.leg_length)
    # 0.5 at the limit of the rule, 1 at half of it, 0 at one and a half times it.
    return jnp.clip(1.5 - jnp.maximum(speed, height), 0.0, 1.0)
