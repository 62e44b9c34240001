"""A driven character along a path, as a clip: what `generate` does, by the controller of the page."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.controller import make_controller, step
from pfnn_jax.control.controller_state import ControllerParams, ControllerSetup, ControllerState, style_speed
from pfnn_jax.control.generation import style_label, walk_frames
from pfnn_jax.control.ik.pose import Pose
from pfnn_jax.control.loop.pursuit import TimedPath, advance_progress, make_timed_path, pursue
from pfnn_jax.errors import InputError
from pfnn_jax.inference.mixture import StyleChoice, choice_weights
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.paths import Path
from pfnn_jax.run import Run

STARTING = 1.0
"""Seconds added to those of a path: a character sets out from standing, and takes its last step to its end."""


def drive_along(
    run: Run,
    style: StyleChoice,
    path: Path,
    *,
    speed: float | None = None,
    seconds: float | None = None,
    foot_ik: bool = True,
) -> MotionClip:
    """Motion in a style along a path, kept to its speed and way (`regulation`), with feet held where they stand.

    Args:
        run: a loaded run.
        style: as for `generate`.
        path: in metres; the character stands at its first point, and at the end of an open path again.
        speed: metres per second; by default the style's own.
        seconds: how long; by default as long as the path takes at that speed, and `STARTING`.
        foot_ik: whether feet are held.

    Raises:
        InputError: for an unknown style, a speed or a time that is not above 0, or motion that is not finite.
    """
    weights = choice_weights(run, style)
    controller = make_controller(run, tuple(weights), foot_ik=foot_ik)
    row = jnp.asarray(controller.style_weights(weights or 0))
    speed = float(style_speed(controller.params, row).natural) if speed is None else speed
    seconds = path.length / max(speed, 1e-6) + STARTING if seconds is None else seconds
    num_frames = walk_frames(run, speed, seconds)
    begin = controller.start(path.points[0], path.start_yaw, controller.styles[0])
    begin = replace(begin, style=row)
    poses = follow(controller.setup, controller.params, begin, make_timed_path(path, speed), num_frames)
    hips, rotations = (np.asarray(values, np.float64) for values in (poses.hips, poses.rotations))
    if not (np.isfinite(hips).all() and np.isfinite(rotations).all()):
        raise InputError(run.path, "motion", "not finite", "the network cannot walk in this style")
    fps, label = run.layout.fps, style_label(style)
    return MotionClip(run.skeleton, fps, hips, rotations, label, "generated", source=str(run.path))


@partial(jax.jit, static_argnames=("setup", "num_frames"))
def follow(
    setup: ControllerSetup, params: ControllerParams, state: ControllerState, target: TimedPath, num_frames: int
) -> Pose:
    """Poses, leaves [T, ...], of a character that follows a target; told to stand at its end, if it has one."""

    def frame(carry, _):
        state, progress = carry
        progress = advance_progress(target, state.root, progress)
        command = pursue(target, state.motion, progress, setup.loop)
        state = step(setup, params, state, command)
        return (state, progress), state.pose

    return jax.lax.scan(frame, (state, jnp.zeros((), jnp.float32)), length=num_frames)[1]
