"""The frame rule of Mason et al. 2022: x_i holds the pose of frame i, y_i that of frame i+1, both relative to root i.

There is no root velocity: the next root is the first predicted trajectory sample, mixed like the others with the sample
that it replaces (the authors' loop; its shares are `LoopConfig.trajectory_rate`, `phase_rate`, `pose_rate`).
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
    read_block,
    read_samples,
    trajectory_blocks,
    write_input,
)
from pfnn_jax.control.vectors import lerp, orthonormal, to_3d, unit
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.ground import to_local, to_world, turn_towards


def network_input(layout: FrameLayout, state: CharacterState) -> jax.Array:
    """Returns x_i [Dx] in layout units: trajectory and joints of this frame relative to this root."""
    root, facing = state.positions[ROOT], state.directions[ROOT]
    joints = to_local(state.joint_positions - to_3d(root)[None], facing) / layout.length_unit
    velocities = to_local(state.joint_velocities, facing) * (layout.time_unit / layout.length_unit)
    blocks = trajectory_blocks(layout, state) | {"joint_position": joints, "joint_velocity": velocities}
    for name, axes in (("joint_forward", state.joint_forward), ("joint_up", state.joint_up)):
        if axes is not None:
            blocks[name] = to_local(axes, facing)
    return write_input(layout, blocks)


def advance(
    layout: FrameLayout,
    state: CharacterState,
    y: jax.Array,
    pose_rate: float,
    trajectory_rate: float,
    phase_rate: float,
) -> CharacterState:
    """Returns the state before the next frame: joints placed; root, trajectory and gating input as predicted.

    Args:
        layout: of y.
        state: before frame i, steered.
        y: [Dy] output of frame i in layout units.
        pose_rate: share of the predicted joint positions; the rest is the pose advanced by the predicted velocity,
            which leads from frame i to i+1.
        trajectory_rate: share of the predicted trajectory samples, the next root among them; the rest is
            the samples that they replace, frame by frame, so that a little of the steering stays.
        phase_rate: share of the predicted local phases; the rest is the local phases advanced by their change.
    """
    root, facing = state.positions[ROOT], state.directions[ROOT]
    rate = layout.length_unit / layout.time_unit
    positions, directions = _mixed_future(layout, state, y, trajectory_rate)
    joints = to_world(read_block(layout, y, "joint_position", 3) * layout.length_unit, facing) + to_3d(root)[None]
    velocities = to_world(read_block(layout, y, "joint_velocity", 3) * rate, facing)
    moved = state.joint_positions + velocities / layout.fps
    axes = orthonormal(*(read_block(layout, y, name, 3) for name in ("joint_forward", "joint_up")))
    return replace(
        state,
        positions=jnp.concatenate([state.positions[1 : ROOT + 1], positions]),
        directions=jnp.concatenate([state.directions[1 : ROOT + 1], directions]),
        gait=jnp.concatenate([state.gait[1 : ROOT + 1], state.gait[ROOT:]]),
        joint_positions=lerp(moved, joints, pose_rate),
        joint_velocities=velocities,
        joint_forward=to_world(axes[0], facing),
        joint_up=to_world(axes[1], facing),
        phase=_next_phase(layout, state, y, velocities, directions[0], phase_rate),
    )


def _mixed_future(layout: FrameLayout, state: CharacterState, y: jax.Array, rate: float) -> tuple[jax.Array, jax.Array]:
    """Returns positions [51, 2] metres and unit directions [51, 2] in the world: the next root and 50 frames after."""
    root, facing = state.positions[ROOT], state.directions[ROOT]
    predicted, towards = read_samples(layout, y)
    positions = lerp(state.positions[ROOT::STRIDE], to_world(predicted, facing) + root[None], rate)
    directions = turn_towards(state.directions[ROOT::STRIDE], to_world(unit(towards), facing), rate)
    return fill_between(positions), unit(fill_between(directions))


def _next_phase(
    layout: FrameLayout, state: CharacterState, y: jax.Array, velocities: jax.Array, facing: jax.Array, rate: float
) -> jax.Array:
    """Returns the gating input of the next frame ([] phase or [G]), by the layout's kind of phase."""
    match layout.phase_kind:
        case "local":
            moved = state.phase + y[layout.output_slice("local_phase_change")]
            return lerp(moved, y[layout.output_slice("local_phase")], rate)
        case "velocity":
            return to_local(velocities[jnp.asarray(layout.ends)], facing).reshape(-1)
        case "global":
            change = read_block(layout, y, "phase_change", 1)[0, 0] * (layout.phase_unit / layout.time_unit)
            return jnp.mod(state.phase + change / layout.fps, 2.0 * jnp.pi)
