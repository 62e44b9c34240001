"""The frame rule of Holden et al. 2017 and Mason et al. 2018: x_i holds the pose of frame i-1, y_i that of frame i.

The root moves by a velocity and a yaw rate, and the predicted trajectory replaces the future one (`mason2018`,
`pfnn2017`).
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp

from pfnn_jax.control.loop.state import (
    ROOT,
    STRIDE,
    CharacterState,
    fill_between,
    joint_root,
    read_block,
    read_samples,
    trajectory_blocks,
    write_input,
)
from pfnn_jax.control.vectors import lerp, to_3d, unit
from pfnn_jax.motion.features.layout import TRAJECTORY_OFFSETS, FrameLayout
from pfnn_jax.motion.ground import to_local, to_world, turn


def network_input(layout: FrameLayout, state: CharacterState) -> jax.Array:
    """Returns x_i [Dx] in layout units: trajectory relative to this root, joints relative to the previous one."""
    before, faced = state.positions[joint_root(layout)], state.directions[joint_root(layout)]
    joints = to_local(state.joint_positions - to_3d(before)[None], faced) / layout.length_unit
    velocities = to_local(state.joint_velocities, faced) * (layout.time_unit / layout.length_unit)
    blocks = trajectory_blocks(layout, state) | {
        "gait": state.gait[::STRIDE].T,
        "joint_position": joints,
        "joint_velocity": velocities,
        # The ground is flat, and heights are relative to it.
        "terrain_height": jnp.zeros(3 * len(TRAJECTORY_OFFSETS), joints.dtype),
    }
    return write_input(layout, blocks)


def advance(layout: FrameLayout, state: CharacterState, y: jax.Array, pose_rate: float) -> CharacterState:
    """Returns the state before the next frame: joints of this frame placed; root, phase and trajectory advanced.

    Args:
        layout: of y.
        state: before frame i, steered.
        y: [Dy] output of frame i in layout units.
        pose_rate: share of the predicted joint positions; the rest is the previous pose advanced by its velocity.
    """
    root, facing = state.positions[ROOT], state.directions[ROOT]
    rate = layout.length_unit / layout.time_unit
    joints = to_world(read_block(layout, y, "joint_position", 3) * layout.length_unit, facing) + to_3d(root)[None]
    # The stored velocity leads from the previous frame to this one; the newly predicted one leads on from here.
    moved = state.joint_positions + state.joint_velocities / layout.fps
    # A standing character does not drift, and its phase slows to a tenth (demo of Holden et al. 2017).
    moving = jnp.maximum(1.0 - state.gait[ROOT, 0], 0.0) ** 0.25
    travel = to_world(read_block(layout, y, "root_velocity", 2)[0] * rate, facing)
    turning = read_block(layout, y, "root_yaw_rate", 1)[0, 0] * (layout.yaw_unit / layout.time_unit)
    change = read_block(layout, y, "phase_change", 1)[0, 0] * (layout.phase_unit / layout.time_unit)
    new_root = root + moving / layout.fps * travel
    new_facing = unit(turn(facing, moving / layout.fps * turning))
    positions, directions = _predicted_future(layout, y)
    return replace(
        state,
        positions=_shift(state.positions, new_root, to_world(positions, new_facing) + new_root[None]),
        directions=_shift(state.directions, new_facing, to_world(directions, new_facing)),
        gait=_shift(state.gait, state.gait[ROOT], state.gait[ROOT + 1 :]),
        joint_positions=lerp(moved, joints, pose_rate),
        joint_velocities=to_world(read_block(layout, y, "joint_velocity", 3) * rate, facing),
        phase=jnp.mod(state.phase + (0.9 * moving + 0.1) * change / layout.fps, 2.0 * jnp.pi),
    )


def _predicted_future(layout: FrameLayout, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns positions [50, 2] metres and directions [50, 2] of the 50 frames after the next, relative to it."""
    filled = fill_between(jnp.concatenate(read_samples(layout, y), -1))[1:]
    return filled[:, :2], unit(filled[:, 2:])


def _shift(points: jax.Array, now: jax.Array, future: jax.Array) -> jax.Array:
    return jnp.concatenate([points[1 : ROOT + 1], now[None], future])
