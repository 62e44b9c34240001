"""Decides what is assumed about a motion file, in one place: unit, up axis, jumps, travel.

What the user says (`ReadOptions`) comes first, then what the motion shows. Each decision that may be wrong, and each
repair, is noted in the clip's `Reading`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.humanoid.map import HumanoidMap
from pfnn_jax.motion.jumps import check_speed, longest_part
from pfnn_jax.motion.length_unit import POSSIBLE_LEG, USUAL_LEG, guess_unit, unit_name
from pfnn_jax.motion.reading import Axis, ReadOptions
from pfnn_jax.motion.retargeting.resting import with_resting_heights
from pfnn_jax.motion.travel import rebuild_travel, walks_on_the_spot
from pfnn_jax.motion.up_axis import find_up

USUAL_FPS = (10.0, 500.0)
"""Frames per second outside of which a file's rate is doubtful: 0.333333 s for a frame is a common slip."""


def decide_unit(leg: float, is_leg: bool, options: ReadOptions, path: str | Path) -> tuple[float, str]:
    """Returns the metres per unit of a file, and a note if that is doubtful.

    Args:
        leg: from hip to ankle, in the file's unit.
        is_leg: whether that is a leg, and not an estimate for a skeleton without known legs.
        options: what the user says.
        path: of the file, for messages.

    Raises:
        InputError: if no person has such legs.
    """
    unit, note = guess_unit(leg) if options.metres is None else (options.metres, "")
    metres = leg * unit
    if not is_leg or metres == 0:
        return unit, note
    if not POSSIBLE_LEG[0] <= metres <= POSSIBLE_LEG[1]:
        rule = f"legs must be {POSSIBLE_LEG[0]:g} to {POSSIBLE_LEG[1]:g} m long: give the unit with `--unit`"
        raise InputError(path, "unit", f"{unit_name(unit)}, legs of {metres:.3g} m", rule)
    if not USUAL_LEG[0] <= metres <= USUAL_LEG[1] and not note:
        note = f"legs of {metres:.2f} m with unit {unit_name(unit)}: pass `--unit` if that is wrong"
    return unit, note


def doubt_rate(fps: float, options: ReadOptions) -> str:
    """Returns a note if a file's frame rate is one that motion is hardly recorded at; empty if it is given.

    Args:
        fps: frames per second.
        options: what the user says.
    """
    if options.source_fps is not None or USUAL_FPS[0] <= fps <= USUAL_FPS[1]:
        return ""
    return f"`Frame Time` means {fps:.4g} frames per second: pass `--source-fps` if that is wrong"


def decide_up(positions: np.ndarray, humanoid: HumanoidMap | None, options: ReadOptions) -> tuple[Axis, str]:
    """Returns the axis of a file that points up, and a note unless the body stands along Y.

    Args:
        positions: [N, J, 3] joint positions of some poses in any unit.
        humanoid: None if it was not found: Y is then taken.
        options: what the user says.
    """
    if options.up != "auto":
        return options.up, ""
    if humanoid is None:
        return "y", ""
    up, stands = find_up(positions, humanoid)
    if not stands:
        return up, "the body stands along no axis; up is taken to be y: pass `--up` if that is wrong"
    note = f"the body stands along {up} and is turned so that y points up: pass `--up y` if that is wrong"
    return up, "" if up == "y" else note


def repair(clip: MotionClip, options: ReadOptions) -> MotionClip:
    """Cuts jumps to other poses or places, rebuilds travel that is lacking, and measures the feet's resting heights.

    Of a clip that jumps the longest part is kept. Clips whose skeleton has no roles are returned unchanged.

    Args:
        clip: as read, with its `reading`.
        options: what the user says.

    Raises:
        InputError: if the body moves faster than any person.
    """
    if clip.skeleton.roles is None or clip.reading is None:
        return clip
    start, stop, note = longest_part(clip)
    if note and Path(clip.source).with_suffix(".phase").is_file():  # it labels all frames of the file
        clip = replace(
            clip, reading=clip.reading.noting(f"{note.split(':')[0]}: kept, as a .phase file labels the clip")
        )
    elif note:
        clip = cut(replace(clip, reading=clip.reading.noting(note)), start, stop)
    if (note := check_speed(clip)) and clip.reading is not None:
        clip = replace(clip, reading=clip.reading.noting(note))
    if options.travel == "rebuild" or (options.travel == "auto" and walks_on_the_spot(clip)):
        clip, note = rebuild_travel(clip)
        assert clip.reading is not None
        clip = replace(clip, reading=clip.reading.noting(note))
    return with_resting_heights(clip)
