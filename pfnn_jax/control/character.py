"""The record of a character that is driven: what it knows of itself between two frames, and the body that is drawn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.control.embodiment import mix_rotations, predicted_contacts, predicted_rotations, turn_rotations
from pfnn_jax.control.ground import mix, turn_towards
from pfnn_jax.control.ik.foot_lock import FootLockConfig, FootLocks, lock_feet
from pfnn_jax.control.ik.limb import reach_arms
from pfnn_jax.control.ik.pose import Pose, Rig, forward_kinematics, pose_from_world
from pfnn_jax.control.loop.state import CharacterState, joint_root
from pfnn_jax.control.loop.step import Command, ControllerConfig, published_step
from pfnn_jax.control.tracking import LEAST_SPEED, Regulated, Regulation, hold_back
from pfnn_jax.inference.predictor import Predictor, evaluate
from pfnn_jax.models.adapters import OneHot
from pfnn_jax.models.film import FiLMStyle
from pfnn_jax.models.film import mix as mix_parameters
from pfnn_jax.models.layers import MixedLayer
from pfnn_jax.motion.features.layout import FrameLayout


@struct.dataclass(kw_only=True)
class ControllerParams:
    """The arrays of a controller.

    Attributes:
        predictor: network and statistics, without a style.
        bank: C styles, leaves [C, ...]; rows beyond the named ones are zeros. None where the run has no styles.
        speeds: [C] m/s, the styles' own; 0 where it is not known.
        speed: [] m/s, of a style that tells none.
        shares: [C] of its own speed to ask of the network, so that it walks at that speed (`standing.find_walks`).
        row: [Dx] the row of inputs, in layout units, from which a character sets out.
        phase: [] radians or [G]: at that row.
        rest: [4] metres, height of left heel, left toe, right heel, right toe on the ground.
    """

    predictor: Predictor
    bank: Any
    speeds: jax.Array
    speed: jax.Array
    shares: jax.Array
    row: jax.Array
    phase: jax.Array
    rest: jax.Array


@dataclass(frozen=True)
class ControllerSetup:
    """What a controller is compiled for.

    Attributes:
        layout: of the network's rows.
        config: constants of the published loop.
        rig: of the body.
        feet: when feet are held on the ground, or None for a body as the network predicts it.
        regulation: how strictly commands are kept, or None for the published loop alone.
    """

    layout: FrameLayout
    config: ControllerConfig
    rig: Rig
    feet: FootLockConfig | None
    regulation: Regulation | None


@struct.dataclass(kw_only=True)
class Still:
    """One predicted frame.

    Attributes:
        root, facing: [2] metres, and a unit vector, of the root that the joints belong to.
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
    """One character between two frames.

    Attributes:
        motion: what the network reads and writes, after the frame `ahead`.
        behind, ahead: the two predicted frames between which the character is.
        clock: [] in (0, 1], how far it has come from the one to the other.
        style: [C] weights, on their way to the commanded ones.
        regulated: pace, and what else regulation remembers.
        root, facing: [2] metres on the ground, and the unit vector that it faces.
        contacts: [4] in [0, 1]: left heel, left toe, right heel, right toe.
        feet: what holds them.
        pose: the body as it is drawn, with rigid bones.
        joints, world_rotations: [J, 3] metres and [J, 4], of the pose in the world.
    """

    motion: CharacterState
    behind: Still
    ahead: Still
    clock: jax.Array
    style: jax.Array
    regulated: Regulated
    root: jax.Array
    facing: jax.Array
    contacts: jax.Array
    feet: FootLocks
    pose: Pose
    joints: jax.Array
    world_rotations: jax.Array

    @property
    def pace(self) -> jax.Array:
        """[] its own seconds for each second of the world."""
        return self.regulated.pace


def mixed_style(bank: Any, weights: jax.Array) -> Any:
    """The weighted sum of what C styles add: Films and one-hot shifts by parameters, residuals by their outputs."""
    if bank is None:
        return None
    if isinstance(bank, FiLMStyle | OneHot):
        return mix_parameters(bank, weights)
    return MixedLayer(layers=bank, weights=weights)


def own_speed(params: ControllerParams, style: jax.Array) -> jax.Array:
    """[] m/s at which a mixture of styles walks by itself; weights may be negative, its speed may not."""
    return jnp.maximum(jnp.dot(style, _speeds(params)), LEAST_SPEED)


def own_share(params: ControllerParams, style: jax.Array) -> jax.Array:
    """[] share of its own speed to ask of the network for a mixture of styles: of what each is asked for, the mean."""
    asked = jnp.dot(style, params.shares * _speeds(params))
    return jnp.maximum(asked, 0.0) / own_speed(params, style)


def _speeds(params: ControllerParams) -> jax.Array:
    return jnp.where(params.speeds > 0.0, params.speeds, params.speed)


def frame_ahead(
    setup: ControllerSetup, predictor: Predictor, own: jax.Array, state: CharacterState, command: Command
) -> tuple[CharacterState, jax.Array]:
    """One frame of the published loop, held back to what a style allows that walks at `own` [] m/s: as
    `frame.published_step`."""
    if setup.regulation is not None:
        state = hold_back(state, own, setup.layout.fps, setup.regulation)
    return published_step(partial(evaluate, predictor), setup.layout, state, command, setup.config)


def still_frame(
    setup: ControllerSetup,
    params: ControllerParams,
    motion: CharacterState,
    y: jax.Array,
    facing: jax.Array,
    angle: jax.Array,
) -> Still:
    """The frame of y [Dy], predicted for a root facing [2]; the character has been turned by an angle [] since."""
    index = joint_root(setup.layout)
    return Still(
        root=motion.positions[index],
        facing=motion.directions[index],
        joints=motion.joint_positions,
        rotations=turn_rotations(predicted_rotations(setup.layout, y, facing), angle),
        contacts=predicted_contacts(setup.layout, y, motion, setup.rig, params.rest),
    )


def drawn(setup: ControllerSetup, state: ControllerState) -> ControllerState:
    """The state with the body of its moment between two frames."""
    behind, ahead, share = state.behind, state.ahead, state.clock
    predicted = mix(behind.joints, ahead.joints, share)
    contacts = mix(behind.contacts, ahead.contacts, share)
    pose = pose_from_world(setup.rig, predicted[0], mix_rotations(behind.rotations, ahead.rotations, share))
    feet = state.feet
    if setup.feet is not None:
        # A foot that stands stays where it is while the character does, whatever its network says of it.
        held = jnp.where(state.regulated.pace > 0.0, contacts, jnp.where(feet.held, 1.0, contacts))
        pose, feet = lock_feet(setup.rig, reach_arms(setup.rig, pose, predicted), held, feet, setup.feet)
    joints, world = forward_kinematics(setup.rig, pose)
    return replace(
        state,
        root=mix(behind.root, ahead.root, share),
        facing=turn_towards(behind.facing, ahead.facing, share),
        contacts=contacts,
        feet=feet,
        pose=pose,
        joints=joints,
        world_rotations=world,
    )
