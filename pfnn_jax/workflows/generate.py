"""Motion of a run along a path: the run and style by name, the work by `pfnn_jax.control.generation`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path as FilePath

from pfnn_jax.control.controller import make_controller
from pfnn_jax.control.generation import GeneratedWalk, as_path, fix_walk, loop_path, track_path
from pfnn_jax.control.run_settings import default_speed, loop_config, style_label
from pfnn_jax.errors import InputError
from pfnn_jax.inference.mixture import choice_weights
from pfnn_jax.inference.modes import Mode
from pfnn_jax.inference.predictor import make_predictor
from pfnn_jax.inference.style_choice import StyleChoice, parse_style
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.paths import Path
from pfnn_jax.run import Run
from pfnn_jax.run_config import list_styles
from pfnn_jax.workflows.runs import as_run


def generate_clip(
    run: Run | str | FilePath,
    style: StyleChoice,
    path: Path | str | FilePath,
    *,
    speed: float | None = None,
    seconds: float | None = None,
    foot_ik: bool = True,
    published_loop: bool = False,
    mode: Mode = "cubic",
) -> MotionClip:
    """Returns motion in a style of a run along a path.

    By default the character tracks the path (`pfnn_jax.control.tracking`): it starts standing, keeps to the path and
    the speed, and stops at the end of an open path.

    Args:
        run: a run, or its directory.
        style: name of one of its styles; a mixture by name and weight, or as `A:0.5+B:0.5`; or None for style-agnostic
            motion, which for a FiLM run is the mean of its styles.
        path: a path in metres, the name of a shape (`straight`, `circle`, `figure-eight`), or a CSV file of points.
        speed: metres per second; by default the natural speed of the style.
        seconds: duration; by default as long as the path takes at that speed.
        foot_ik: lock feet that are in contact; for a mixture of styles also lay arms along the predicted positions.
        published_loop: leave speed and heading to the network, as the published demos do.
        mode: how the network is evaluated; other than `cubic` only by the published loop.

    Raises:
        InputError: for a run, style or path that does not exist, a mode that does not fit, a speed or duration that is
            not positive, or motion that is not finite.
    """
    settings = {"speed": speed, "seconds": seconds, "foot_ik": foot_ik}
    return generate_walk(run, style, path, **settings, published_loop=published_loop, mode=mode).clip


def generate_walk(
    run: Run | str | FilePath,
    style: StyleChoice,
    path: Path | str | FilePath,
    *,
    speed: float | None = None,
    seconds: float | None = None,
    foot_ik: bool = True,
    published_loop: bool = False,
    mode: Mode = "cubic",
) -> GeneratedWalk:
    """Returns the clip of `generate_clip` with its phases, contacts and predicted joints; arguments as there."""
    run, path = as_run(run), as_path(path)
    if isinstance(style, str):
        style = parse_style(style, list_styles(run.path), run.path)
    if published_loop:
        speed, predictor = default_speed(run, style) if speed is None else speed, make_predictor(run, style)
        walk = loop_path(predictor, path, run, speed=speed, seconds=seconds, mode=mode, loop=loop_config(run))
        walk = fix_walk(walk, arms=isinstance(style, Mapping)) if foot_ik else walk
    else:
        if mode != "cubic":
            raise InputError(run.path, "mode", mode, "must be cubic unless published_loop=True")
        weights = choice_weights(run, style)
        controller = make_controller(run, tuple(weights), foot_ik=foot_ik)
        walk = track_path(controller, controller.style_weights(weights or 0), path, run, speed=speed, seconds=seconds)
    return replace(walk, clip=replace(walk.clip, style=style_label(style)))
