"""From a run, a style and a path to a clip of motion."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.features import clip_from_outputs
from pfnn_jax.motion.layout import FrameLayout
from pfnn_jax.motion.normaliser import Normaliser
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.trajectory import to_local
from pfnn_jax.runtime.controller import Command, ControllerConfig
from pfnn_jax.runtime.lookup import table_phase
from pfnn_jax.runtime.paths import Path
from pfnn_jax.runtime.predictor import Predictor, evaluate, make_predictor
from pfnn_jax.runtime.rollout import EvaluateFn, Frames, follow_path, make_track, rollout
from pfnn_jax.runtime.state import CharacterState, initial_state, place_state
from pfnn_jax.training.run import Run, style_note

Mode = Literal["cubic", "nearest50", "constant50"]
"""The exact spline, or a table of 50 slices read at the nearest one, or truncated as the published demo does."""


def _nearest50(predictor: Predictor, x: jax.Array, phase: jax.Array) -> jax.Array:
    return evaluate(predictor, x, table_phase(phase, "nearest50"))


def _constant50(predictor: Predictor, x: jax.Array, phase: jax.Array) -> jax.Array:
    return evaluate(predictor, x, table_phase(phase, "constant50"))


EVALUATORS: dict[Mode, EvaluateFn] = {"cubic": evaluate, "nearest50": _nearest50, "constant50": _constant50}
"""How `rollout` and `follow_path` evaluate a `Predictor` in each mode. A scan needs no table: it blends the network at
the table's phase, which is the same to rounding and gathers nothing."""

RUN_IN_FRAMES = 60
"""Frames of straight walking before a path begins: the mean pose is no pose, and takes a few steps to become one."""


@dataclass(frozen=True, eq=False)
class Generated:
    """A clip and the rollout that it was made from.

    Attributes:
        clip: rigid bones, joint rotations from the network; write it with `pfnn_jax.motion.bvh.write_bvh`.
        frames: outputs, roots, phase, and the joint positions that the network itself predicted.
    """

    clip: MotionClip
    frames: Frames


def generate(
    run: Run,
    style: str | None,
    path: Path,
    *,
    speed: float | None = None,
    seconds: float | None = None,
    mode: Mode = "cubic",
    config: ControllerConfig | None = None,
) -> Generated:
    """Motion in a style along a path.

    Args:
        run: a loaded run.
        style: name of one of its styles, or None for style-agnostic motion.
        path: in metres; the character starts at its first point, walking along it.
        speed: metres per second asked for; by default that of the style's own clip, where its `style.json` tells it,
            else the mean of the run's data.
        seconds: how long; by default as long as the path takes at that speed.
        mode: how the network is evaluated.
        config: constants of the controller, by default those of the run's layout.

    Raises:
        InputError: for an unknown style or mode, a speed or a time that is not above 0, or motion that is not finite.
    """
    if mode not in EVALUATORS:
        raise InputError(run.path, "mode", mode, f"must be {', '.join(EVALUATORS)}")
    speed = default_speed(run, style) if speed is None else speed
    seconds = path.length / max(speed, 1e-6) if seconds is None else seconds
    for name, value in (("speed", speed), ("seconds", seconds)):
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(run.path, name, value, "must be above 0")
    evaluate_fn, params = EVALUATORS[mode], make_predictor(run, style)
    num_frames = max(round(seconds * run.layout.fps), 2)
    state = walking_state(evaluate_fn, params, run.layout, run.normaliser, speed, config=config)
    state = place_state(state, jnp.asarray(path.points[0], jnp.float32), jnp.float32(path.start_yaw))
    frames = follow_path(evaluate_fn, params, run.layout, state, make_track(path, speed), num_frames, config=config)
    clip = clip_from_frames(run.skeleton, run.layout, frames)
    return Generated(replace(clip, style=style or "agnostic", content="generated", source=str(run.path)), frames)


def default_speed(run: Run, style: str | None) -> float:
    """Metres per second: the `speed` that a style's `style.json` tells of its clip, else the mean of the run's data."""
    if style is not None:
        speed = style_note(run.path, style)["info"].get("speed")
        if isinstance(speed, int | float) and math.isfinite(speed) and speed > 0.0:
            return float(speed)
    layout = run.layout
    velocity = run.normaliser.outputs.mean[layout.output_slice("root_velocity")]
    return float(np.hypot(*velocity)) * layout.length_unit / layout.time_unit


def walking_state(
    evaluate_fn: EvaluateFn,
    params: Any,
    layout: FrameLayout,
    normaliser: Normaliser,
    speed: float | jax.Array,
    *,
    config: ControllerConfig | None = None,
) -> CharacterState:
    """A character in its stride near the origin: a second of straight walking from the mean of a network's inputs.

    Args:
        evaluate_fn, params, layout, config: as for `rollout`.
        normaliser: of the network.
        speed: metres per second.
    """
    zero = jnp.zeros((), jnp.float32)
    state = initial_state(layout, jnp.asarray(normaliser.inputs.mean), zero, jnp.zeros(2, jnp.float32), zero)
    ahead = jnp.tile(jnp.asarray([[0.0, 1.0]], jnp.float32), (RUN_IN_FRAMES, 1))
    return rollout(
        evaluate_fn, params, layout, state, Command(velocity=speed * ahead, direction=ahead), config=config
    ).state


def clip_from_frames(skeleton: Skeleton, layout: FrameLayout, frames: Frames) -> MotionClip:
    """The clip of one character's frames: predicted rotations, hips where the blended pose has them.

    Raises:
        InputError: if a value is not finite, or the skeleton is not of the layout.
    """
    y, yaw = np.array(frames.outputs, np.float64), np.asarray(frames.root_yaw, np.float64)
    roots, joints = np.asarray(frames.root_positions, np.float64), np.array(frames.joint_positions, np.float64)
    joints[..., [0, 2]] -= roots[:, None]
    y[:, layout.output_slice("joint_position")] = to_local(yaw, joints).reshape(len(y), -1) / layout.length_unit
    return clip_from_outputs(skeleton, layout, y, roots, yaw, layout.fps)
