"""From a run, a style and a path to a clip of motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.ik.fix_feet import fix_feet
from pfnn_jax.control.loop.pursuit import make_timed_path
from pfnn_jax.control.loop.rollout import EvaluateFn, Frames, follow_path, rollout
from pfnn_jax.control.loop.state import CharacterState, contacts_of_output, initial_state, place_state, straight_row
from pfnn_jax.control.loop.step import LOOP_CONFIGS, Command, LoopConfig
from pfnn_jax.errors import InputError
from pfnn_jax.inference.lookup import table_phase
from pfnn_jax.inference.mixture import StyleChoice
from pfnn_jax.inference.modes import Mode
from pfnn_jax.inference.predictor import Predictor, evaluate, make_predictor
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.features.decode import clip_from_outputs, root_steps
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.motion.ground import facing_of, to_local
from pfnn_jax.motion.paths import Path
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.run import Run, list_styles, style_note


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
    style: StyleChoice,
    path: Path,
    *,
    speed: float | None = None,
    seconds: float | None = None,
    mode: Mode = "cubic",
    config: LoopConfig | None = None,
    foot_ik: bool = False,
) -> Generated:
    """Motion in a style along a path.

    Args:
        run: a loaded run.
        style: name of one of its styles; weights that sum to one by name; or None for style-agnostic motion, which on
            a FiLM run is the mean of its styles.
        path: in metres; the character starts at its first point, walking along it.
        speed: metres per second asked for; by default as `default_speed`.
        seconds: how long; by default as long as the path takes at that speed.
        mode: how the network is evaluated.
        config: constants of the controller, by default those of the run.
        foot_ik: hold feet in place while they are in contact, as the network predicts it, or where the layout has no
            contacts as the motion shows it; lay the arms of a mixture of styles along the predicted positions. The
            loop itself is not changed by it.

    Raises:
        InputError: for an unknown style or mode, a table of phases where the run has no global one,
            a speed or a time that is not above 0, or motion that is not finite.
    """
    if mode not in EVALUATORS:
        raise InputError(run.path, "mode", mode, f"must be {', '.join(EVALUATORS)}")
    if mode != "cubic" and run.layout.phase_kind != "global":
        raise InputError(run.path, "mode", mode, f"must be cubic: layout {run.layout.name} has no global phase")
    speed = default_speed(run, style) if speed is None else speed
    seconds = path.length / max(speed, 1e-6) if seconds is None else seconds
    num_frames = walk_frames(run, speed, seconds)
    evaluate_fn, params, config = EVALUATORS[mode], make_predictor(run, style), config or loop_config(run)
    state = walking_state(evaluate_fn, params, run.layout, run.normaliser, speed, config=config)
    state = place_state(state, jnp.asarray(path.points[0], jnp.float32), jnp.float32(path.start_yaw))
    frames = follow_path(
        evaluate_fn, params, run.layout, state, make_timed_path(path, speed), num_frames, config=config
    )
    clip = clip_from_frames(run.skeleton, run.layout, frames)
    if foot_ik:
        contacts = contacts_of_output(run.layout, np.asarray(frames.outputs))
        joints = np.asarray(frames.joint_positions) if isinstance(style, Mapping) else None
        clip = fix_feet(clip, contacts, joints=joints)
    return Generated(replace(clip, style=style_label(style), content="generated", source=str(run.path)), frames)


def walk_frames(run: Run, speed: float, seconds: float) -> int:
    """Frames of a walk at a speed in m/s for some seconds.

    Raises:
        InputError: unless both are above 0.
    """
    for name, value in (("speed", speed), ("seconds", seconds)):
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(run.path, name, value, "must be above 0")
    return max(round(seconds * run.layout.fps), 2)


def loop_config(run: Run) -> LoopConfig:
    """The controller's constants of a run: those of its layout, with the run's own gain of commands."""
    return replace(LOOP_CONFIGS[run.layout.name], command_gain=run.config.command_gain)


def style_label(style: StyleChoice) -> str:
    """What a clip calls its style: the name, a mixture as it is written, or `agnostic`."""
    if style is None or isinstance(style, str):
        return style or "agnostic"
    return "+".join(f"{name}:{weight:g}" for name, weight in style.items())


def default_speed(run: Run, style: StyleChoice) -> float:
    """Metres per second to ask for: the `speed` that a style's `style.json` tells of its clips.

    Of a mixture, the weighted mean of its styles. Where a style tells none, and for None, the mean of the run's data;
    for None on a FiLM run, whose data goes every way, the mean of what its styles tell.
    """
    if style is None and run.config.adapter.kind == "film":
        told = [recorded_speed(run, name) for name in run.config.styles if name in list_styles(run.path)]
        speeds = [speed for speed in told if speed is not None]
        if speeds:
            return float(np.mean(speeds))
    if isinstance(style, str):
        style = {style: 1.0}
    told = [(weight, recorded_speed(run, name)) for name, weight in (style or {}).items()]
    if told and all(speed is not None for _, speed in told):
        return sum(weight * speed for weight, speed in told if speed is not None)
    velocity, _ = root_steps(run.layout, run.normaliser.outputs.mean[None])
    return float(np.hypot(*velocity[0]))


def recorded_speed(run: Run, name: str) -> float | None:
    """Metres per second of a style's clips as its `style.json` tells them, or None."""
    speed = style_note(run.path, name)["info"].get("speed")
    usable = isinstance(speed, int | float) and math.isfinite(speed) and speed > 0.0
    return float(speed) if usable else None


def starting_row(layout: FrameLayout, normaliser: Normaliser, speed: float | jax.Array) -> tuple[jax.Array, jax.Array]:
    """A row of inputs [Dx] and a phase [] or [G] from which a walk along +Z begins: the mean of a network's inputs.

    Layouts of the next frame are trained on walks and runs to all sides: their mean stands still, so that the walk
    begins with a straight trajectory at its speed and, with local phases, with their mean.

    Args:
        layout, normaliser: of the network, in the same units.
        speed: metres per second.
    """
    x = jnp.asarray(normaliser.inputs.mean)
    x = straight_row(layout, x, speed) if layout.next_frame else x
    return x, jnp.asarray(normaliser.initial_phase())


def walking_state(
    evaluate_fn: EvaluateFn,
    params: Any,
    layout: FrameLayout,
    normaliser: Normaliser,
    speed: float | jax.Array,
    *,
    config: LoopConfig | None = None,
) -> CharacterState:
    """A character in its stride near the origin: a second of straight walking from `starting_row`.

    Args:
        evaluate_fn, params, layout, config: as for `rollout`.
        normaliser: of the network.
        speed: metres per second.
    """
    x, phase = starting_row(layout, normaliser, speed)
    state = initial_state(layout, x, phase, jnp.zeros(2, jnp.float32), jnp.zeros((), jnp.float32))
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
    y[:, layout.output_slice("joint_position")] = (
        to_local(joints, facing_of(yaw)).reshape(len(y), -1) / layout.length_unit
    )
    return clip_from_outputs(skeleton, layout, y, roots, yaw, layout.fps)
