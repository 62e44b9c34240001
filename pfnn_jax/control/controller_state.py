"""The arrays and static setup of a controller, the state of one character, and its pose between two network frames.

The network is evaluated once per frame of network time. A displayed frame lies between two such frames
(`PredictedFrame`), between which joint positions, rotations and contacts are interpolated before rigid bones and the
foot lock are applied (`walking_pose`). A character that stands, or comes to stand, is drawn in its stance
(`draw_body`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.control.ik.foot_lock import FootLockConfig, FootLocks, lock_feet, needed_drop, place_feet
from pfnn_jax.control.ik.limb import reach_arms
from pfnn_jax.control.ik.pose import Pose, Rig, forward_kinematics, pose_from_world, turn_joint
from pfnn_jax.control.loop.state import CharacterState, carry_state, contacts_of_output, joint_root, read_block
from pfnn_jax.control.loop.step import Command, LoopConfig, published_step
from pfnn_jax.control.standing import (
    Stance,
    StandingConfig,
    StandingState,
    WalkingBody,
    mix_stances,
    smooth,
    sway,
    update_standing,
)
from pfnn_jax.control.tracking import (
    MIN_WALK_SPEED,
    StyleSpeed,
    TrackingConfig,
    TrackingState,
    is_moving,
    limit_lookahead,
)
from pfnn_jax.control.vectors import length, lerp, to_3d
from pfnn_jax.inference.predictor import Predictor, evaluate
from pfnn_jax.models.style import Style
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.ground import angle_between, to_world, turn, turn_towards, yaw_of
from pfnn_jax.motion.kinematics import (
    quat_exp,
    quat_from_axis_angle,
    quat_from_forward_up,
    quat_from_yaw,
    quat_multiply,
)
from pfnn_jax.motion.labels.contacts import MAX_HEIGHT, MAX_SPEED


CONTACT_HEIGHT = 0.02
"""Metres above the floor at which a standing foot counts as half in contact."""


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
class WaitingFrame:
    """The frame of a style's walk at the origin, facing +Z, in which the network of a standing character waits.

    Attributes:
        motion: state of the published loop after the frame.
        frame: as predicted.
    """

    motion: CharacterState
    frame: PredictedFrame


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
        stances, waiting: [C, ...] of the styles, found in their walks (`stance.find_stances`); None until then.
    """

    predictor: Predictor
    bank: Style | None
    speeds: jax.Array
    default_speed: jax.Array
    speed_gains: jax.Array
    initial_row: jax.Array
    initial_phase: jax.Array
    foot_heights: jax.Array
    stances: Stance | None = None
    waiting: WaitingFrame | None = None

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
        standing: constants of standing, without which no command tracking stops.
    """

    layout: FrameLayout
    loop: LoopConfig
    rig: Rig
    foot_lock: FootLockConfig | None
    tracking: TrackingConfig | None
    standing: StandingConfig = StandingConfig()


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
        feet: state of the foot locks, of the walking body.
        standing: how far the displayed body has left the network's motion, and where it stands.
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
    standing: StandingState
    pose: Pose
    joints: jax.Array
    world_rotations: jax.Array

    @property
    def time_scale(self) -> jax.Array:
        """Returns the seconds [] of network time per second of real time, in so far as the network's motion is drawn: 0
        while the character stands."""
        return self.tracking.time_scale * (1.0 - self.standing.weight)


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


def walking_pose(setup: ControllerSetup, state: ControllerState) -> tuple[Pose, jax.Array, jax.Array, FootLocks]:
    """Returns the body at its position between two predicted frames: pose, joints [J, 3], contacts [4] and foot locks."""
    before, after, share = state.previous, state.next, state.progress
    predicted = lerp(before.joints, after.joints, share)
    contacts = lerp(before.contacts, after.contacts, share)
    pose = pose_from_world(setup.rig, predicted[0], _mix_rotations(before.rotations, after.rotations, share))
    feet = state.feet
    if setup.foot_lock is not None:
        pose, feet = lock_feet(setup.rig, reach_arms(setup.rig, pose, predicted), contacts, feet, setup.foot_lock)
    return pose, forward_kinematics(setup.rig, pose)[0], contacts, feet


def draw_body(
    setup: ControllerSetup, params: ControllerParams, state: ControllerState, command: Command
) -> ControllerState:
    """Returns the state with the displayed body: at its position between two predicted frames, or in its stance."""
    root = lerp(state.previous.root, state.next.root, state.progress)
    facing = turn_towards(state.previous.facing, state.next.facing, state.progress)
    pose, joints, contacts, locks = walking_pose(setup, state)
    state = replace(state, feet=locks, root=root, facing=facing, contacts=contacts)
    if setup.tracking is None:
        joints, world = forward_kinematics(setup.rig, pose)
        return replace(state, pose=pose, joints=joints, world_rotations=world)
    assert params.stances is not None
    stance, ground = mix_stances(params.stances, state.style), np.array([0, 2])
    body = WalkingBody(
        hips=joints[0, ground],
        facing=facing,
        feet=joints[np.array(setup.rig.feet)].reshape(2, 2, 3),
        contacts=contacts.reshape(2, 2),
        speed=style_speed(params, state.style).natural,
    )
    standing = update_standing(
        state.standing,
        body,
        stance,
        is_moving(command),
        command.direction,
        setup.rig.leg_length,
        setup.standing,
    )
    stands, share = standing.weight > 0.0, smooth(standing.weight)
    pose = jax.lax.cond(
        stands, partial(standing_pose, setup), lambda pose, *_: pose, pose, facing, stance, standing
    )
    joints, world = forward_kinematics(setup.rig, pose)
    from_hips = turn(root - body.hips, angle_between(facing, standing.facing))
    return replace(
        state,
        standing=standing,
        root=jnp.where(stands, standing.hips + (1.0 - share) * from_hips, root),
        facing=standing.facing,
        contacts=jnp.where(stands, lerp(contacts, _standing_contacts(stance, standing), share), contacts),
        pose=pose,
        joints=joints,
        world_rotations=world,
    )


def standing_pose(
    setup: ControllerSetup, walked: Pose, facing: jax.Array, stance: Stance, standing: StandingState
) -> Pose:
    """Returns the pose of a character that stands, or comes to stand.

    Args:
        setup: of the controller.
        walked: pose in which the network has it.
        facing: [2] of that.
        stance: of its style.
        standing: its state.
    """
    rig, share = setup.rig, smooth(standing.weight)
    turned = quat_multiply(quat_from_yaw(-yaw_of(facing)), walked.rotations[0])
    rotations = _mix_rotations(walked.rotations.at[0].set(turned), stance.rotations, share)
    yaw = yaw_of(standing.facing)
    rotations = rotations.at[0].set(quat_multiply(quat_from_yaw(yaw), rotations[0]))
    shift, pitch = sway(standing, rig.leg_length, setup.standing)
    left = to_world(jnp.stack([jnp.ones_like(shift), 0.0 * shift]), standing.facing)
    ground, height = standing.hips + shift * left, lerp(walked.hips[1], stance.height, share)
    pose = Pose(hips=jnp.stack([ground[0], height, ground[1]]), rotations=rotations)
    positions, world = forward_kinematics(rig, pose)
    if (chest := rig.chest) is not None:
        pose = turn_joint(rig, pose, world, chest, quat_from_axis_angle(to_3d(left), pitch))
    drop = needed_drop(rig, positions, standing.feet.reshape(4, 3), setup.foot_lock or FootLockConfig())
    down = jnp.stack([jnp.zeros_like(drop), -drop, jnp.zeros_like(drop)])
    pose, positions = replace(pose, hips=pose.hips + down), positions + down[None]
    feet = jnp.stack([_lift_heel(rig, positions, side, standing.feet[side]) for side in range(2)])
    return place_feet(rig, pose, positions, world, feet, jnp.ones(2))


def _lift_heel(rig: Rig, positions: jax.Array, side: int, foot: jax.Array) -> jax.Array:
    """Returns a foot [2, 3] with its heel lifted towards the hip as far as the leg is too short for it."""
    hip, knee, heel, _ = rig.legs[side]
    reach = 0.995 * (length(positions[knee] - positions[hip]) + length(positions[heel] - positions[knee]))
    # As the predicted leg, which may be stretched more.
    reach = jnp.maximum(reach, length(positions[heel] - positions[hip]))
    to = positions[hip] - foot[0]
    far = length(to)
    return foot.at[0].add(to * (jnp.maximum(far - reach, 0.0) / jnp.maximum(far, 1e-6)))


def _standing_contacts(stance: Stance, standing: StandingState) -> jax.Array:
    """Returns the contacts [4] of a standing character: 1 for a heel or toe on the floor."""
    above = standing.feet[..., 1] - stance.feet[..., 1]
    return jnp.clip(1.5 - above / CONTACT_HEIGHT, 0.0, 1.0).reshape(4)


def carry(state: ControllerState, angle: jax.Array, shift: jax.Array) -> ControllerState:
    """Rotates what the network has predicted by an angle [] radians about the origin, then shifts it by [2] metres.

    The displayed body stays. An angle and a shift of 0 leave every number as it is."""
    turned, feet = partial(turn, angle=angle), state.feet
    return replace(
        state,
        motion=carry_state(state.motion, angle, shift),
        previous=carry_frame(state.previous, angle, shift),
        next=carry_frame(state.next, angle, shift),
        feet=replace(
            feet,
            positions=turned(feet.positions) + to_3d(shift)[None],
            offsets=turned(feet.offsets),
            velocities=turned(feet.velocities),
        ),
    )


def carry_frame(frame: PredictedFrame, angle: jax.Array, shift: jax.Array) -> PredictedFrame:
    """Rotates a frame by an angle [] radians about the origin, then shifts it by [2] metres."""
    return replace(
        frame,
        root=turn(frame.root, angle) + shift,
        facing=turn(frame.facing, angle),
        joints=turn(frame.joints, angle) + to_3d(shift)[None],
        rotations=_turn_rotations(frame.rotations, angle),
    )


def follow_body(setup: ControllerSetup, state: ControllerState, moving: jax.Array) -> ControllerState:
    """Returns the state with the network's motion carried to where the body has come to, while that stands.

    The root goes with the displayed root. When the character walks off, the foot on which the network stands does.
    """
    standing = state.standing
    root = lerp(state.previous.root, state.next.root, state.progress)
    facing = turn_towards(state.previous.facing, state.next.facing, state.progress)
    angle = jnp.where(standing.stopped, angle_between(facing, standing.facing), 0.0)
    feet = lerp(state.previous.joints, state.next.joints, state.progress)[np.array(setup.rig.feet)].reshape(2, 2, 3)
    lower = jnp.argmin(jnp.mean(feet[..., 1], axis=1))
    foot, there = (jnp.mean(jnp.take(points, lower, axis=0), axis=0)[np.array([0, 2])] for points in (feet, standing.feet))
    place, target = jnp.where(moving, foot, root), jnp.where(moving, there, state.root)
    return carry(state, angle, jnp.where(standing.stopped, target - turn(place, angle), 0.0))


def feet_distance(rig: Rig, joints: jax.Array) -> jax.Array:
    """Returns the distance [] in metres on the ground between the middles of both feet, of joints [J, 3]."""
    feet = jnp.mean(joints[np.array(rig.feet)].reshape(2, 2, 3), axis=1)
    return length((feet[1] - feet[0])[np.array([0, 2])])


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
