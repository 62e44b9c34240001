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

from pfnn_jax.control.ik.foot_lock import FootLockConfig, FootLocks, needed_drop, place_feet, plan_feet
from pfnn_jax.control.ik.limb import reach_arms
from pfnn_jax.control.ik.pose import Pose, Rig, forward_kinematics, pose_from_world
from pfnn_jax.control.loop.state import ROOT, CharacterState, carry_state, contacts_of_output, joint_root, read_block
from pfnn_jax.control.loop.step import Command, LoopConfig, published_step
from pfnn_jax.control.standing import (
    GROUND,
    Stance,
    StandingConfig,
    StandingState,
    WalkingBody,
    mix_stances,
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
from pfnn_jax.control.vectors import length, lerp, smoothstep, to_3d
from pfnn_jax.inference.predictor import Predictor, evaluate
from pfnn_jax.models.style import Style
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.ground import angle_between, turn, turn_towards, yaw_of
from pfnn_jax.motion.kinematics import (
    quat_conjugate,
    quat_exp,
    quat_from_axis_angle,
    quat_from_forward_up,
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
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


@struct.dataclass(kw_only=True)
class Footing:
    """Where heels and toes of a pose go.

    Attributes:
        targets: [2, 2, 3] metres, heel and toe of both feet.
        toe_shares: [2], as `ik.foot_lock.place_feet` takes them.
    """

    targets: jax.Array
    toe_shares: jax.Array


def walking_pose(setup: ControllerSetup, state: ControllerState) -> tuple[Pose, Footing, FootLocks]:
    """Returns the body at its position between two predicted frames, before its feet are placed, and where they go."""
    rig, share = setup.rig, state.progress
    predicted = lerp(state.previous.joints, state.next.joints, share)
    rotations = _mix_rotations(state.previous.rotations, state.next.rotations, share)
    pose, locks = pose_from_world(rig, predicted[0], rotations), state.feet
    positions, world = forward_kinematics(rig, pose)
    if setup.foot_lock is None:
        targets = positions[np.array(rig.feet)].reshape(2, 2, 3)
        return pose, Footing(targets=targets, toe_shares=jnp.ones(2)), locks
    targets, toe_shares, locks = plan_feet(rig, positions, state.contacts, locks, setup.foot_lock)
    pose = reach_arms(rig, pose, predicted, (positions, world))
    return _lowered(pose, locks.drop[0]), Footing(targets=targets, toe_shares=toe_shares), locks


def draw_body(
    setup: ControllerSetup, params: ControllerParams, state: ControllerState, command: Command
) -> ControllerState:
    """Returns the state with the displayed body: at its position between two predicted frames, or in its stance."""
    before, after, progress = state.previous, state.next, state.progress
    root, facing = lerp(before.root, after.root, progress), turn_towards(before.facing, after.facing, progress)
    contacts = lerp(before.contacts, after.contacts, progress)
    state = replace(state, root=root, facing=facing, contacts=contacts)
    pose, footing, locks = walking_pose(setup, state)
    state = replace(state, feet=locks)
    if setup.tracking is None:
        return _with_body(setup, state, _placed(setup, pose, footing))
    assert params.stances is not None
    stance = mix_stances(params.stances, state.style)
    walk = WalkingBody(
        hips=pose.hips[GROUND],
        facing=facing,
        feet=footing.targets,
        contacts=contacts.reshape(2, 2),
        speed=style_speed(params, state.style).natural,
    )
    standing = update_standing(
        state.standing, walk, stance, is_moving(command), command.direction, setup.rig.leg_length, setup.standing
    )
    stands, share = standing.weight > 0.0, smoothstep(standing.weight)
    from_hips = turn(root - walk.hips, angle_between(facing, standing.facing))
    state = replace(
        state,
        standing=standing,
        root=jnp.where(stands, standing.hips + (1.0 - share) * from_hips, root),
        facing=standing.facing,
        contacts=jnp.where(stands, lerp(contacts, _standing_contacts(stance, standing), share), contacts),
    )
    return _with_body(setup, state, standing_pose(setup, pose, footing, facing, stance, standing))


def _with_body(setup: ControllerSetup, state: ControllerState, pose: Pose) -> ControllerState:
    """Returns the state with a pose as the displayed body."""
    joints, world = forward_kinematics(setup.rig, pose)
    return replace(state, pose=pose, joints=joints, world_rotations=world)


def _placed(setup: ControllerSetup, pose: Pose, footing: Footing) -> Pose:
    """Returns a walking pose with its feet placed, if they are locked."""
    if setup.foot_lock is None:
        return pose
    positions, world = forward_kinematics(setup.rig, pose)
    return place_feet(setup.rig, pose, positions, world, footing.targets, footing.toe_shares)


def standing_pose(
    setup: ControllerSetup,
    walked: Pose,
    footing: Footing,
    facing: jax.Array,
    stance: Stance,
    standing: StandingState,
) -> Pose:
    """Returns the pose of a character that stands, comes to stand, or walks: the walking pose where the weight is 0.

    Args:
        setup: of the controller.
        walked, footing: pose in which the network has it, and where its feet go.
        facing: [2] of that.
        stance: of its style.
        standing: its state.
    """
    rig, stands = setup.rig, standing.weight > 0.0
    base = jax.tree.map(partial(jnp.where, stands), _blended(setup, walked, facing, stance, standing), walked)
    positions, world = forward_kinematics(rig, base)
    drop = needed_drop(rig, positions, standing.feet.reshape(4, 3), setup.foot_lock or FootLockConfig())
    drop = jnp.where(stands, drop, 0.0)
    lowered, positions = _lowered(base, drop), positions - drop * np.array([[0.0, 1.0, 0.0]], np.float32)
    feet = jnp.stack([_lift_heel(rig, positions, side, standing.feet[side]) for side in range(2)])
    targets = jnp.where(stands, feet, footing.targets)
    shares = jnp.where(stands, 1.0, footing.toe_shares)
    placed = place_feet(rig, lowered, positions, world, targets, shares)
    if setup.foot_lock is None:
        return jax.tree.map(partial(jnp.where, stands), placed, walked)
    return placed


def _blended(setup: ControllerSetup, walked: Pose, facing: jax.Array, stance: Stance, standing: StandingState) -> Pose:
    """Returns the pose between the walk and the stance, which breathes and sways, before its feet are placed."""
    share = smoothstep(standing.weight)
    turned = quat_multiply(quat_from_yaw(-yaw_of(facing)), walked.rotations[0])
    rotations = _mix_rotations(walked.rotations.at[0].set(turned), stance.rotations, share)
    shift, pitch = sway(standing, setup.rig.leg_length, setup.standing)
    if (chest := setup.rig.chest) is not None:
        # Locally about the axis that points to the left in the mean pose of the chest: there it leans forward and back.
        axis = quat_rotate(quat_conjugate(stance.chest), np.array([1.0, 0.0, 0.0], np.float32))
        rotations = rotations.at[chest].set(quat_multiply(rotations[chest], quat_from_axis_angle(axis, pitch)))
    rotations = rotations.at[0].set(quat_multiply(quat_from_yaw(yaw_of(standing.facing)), rotations[0]))
    left = jnp.stack([standing.facing[1], -standing.facing[0]])
    ground, height = standing.hips + shift * left, lerp(walked.hips[1], stance.height, share)
    return Pose(hips=jnp.stack([ground[0], height, ground[1]]), rotations=rotations)


def _lowered(pose: Pose, drop: jax.Array) -> Pose:
    """Returns the pose with its hips lowered by [] metres."""
    return replace(pose, hips=pose.hips - drop * np.array([0.0, 1.0, 0.0], np.float32))


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
    foot, there = (jnp.mean(jnp.take(points, lower, axis=0), axis=0)[GROUND] for points in (feet, standing.feet))
    place, target = jnp.where(moving, foot, root), jnp.where(moving, there, state.root)
    return carry(state, angle, jnp.where(standing.stopped, target - turn(place, angle), 0.0))


def standing_point(setup: ControllerSetup, params: ControllerParams, motion: CharacterState, y: jax.Array) -> jax.Array:
    """Returns the point [2] on the ground about which a frame can be rotated without sliding the foot that stands.

    Args:
        setup, params: of a controller with command tracking.
        motion: state of the loop after the frame.
        y: [Dy] its output, in layout units.

    Returns:
        The middle of the foot with more contact, the point between both where they are equal, and the root where no
        foot is in contact.
    """
    assert setup.tracking is not None
    feet = _middles_of_feet(setup.rig, motion.joint_positions)[:, GROUND]
    contacts = jnp.mean(_predicted_contacts(setup, params, motion, y).reshape(2, 2), axis=1)
    most = jnp.max(contacts)
    stands = (contacts >= most).astype(feet.dtype)
    return jnp.where(most > setup.tracking.standing_contact, stands @ feet / jnp.sum(stands), motion.positions[ROOT])


def feet_distance(rig: Rig, joints: jax.Array) -> jax.Array:
    """Returns the distance [] in metres on the ground between the middles of both feet, of joints [J, 3]."""
    left, right = _middles_of_feet(rig, joints)[:, GROUND]
    return length(right - left)


def _middles_of_feet(rig: Rig, joints: jax.Array) -> jax.Array:
    """Returns the middles [2, 3] of both feet, left and right, of joints [J, 3]."""
    return jnp.mean(joints[np.array(rig.feet)].reshape(2, 2, 3), axis=1)


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
