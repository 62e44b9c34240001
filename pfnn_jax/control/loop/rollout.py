"""Rollouts of many frames: a character under commands or along a path, and a pose fed back with all else true.

Everything here is one `lax.scan`, compiled once per network function, layout and length. A batch of characters is a
`vmap`; so is a batch of styles, with the shared network left unbatched:

    def walk(style):
        return follow_path(evaluate, predictor.replace(style=style), layout, state, path, 600)

    frames = jax.vmap(walk)(bank)
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.control.loop.pursuit import TimedPath, advance_progress, point_at, pursue
from pfnn_jax.control.loop.state import ROOT, CharacterState
from pfnn_jax.control.loop.step import LOOP_CONFIGS, Command, LoopConfig, published_step
from pfnn_jax.control.vectors import to_3d, unit
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.ground import to_world, wrap_angle, yaw_of

EvaluateFn = Callable[[Any, jax.Array, jax.Array], jax.Array]
"""(params, x [Dx], phase [] or [G]) -> y [Dy] in layout units, as `evaluate` and `evaluate_lookup`."""


@struct.dataclass(kw_only=True)
class Frames:
    """The frames of a rollout.

    Attributes:
        outputs: [T, Dy] the network's outputs in layout units, of frame i relative to root i.
        root_positions: [T, 2] metres, root i.
        root_yaw: [T] radians about +Y, 0 = facing +Z.
        phase: [T] radians, or [T, G] in layout units, at which frame i was evaluated.
        joint_positions: [T, J, 3] metres in the world, blended with the previous pose: of frame i, or of frame i+1
            where the layout is of the next frame (as the outputs are).
        state: of the character after the last frame, to continue from; None where frames were cut from longer ones.
        progress: [T] metres along the followed path, never decreasing, or None.
        path_distance: [T] metres from the root to the path there, or None.
    """

    outputs: jax.Array
    root_positions: jax.Array
    root_yaw: jax.Array
    phase: jax.Array
    joint_positions: jax.Array
    state: CharacterState | None
    progress: jax.Array | None = None
    path_distance: jax.Array | None = None


@struct.dataclass(kw_only=True)
class Stability:
    """Statistics of a rollout by which networks are compared; infinite where the rollout diverges.

    Attributes:
        finite: [] bool.
        pose_distance: [] mean over frames of the mean squared normalised distance of the joint positions from the
            mean pose; about 1 or less for the data.
        pose_peak: [] the largest of these over the frames.
        speed: [] metres per second, mean along the ground.
        turn_rate: [] radians per second about +Y, mean.
        trajectory_error: [] metres, mean distance to the path, or None without one.
    """

    finite: jax.Array
    pose_distance: jax.Array
    pose_peak: jax.Array
    speed: jax.Array
    turn_rate: jax.Array
    trajectory_error: jax.Array | None = None


def warm_up(
    step: Callable[[CharacterState, Command], tuple[CharacterState, jax.Array]],
    state: CharacterState,
    command: Command,
    num_frames: int,
) -> tuple[CharacterState, jax.Array]:
    """Runs a character under one command, so that an initial pose that the data never shows becomes a gait.

    Args:
        step: one frame, (state, command) -> (state, y [Dy]), as `published_step`.
        state: initial state.
        command: of every frame.
        num_frames: T.

    Returns:
        The states, leaves [T, ...], and the outputs [T, Dy] of all frames.
    """

    def frame(state: CharacterState, _):
        after, y = step(state, command)
        return after, (after, y)

    return jax.lax.scan(frame, state, length=num_frames)[1]


@partial(jax.jit, static_argnames=("evaluate_fn", "layout", "config"))
def rollout(
    evaluate_fn: EvaluateFn,
    params: Any,
    layout: FrameLayout,
    state: CharacterState,
    commands: Command,
    *,
    config: LoopConfig | None = None,
) -> Frames:
    """Runs a character under one command per frame.

    Args:
        evaluate_fn: (params, x [Dx], phase []) -> y [Dy] in layout units; pass the same function object at every call.
        params: its parameters, as a `Predictor`.
        layout: of x and y.
        state: initial state.
        commands: with a leading axis T: velocity [T, 2] metres per second and direction [T, 2], in the world.
        config: by default the published constants of the layout.
    """

    def frame(state: CharacterState, command: Command):
        after, y = published_step(partial(evaluate_fn, params), layout, state, command, config)
        return after, (y, state.phase, _placed(after))

    final, (outputs, phase, placed) = jax.lax.scan(frame, state, commands)
    return Frames(outputs=outputs, phase=phase, state=final, **placed)


@partial(jax.jit, static_argnames=("evaluate_fn", "layout", "num_frames", "config"))
def follow_path(
    evaluate_fn: EvaluateFn,
    params: Any,
    layout: FrameLayout,
    state: CharacterState,
    path: TimedPath,
    num_frames: int,
    progress: jax.Array | float = 0.0,
    *,
    config: LoopConfig | None = None,
) -> Frames:
    """Runs a character along a path: at every frame it heads for the point `look_ahead` seconds further on.

    Args:
        evaluate_fn, params, layout, state, config: as for `rollout`.
        path: the path and its speed. At the end of an open path the character is commanded to stop.
        num_frames: T.
        progress: [] metres along the path at the first frame: where earlier frames have ended.
    """
    constants = config or LOOP_CONFIGS[layout.name]

    def frame(carry, _):
        state, progress = carry
        root = state.positions[ROOT]
        progress = advance_progress(path, root, progress)
        command = pursue(path, state, progress, constants)
        after, y = published_step(partial(evaluate_fn, params), layout, state, command, constants)
        distance = jnp.linalg.norm(root - point_at(path, progress))
        return (after, progress), (y, state.phase, _placed(after), progress, distance)

    start = (state, jnp.asarray(progress, state.positions.dtype))
    (final, _), (outputs, phase, placed, progress, distance) = jax.lax.scan(frame, start, length=num_frames)
    return Frames(outputs=outputs, phase=phase, state=final, progress=progress, path_distance=distance, **placed)


@partial(jax.jit, static_argnames=("evaluate_fn", "layout"))
def locked_rollout(
    evaluate_fn: EvaluateFn, params: Any, layout: FrameLayout, x: jax.Array, phase: jax.Array
) -> jax.Array:
    """Returns the outputs when only the pose is fed back, and root, trajectory and phase are true.

    The error is that of the pose alone: drift of the root neither adds to it nor compensates it.

    Args:
        evaluate_fn, params, layout: as for `rollout`.
        x: [T, Dx] true inputs of consecutive frames, in layout units; the rollout starts from the pose of the first.
        phase: [T] radians, or [T, G] in layout units, true.

    Returns:
        [T, Dy] outputs in layout units. The joints of one are those of the next input, without blending; for a
        next-frame layout they are moved from root i into the true root i+1.
    """
    blocks = tuple(name for name in layout.input_blocks if name.startswith("joint_"))
    # The last row has no successor, and the pose after it is not used.
    following = jnp.concatenate([x[1:], x[-1:]])

    def frame(pose, row):
        x, after, phase = row
        for name, block in pose.items():
            x = x.at[layout.input_slice(name)].set(block)
        y = evaluate_fn(params, x, phase)
        pose = {name: y[layout.output_slice(name)] for name in blocks}
        return (_into_next_root(layout, pose, row[0], after) if layout.next_frame else pose), y

    start = {name: x[0, layout.input_slice(name)] for name in blocks}
    return jax.lax.scan(frame, start, (x, following, phase))[1]


def _into_next_root(layout: FrameLayout, pose: dict[str, jax.Array], x: jax.Array, after: jax.Array):
    """Moves a pose from root i to root i+1, by the true inputs of the two frames.

    Inputs do not hold the step of the root. The velocities of frame i+1 lead back to the pose of frame i, which is thus
    known relative to both roots; the rigid motion between the two is the step.
    """

    def ground(row: jax.Array, name: str) -> jax.Array:
        return row[layout.input_slice(name)].reshape(-1, 3)[:, jnp.asarray([0, 2])]

    here = ground(x, "joint_position")
    there = ground(after, "joint_position") - ground(after, "joint_velocity") / (layout.fps * layout.time_unit)
    middles = jnp.mean(here, axis=0), jnp.mean(there, axis=0)
    a, b = here - middles[0][None], there - middles[1][None]
    turned = unit(jnp.stack([jnp.sum(a[:, 1] * b[:, 0] - a[:, 0] * b[:, 1]), jnp.sum(a * b)]))
    shift = middles[1] - to_world(middles[0], turned)
    moved = {name: to_world(block.reshape(-1, 3), turned) for name, block in pose.items()}
    moved["joint_position"] = moved["joint_position"] + to_3d(shift)[None]
    return {name: block.reshape(-1) for name, block in moved.items()}


def stability(
    layout: FrameLayout, frames: Frames, output_mean: jax.Array, output_std: jax.Array, *, skip: int = 60
) -> Stability:
    """Returns the statistics of a rollout by which settings are chosen.

    Args:
        layout: of the outputs.
        frames: of one character.
        output_mean, output_std: [Dy] of the normaliser, in layout units.
        skip: number of initial frames that are left out.
    """
    pose = layout.output_slice("joint_position")
    normalised = (frames.outputs[:, pose] - output_mean[None, pose]) / output_std[None, pose]
    distance = jnp.mean(normalised**2, axis=1)[skip:]
    finite = jnp.isfinite(frames.outputs).all() & jnp.isfinite(frames.joint_positions).all()
    finite = finite & jnp.isfinite(frames.root_positions).all() & jnp.isfinite(frames.root_yaw).all()
    steps = jnp.linalg.norm(jnp.diff(frames.root_positions[skip:], axis=0), axis=1)
    turns = jnp.diff(frames.root_yaw[skip:])
    turns = wrap_angle(turns)

    def sound(value: jax.Array) -> jax.Array:
        return jnp.where(finite, value, jnp.inf)

    error = None if frames.path_distance is None else sound(jnp.mean(frames.path_distance[skip:]))
    return Stability(
        finite=finite,
        pose_distance=sound(jnp.mean(distance)),
        pose_peak=sound(jnp.max(distance)),
        speed=sound(jnp.mean(steps) * layout.fps),
        turn_rate=sound(jnp.mean(turns) * layout.fps),
        trajectory_error=error,
    )


def _placed(after: CharacterState) -> dict[str, jax.Array]:
    """Returns root and joints of the frame that a step has placed."""
    return {
        "root_positions": after.positions[ROOT - 1],
        "root_yaw": yaw_of(after.directions[ROOT - 1]),
        "joint_positions": after.joint_positions,
    }
