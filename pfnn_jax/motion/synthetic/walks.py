"""Synthesises stylised walking with exact ground truth: data that need no download.

Clips are rotations on one rigid skeleton, so that bones keep their lengths up to rounding. Feet are planted along the
path before the body is posed over them, so that they do not slide. Phase is the clock of the gait, so that it needs no
labelling. Turning and speed are inputs, so that a network can be tested on turns that its data lack.

`styles` holds the parameters of walkers; `feet` moves their feet, and `body` all other joints.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.labels.phase import PhaseLabels
from pfnn_jax.motion.synthetic.body import Wobble, pose_body
from pfnn_jax.motion.synthetic.feet import Walk, place_foot, plan_walk, stance_contacts
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.styles import PRETRAINING_STYLES, STYLES, UNSEEN_STYLE, SyntheticStyle

__all__ = [
    "PRETRAINING_STYLES",
    "STYLES",
    "UNSEEN_STYLE",
    "SyntheticStyle",
    "mixed_schedule",
    "stance_contacts",
    "synthesise",
    "synthetic_clips",
    "synthetic_skeleton",
]

FASTEST_TURN = np.deg2rad(60.0)
"""Fastest turn of `mixed_schedule` in rad/s."""


def synthesise(
    style: SyntheticStyle | str,
    turn_rate: np.ndarray,
    speed: np.ndarray,
    *,
    fps: float = 60.0,
    seed: int = 0,
    content: str = "walk",
) -> tuple[MotionClip, PhaseLabels]:
    """Synthesises a walk along a commanded path.

    The root starts at the origin facing +Z. It follows the commands exactly, and the hips move around it.

    Args:
        style: a style, or the name of one in `STYLES`.
        turn_rate: [T] rad/s about +Y, positive to the left.
        speed: [T] m/s along the facing direction; 0.4 to 1.9 looks natural.
        fps: frames per second.
        seed: of the noise and of the phase of the first frame.
        content: what the character does, stored in the clip.

    Returns:
        The clip and its exact phase, with a label on every frame.

    Raises:
        ValueError: if the style is unknown, or the schedules are not of equal length, finite and non-negative in speed.
    """
    style = _style(style)
    turn_rate, speed = _schedules(turn_rate, speed)
    rng = np.random.default_rng(seed)
    pad = int(np.ceil(2.5 * fps / (0.45 * style.cadence)))  # every visible step needs a whole one before and after it
    plan = plan_walk(style, _padded(turn_rate, pad), _padded(speed, pad), fps, rng.uniform(0, 2 * np.pi))
    plan = _from_origin(plan, pad)
    wobble = Wobble(len(plan.phase), fps, rng)
    skeleton = synthetic_skeleton()
    feet = place_foot(style, plan, True, rng), place_foot(style, plan, False, rng)
    hips, rotations = pose_body(skeleton, style, plan, feet, wobble)
    seen = slice(pad, pad + len(speed))
    clip = MotionClip(
        skeleton, fps, hips[seen], rotations[seen], style.name, content, source=f"synthetic {style.name}, seed {seed}"
    )
    return clip, _labels(plan.phase[seen])


def _style(style: SyntheticStyle | str) -> SyntheticStyle:
    if isinstance(style, SyntheticStyle):
        return style
    if style not in STYLES:
        raise ValueError(f"Unknown synthetic style {style!r}; there are {', '.join(STYLES)}.")
    return STYLES[style]


def _schedules(turn_rate: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    turn_rate, speed = np.asarray(turn_rate, float), np.asarray(speed, float)
    if turn_rate.ndim != 1 or turn_rate.shape != speed.shape or len(speed) < 2:
        raise ValueError(
            "turn_rate and speed must be equally long vectors of at least 2 frames, "
            f"got {turn_rate.shape} and {speed.shape}."
        )
    if not (np.isfinite(turn_rate).all() and np.isfinite(speed).all() and speed.min() >= 0):
        raise ValueError("turn_rate and speed must be finite, and speed not negative.")
    return turn_rate, speed


def _padded(schedule: np.ndarray, pad: int) -> np.ndarray:
    return np.pad(schedule, pad, mode="edge")


def _from_origin(plan: Walk, frame: int) -> Walk:
    """Moves a walk so that the root is at the origin and faces +Z in `frame`."""
    yaw = plan.yaw[frame]
    c, s = np.cos(yaw), np.sin(yaw)
    position = (plan.position - plan.position[frame]) @ np.array([[c, s], [-s, c]])
    return replace(plan, position=position, yaw=plan.yaw - yaw)


def _labels(phase: np.ndarray) -> PhaseLabels:
    def first_frames(cycles: np.ndarray) -> np.ndarray:
        return np.flatnonzero(np.diff(np.floor(cycles)) > 0) + 1

    cycles = phase / (2 * np.pi)
    return PhaseLabels(
        phase=np.mod(phase, 2 * np.pi),
        labelled=np.ones(len(phase), bool),
        contacts_right=first_frames(cycles),
        contacts_left=first_frames(cycles - 0.5),
    )


def mixed_schedule(
    style: SyntheticStyle | str, seconds: float, seed: int, fps: float = 60.0
) -> tuple[np.ndarray, np.ndarray]:
    """Returns schedules of a varied walk: straight, tight and wide turns to both sides, slower and faster.

    Every 1.5 to 4 s a new turn rate (0 in a third of the draws, otherwise up to 60°/s either way) and a new speed (0.7
    to 1.25 times the style's, at most 1.8 m/s) are drawn and approached smoothly.

    Returns:
        (turn_rate [T] rad/s, speed [T] m/s).
    """
    style, rng = _style(style), np.random.default_rng(seed)
    num_frames = max(2, round(seconds * fps))
    turn, speed, frames = [], [], 0
    while frames < num_frames:
        length = int(fps * rng.uniform(1.5, 4.0))
        rate = 0.0 if rng.random() < 1 / 3 else rng.uniform(-FASTEST_TURN, FASTEST_TURN)
        turn.append(np.full(length, rate))
        speed.append(np.full(length, min(style.speed * rng.uniform(0.7, 1.25), 1.8)))
        frames += length
    turn_rate, speeds = (_smooth(np.concatenate(part)[:num_frames], fps) for part in (turn, speed))
    return turn_rate, speeds


def _smooth(schedule: np.ndarray, fps: float) -> np.ndarray:
    """Averages over a raised cosine of 0.8 s: people need about a step to change speed or direction."""
    width = max(3, round(0.8 * fps) | 1)
    window = np.hanning(width + 2)[1:-1]
    return np.convolve(np.pad(schedule, width // 2, mode="edge"), window / window.sum(), mode="valid")


def synthetic_clips(
    style: SyntheticStyle | str, seconds: float, seed: int = 0, *, fps: float = 60.0, clip_seconds: float = 15.0
) -> list[LabelledClip]:
    """Synthesises pretraining clips of mixed walking, `seconds` in total and none longer than `clip_seconds`.

    The same seed gives the same clips.
    """
    num_clips = max(1, int(np.ceil(seconds / clip_seconds)))
    clips = []
    for number in range(num_clips):
        own = 7919 * seed + number  # distinct for every clip of up to 7919 per seed
        turn_rate, speed = mixed_schedule(style, seconds / num_clips, own, fps)
        clips.append(LabelledClip(*synthesise(style, turn_rate, speed, fps=fps, seed=own, content="walk-mixed")))
    return clips
