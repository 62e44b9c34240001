"""Parts of a long take: the frames in which somebody walks straight, and a part for every turn.

A style is learned from the former and judged on the latter. Takes of 100STYLE hold many turns and hardly a second
without one, so that the straight frames are gathered from several pieces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pfnn_jax.evaluation.actor_test import without_sway
from pfnn_jax.evaluation.turning_judge import TURNING
from pfnn_jax.motion.clip import cut
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.labels.phase import cut_phase, runs_of
from pfnn_jax.motion.trajectory import root_motion
from pfnn_jax.motion.world_motion import WorldMotion, world_motion

LEAST_PIECE = 0.5
"""Seconds of a straight piece: about half a gait cycle, so that a change from one turn into another is none."""

LEAST_SPEED = 0.8
"""Metres per second in every straight frame, and on average in a turn, so that neither learning nor judging is about
stopping, starting, and turning on the spot."""

LEAST_TURN = np.deg2rad(45.0)
"""Radians of a turn that is judged."""

MARGIN_SECONDS = 1.0
"""Seconds before and after a turn that are judged with it."""


@dataclass(frozen=True, eq=False)
class Travel:
    """How somebody moves over the ground.

    Attributes:
        rate: [T] radians per second of the facing, positive to the left.
        speed: [T] metres per second along the path without the sway of the hips.
        fps: frames per second.
    """

    rate: np.ndarray
    speed: np.ndarray
    fps: float


def travel_of(labelled: LabelledClip) -> Travel:
    """Returns how the body of a clip moves over the ground."""
    world = world_motion(labelled.world or labelled.clip)
    root = root_motion(world.positions, world.roles, world.fps)
    velocity = np.gradient(without_sway(root.positions, world.fps), axis=0) * world.fps
    rate = np.gradient(np.unwrap(root.yaw)) * world.fps
    return Travel(rate, np.linalg.norm(velocity, axis=-1), world.fps)


def straight_frames(travel: Travel, seconds: float) -> np.ndarray:
    """Returns the first frames [N] in which a body walks straight, of pieces of at least `LEAST_PIECE`.

    The facing turns slower than `TURNING`, beyond which the judge counts a frame as turning.

    Args:
        travel: of a take.
        seconds: of frames wanted; a take may have fewer.
    """
    straight = (np.abs(travel.rate) < TURNING) & (travel.speed > LEAST_SPEED)
    least = round(LEAST_PIECE * travel.fps)
    pieces = [np.arange(*run) for run in runs_of(straight) if run[1] - run[0] >= least]
    return np.concatenate([np.zeros(0, int), *pieces])[: round(seconds * travel.fps)]


def turns_of(travel: Travel, learned: np.ndarray) -> list[tuple[int, int]]:
    """Returns a part for every turn to one side by `LEAST_TURN` or more: its first frame, and the one after its last.

    `MARGIN_SECONDS` before and after a turn belong to its part, as far as they were not learned.

    Args:
        travel: of a take.
        learned: frames that no part may contain. Turns that contain one have no part.
    """
    free = np.ones(len(travel.rate), bool)
    free[learned] = False
    parts = []
    for side in (1, -1):
        for start, stop in runs_of(side * travel.rate > TURNING):
            turned = np.abs(travel.rate[start:stop].sum()) / travel.fps
            walked = travel.speed[start:stop].mean() >= LEAST_SPEED
            if turned >= LEAST_TURN and walked and free[start:stop].all():
                parts.append(_with_margins(start, stop, free, round(MARGIN_SECONDS * travel.fps)))
    return sorted(parts)


def _with_margins(start: int, stop: int, free: np.ndarray, margin: int) -> tuple[int, int]:
    before = np.flatnonzero(~free[max(start - margin, 0) : start])
    after = np.flatnonzero(~free[stop : stop + margin])
    first = max(start - margin, 0) + (before[-1] + 1 if len(before) else 0)
    last = stop + after[0] if len(after) else min(stop + margin, len(free))
    return int(first), int(last)


def cut_labelled(labelled: LabelledClip, start: int, stop: int) -> LabelledClip:
    """Returns the frames from `start` to before `stop` of a labelled clip, with their labels."""
    whole = world_motion(labelled.world or labelled.clip)
    part = slice(start, stop)
    clip = cut(whole.clip, start, stop)
    world = WorldMotion(clip, whole.positions[part], whole.rotations[part])
    gait = None if labelled.gait is None else labelled.gait[part]
    return replace(labelled, clip=clip, world=world, labels=cut_phase(labelled.labels, start, stop), gait=gait)


def cut_parts(labelled: LabelledClip, parts: Sequence[tuple[int, int]]) -> list[LabelledClip]:
    """Returns the parts of a labelled clip, each with its place in seconds in the name of its source."""
    found = []
    for start, stop in parts:
        part = cut_labelled(labelled, start, stop)
        source = f"{labelled.clip.source} at {start / labelled.clip.fps:.1f} s"
        found.append(replace(part, clip=replace(part.clip, source=source)))
    return found
