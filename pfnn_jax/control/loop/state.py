"""The state of one character in the published loop, initial states, and translation to and from a layout's blocks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.control.vectors import lerp, orthonormal, to_3d, unit
from pfnn_jax.motion.features.layout import GAITS, TRAJECTORY_OFFSETS, FrameLayout
from pfnn_jax.motion.ground import facing_of, to_local, to_world, turn

STRIDE = TRAJECTORY_OFFSETS[1] - TRAJECTORY_OFFSETS[0]
"""Frames between two trajectory samples of a network."""

ROOT = -TRAJECTORY_OFFSETS[0]
"""Index of the present among a state's trajectory points; the one before it is the previous root."""

NUM_POINTS = ROOT + TRAJECTORY_OFFSETS[-1] + 1
"""111 trajectory points, one per frame, from -60 to +50. The last predicted sample is at the last point, so that
interpolating between samples never reads beyond them."""


@struct.dataclass(kw_only=True)
class CharacterState:
    """One character before frame i is evaluated.

    Attributes:
        positions: [111, 2] metres, the ground trajectory of frames i-60 to i+50 in the world; 60 is root i.
        directions: [111, 2] unit vectors, facing.
        gait: [111, 6] weights of `pfnn_jax.motion.features.layout.GAITS`.
        joint_positions: [J, 3] metres in the world, of frame i-1, or of frame i for a next-frame layout.
        joint_velocities: [J, 3] metres per second in the world, from frame i-1 to i.
        phase: the gating input of frame i: [] radians, or [G] in layout units.
        target_velocity, target_direction: [2] the smoothed command.
        joint_forward, joint_up: [J, 3] orthonormal axes in the world, where the layout's inputs hold them, else None.
    """

    positions: jax.Array
    directions: jax.Array
    gait: jax.Array
    joint_positions: jax.Array
    joint_velocities: jax.Array
    phase: jax.Array
    target_velocity: jax.Array
    target_direction: jax.Array
    joint_forward: jax.Array | None = None
    joint_up: jax.Array | None = None


def joint_root(layout: FrameLayout) -> int:
    """Returns the index of the root that the joints of a layout's inputs are relative to: this one or the previous."""
    return ROOT if layout.next_frame else ROOT - 1


def initial_state(
    layout: FrameLayout, x: jax.Array, phase: jax.Array, position: jax.Array, yaw: jax.Array
) -> CharacterState:
    """Returns a character in the motion that a row of inputs describes.

    Args:
        layout: of the row.
        x: [Dx] layout units: a real frame, or the mean of a normaliser.
        phase: gating input: [] radians, or [G] in layout units where the layout's `phase_size` is G.
        position: [2] metres, its root in the world.
        yaw: [] radians about +Y, 0 = facing +Z.

    Returns:
        The state, whose network input is x up to the steering. In layouts without gaits it walks.
    """
    x, facing = jnp.asarray(x), facing_of(yaw)
    read = {name: x[layout.input_slice(name)] for name in layout.input_blocks}
    positions = fill_between(jnp.stack([read["trajectory_position_x"], read["trajectory_position_z"]], -1))
    directions = fill_between(jnp.stack([read["trajectory_direction_x"], read["trajectory_direction_z"]], -1))
    positions = to_world(positions * layout.length_unit, facing) + jnp.asarray(position, x.dtype)[None]
    directions = to_world(unit(directions), facing)
    walking = jnp.zeros((len(GAITS), len(TRAJECTORY_OFFSETS)), x.dtype).at[GAITS.index("walk")].set(1.0)
    index = joint_root(layout)
    before, faced = positions[index], directions[index]
    joints = read["joint_position"].reshape(-1, 3) * layout.length_unit
    velocities = read["joint_velocity"].reshape(-1, 3) * (layout.length_unit / layout.time_unit)
    return CharacterState(
        positions=positions,
        directions=directions,
        gait=fill_between(read.get("gait", walking).reshape(len(GAITS), -1).T),
        joint_positions=to_world(joints, faced) + to_3d(before)[None],
        joint_velocities=to_world(velocities, faced),
        phase=jnp.asarray(phase, x.dtype),
        target_velocity=(positions[-1] - positions[ROOT]) * (layout.fps / (NUM_POINTS - 1 - ROOT)),
        target_direction=directions[ROOT],
        **_axes(read, faced),
    )


def _axes(read: dict[str, jax.Array], faced: jax.Array) -> dict[str, jax.Array]:
    """Returns joint axes in the world, if x holds them. In a mean row they are neither unit nor perpendicular."""
    if "joint_forward" not in read:
        return {}
    forward, up = orthonormal(*(read[name].reshape(-1, 3) for name in ("joint_forward", "joint_up")))
    return {"joint_forward": to_world(forward, faced), "joint_up": to_world(up, faced)}


def straight_row(layout: FrameLayout, x: jax.Array, speed: float | jax.Array) -> jax.Array:
    """Returns x [Dx] in layout units with a trajectory straight ahead along +Z at `speed` metres per second."""
    offsets = jnp.asarray(TRAJECTORY_OFFSETS, jnp.asarray(x).dtype)
    blocks = {
        "trajectory_position_x": 0.0 * offsets,
        "trajectory_position_z": offsets * (speed / (layout.fps * layout.length_unit)),
        "trajectory_direction_x": 0.0 * offsets,
        "trajectory_direction_z": 0.0 * offsets + 1.0,
    }
    for name, block in blocks.items():
        x = jnp.asarray(x).at[layout.input_slice(name)].set(block)
    return jnp.asarray(x)


def place_state(state: CharacterState, position: jax.Array, yaw: jax.Array) -> CharacterState:
    """Moves a character as one rigid body so that its root is at `position` [2] metres, facing `yaw` []."""
    facing, position = state.directions[ROOT], jnp.asarray(position, state.positions.dtype)

    def turned(v: jax.Array) -> jax.Array:
        return to_world(to_local(v, facing), facing_of(yaw))

    moved = _moved(state, turned, position)
    target = turned(state.target_velocity), turned(state.target_direction)
    return replace(moved, target_velocity=target[0], target_direction=target[1])


def turn_state(state: CharacterState, angle: jax.Array, centre: jax.Array) -> CharacterState:
    """Rotates a character and its trajectory by an angle [] radians about a point [2] metres on the ground.

    Relative to its root nothing changes. Its targets in the world stay."""
    turned = partial(to_world, facing=facing_of(angle))
    return _moved(state, turned, centre + turned(state.positions[ROOT] - centre))


def carry_state(state: CharacterState, angle: jax.Array, shift: jax.Array) -> CharacterState:
    """Rotates a character with its targets by an angle [] radians about the origin, then shifts it by [2] metres.

    An angle and a shift of 0 leave every number as it is."""
    turned = partial(turn, angle=angle)
    return replace(
        state,
        positions=turned(state.positions) + shift[None],
        directions=turned(state.directions),
        joint_positions=turned(state.joint_positions) + to_3d(shift)[None],
        joint_velocities=turned(state.joint_velocities),
        target_velocity=turned(state.target_velocity),
        target_direction=turned(state.target_direction),
        joint_forward=None if state.joint_forward is None else turned(state.joint_forward),
        joint_up=None if state.joint_up is None else turned(state.joint_up),
    )


def _moved(state: CharacterState, turned: Callable[[jax.Array], jax.Array], to: jax.Array) -> CharacterState:
    """Rotates a character about its root and moves the root to `to` [2]; its targets stay."""
    root = state.positions[ROOT]
    return replace(
        state,
        positions=turned(state.positions - root[None]) + to[None],
        directions=turned(state.directions),
        joint_positions=turned(state.joint_positions - to_3d(root)[None]) + to_3d(to)[None],
        joint_velocities=turned(state.joint_velocities),
        joint_forward=None if state.joint_forward is None else turned(state.joint_forward),
        joint_up=None if state.joint_up is None else turned(state.joint_up),
    )


def fill_between(samples: jax.Array) -> jax.Array:
    """Interpolates samples [M, ...] ten frames apart linearly: [10 (M - 1) + 1, ...]."""
    share = np.arange(STRIDE, dtype=np.float32).reshape((1, STRIDE) + (1,) * (samples.ndim - 1)) / STRIDE
    filled = lerp(samples[:-1, None], samples[1:, None], share)
    return jnp.concatenate([filled.reshape((-1, *samples.shape[1:])), samples[-1:]])


Values = TypeVar("Values", np.ndarray, jax.Array)

TRAJECTORY = tuple(f"trajectory_{kind}_{axis}" for kind in ("position", "direction") for axis in "xz")
"""Names of the trajectory's blocks, one number per sample each."""


def read_block(layout: FrameLayout, y: jax.Array, name: str, width: int) -> jax.Array:
    """Returns a block of y [Dy] as [N, width], in layout units."""
    return y[layout.output_slice(name)].reshape(-1, width)


def read_samples(layout: FrameLayout, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns positions [6, 2] in metres and unnormalised directions [6, 2] of the trajectory samples of y [Dy]."""
    samples = jnp.stack([y[layout.output_slice(name)] for name in TRAJECTORY], -1)
    return samples[:, :2] * layout.length_unit, samples[:, 2:]


def contacts_of_output(layout: FrameLayout, y: Values) -> Values | None:
    """Returns the contacts [..., 4] in [0, 1] of outputs y [..., Dy], left heel, left toe, right heel, right toe.

    A layout with one contact per foot gives it to heel and toe. None for a layout without contacts.
    """
    if layout.has_output("contacts"):
        return y[..., layout.output_slice("contacts")].clip(0.0, 1.0)
    if layout.has_output("foot_contacts"):  # right, left
        return y[..., layout.output_slice("foot_contacts")].clip(0.0, 1.0)[..., np.array([1, 1, 0, 0])]
    return None


def trajectory_blocks(layout: FrameLayout, state: CharacterState) -> dict[str, jax.Array]:
    """Returns the trajectory's blocks of x, in layout units relative to this root."""
    root, facing = state.positions[ROOT], state.directions[ROOT]
    positions = to_local(state.positions[::STRIDE] - root[None], facing) / layout.length_unit
    directions = to_local(state.directions[::STRIDE], facing)
    return dict(zip(TRAJECTORY, (*positions.T, *directions.T), strict=True))


def write_input(layout: FrameLayout, blocks: Mapping[str, jax.Array]) -> jax.Array:
    """Returns x [Dx] of its blocks, each of any shape, whether the layout has them contiguous or interleaved."""
    columns = np.arange(layout.input_size)
    order = np.concatenate([columns[layout.input_slice(name)] for name in layout.input_blocks])
    return jnp.concatenate([blocks[name].reshape(-1) for name in layout.input_blocks])[np.argsort(order)]
