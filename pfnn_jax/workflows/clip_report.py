"""What may be wrong with a clip and with the style learned from it, as warnings of one line each.

The command, the API and the page show these warnings; nothing else decides them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pfnn_jax.control.stability import SECONDS, TURN_RATE
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.ground import to_local
from pfnn_jax.motion.labels.asymmetry import MOST_SYMMETRIC, asymmetry, find_phase
from pfnn_jax.motion.labels.contacts import measured_leg_length
from pfnn_jax.motion.trajectory import root_motion
from pfnn_jax.motion.world_motion import WorldMotion, world_motion
from pfnn_jax.run import Run
from pfnn_jax.run_config import list_styles, style_note
from pfnn_jax.training.log import read_metrics

LARGEST_ANGLE = np.deg2rad(15.0)
"""Radians between travel and facing. Bandai-Namco, Xia and 100STYLE: walks and runs ahead at most 7.4°, walks through a
turn of 90° at most 13°, side steps at least 17°."""

BACKWARD = np.deg2rad(135.0)
"""Radians between travel and facing beyond which a clip is a walk backwards."""

SLOWEST = 0.3
"""Metres per second. The slowest walks of the same data have 0.48, kicks and punches at most 0.26."""

MOST_BOUNCE = 0.4
"""Leg lengths by which the hips rise and fall. Walks, runs and dashes of the same data have at most 0.3, jumps at least
0.47."""

LEAST_USED = 0.8
"""Share of the frames that have a phase. Walks, runs and dashes of the same data have one in all frames; a dance and a
sway have one in 0.36 and 0.64 of them, a cut with a stop and a turn in half."""

MOST_ERROR = 1.0
"""Held-out error of predicting the mean of the run's training data, on data of that kind."""

FAR = 3.0
"""How many times the largest error of the run's own styles a held-out error is at most, unless learning removed most of
the error without the style (`MOST_LEFT`). A style unlike all of the run's has a larger error also where it is learned
well."""

MOST_LEFT = 0.5
"""Share of the error without the style that is left at most after learning.

Measured on the demo's run with 4 settings: the procedural zombie has a held-out error of 0.38, 0.24 of that without the
style; walks of Bandai-Namco-1, Xia and 100STYLE (9) have 0.23 to 0.70, which is 0.17 to 0.36. Two clips of less than a
second, a dance, a sway, a walk that stops and turns round and one made by a generative model have 1.2 to 5.8, which is
0.52 to 1.0; a sprint has 1.65, 0.21. The run's own styles have 0.02 to 0.03."""


class RunError(NamedTuple):
    """What held-out errors of new styles are compared with.

    Attributes:
        error: one-step, squared, normalised.
        what: it is the error of, for messages.
    """

    error: float
    what: str


class StyleResult(NamedTuple):
    """What judges a learned style; the names are those of its entries in `style.json`.

    Attributes:
        held_out_error: on the last part of the clip, of the style learned from the first part.
        error_without_style: there, of the network without a style, or with the style that learning began with.
        stable_on_turns: whether the style walks circles to both sides without diverging.
    """

    held_out_error: float
    error_without_style: float
    stable_on_turns: bool


@dataclass(frozen=True)
class ClipReport:
    """What was found in a clip before learning, and whether its mirror image is used.

    Attributes:
        mirrored: whether the style is also learned from the mirror image.
        measured: whether that was decided by the clip, not by the caller.
        asymmetry: as `motion.labels.asymmetry` returns it; None if it cannot be measured.
        has_steps: whether there are alternating steps.
        used: share of the frames that are learned from: those with a phase, or all if the layout needs none.
        speed: median along the ground in metres per second.
        angle: radians from facing to the mean direction of travel, positive to the left.
        bounce: metres between the lowest and the highest place of the hips.
        leg: length of a leg in metres.
    """

    mirrored: bool
    measured: bool
    asymmetry: float | None
    has_steps: bool
    used: float
    speed: float
    angle: float
    bounce: float
    leg: float


def inspect_clip(labelled: LabelledClip, mirror: bool | None = None) -> ClipReport:
    """Measures a clip and decides whether its style is also learned from its mirror image.

    Args:
        labelled: the clip, of a skeleton with roles.
        mirror: the caller's decision; None mirrors unless the asymmetry exceeds `MOST_SYMMETRIC`.

    Raises:
        InputError: if the skeleton has no roles.
    """
    world = world_motion(labelled.world or labelled.clip)
    labels = find_phase(world, labelled.labels)
    apart = asymmetry(world, labels)
    symmetric = apart is None or apart <= MOST_SYMMETRIC
    speed, angle = _travel(world)
    height = world.positions[:, world.roles.hips, 1]
    return ClipReport(
        mirrored=symmetric if mirror is None else mirror,
        measured=mirror is None,
        asymmetry=apart,
        has_steps=labels is not None,
        used=float(labelled.labels.labelled.mean()) if labelled.labels.labelled.any() else 1.0,
        speed=speed,
        angle=angle,
        bounce=float(np.ptp(height)),
        leg=measured_leg_length(world.positions, world.roles),
    )


def clip_warnings(report: ClipReport) -> list[str]:
    """Returns what is doubtful about a clip: it is not a forward walk, or it is learned without its mirror image."""
    return [*_gait_warnings(report), *_mirror_warnings(report)]


def run_error(run: Run) -> RunError | None:
    """Returns the largest error of a run's own styles, as `pretrain_run` measured it.

    Runs of earlier versions have the last training loss instead; None for a run without a record of either.

    Raises:
        InputError: if a record is malformed.
    """
    saved = [name for name in run.config.styles if name in list_styles(run.path)]
    errors = [style_note(run.path, name).get("info", {}).get("error") for name in saved]
    known = [float(error) for error in errors if error is not None]
    if known:
        return RunError(max(known), "the largest error of the run's own styles")
    records = read_metrics(run.path)
    return RunError(float(records[-1]["loss"]), "the run's training loss") if records else None


def result_warnings(result: StyleResult, reference: RunError | None) -> list[str]:
    """Returns what is doubtful about a learned style: it does not fit the run, or its walks on circles diverge.

    Args:
        result: of learning.
        reference: as `run_error` returns it.
    """
    return [*_error_warnings(result.held_out_error, result.error_without_style, reference), *_turns(result)]


def _gait_warnings(report: ClipReport) -> list[str]:
    found = []
    if not report.has_steps:
        found.append("it has no alternating steps")
    if report.used < LEAST_USED:
        found.append(f"it has steps in only {report.used:.0%} of its frames (at least {LEAST_USED:.0%} in a walk)")
    if report.speed < SLOWEST:
        found.append(f"it moves at {report.speed:.2f} m/s (at least {SLOWEST:g} in a walk)")
    elif abs(report.angle) > BACKWARD:
        found.append("it moves backwards")
    elif abs(report.angle) > LARGEST_ANGLE:
        side, limit = "left" if report.angle > 0 else "right", np.rad2deg(LARGEST_ANGLE)
        angle = np.rad2deg(abs(report.angle))
        found.append(f"it moves {angle:.0f}° to the {side} of where the body faces (at most {limit:.0f}° in a walk)")
    if report.bounce > MOST_BOUNCE * report.leg:
        limit = MOST_BOUNCE * report.leg
        found.append(f"the hips rise and fall by {report.bounce:.2f} m (at most {limit:.2f} m on flat ground)")
    rule = "expect a poor style, or learn from a part of the clip that walks straight ahead"
    return [f"the clip is not a forward walk: {'; '.join(found)}; {rule}"] if found else []


def _mirror_warnings(report: ClipReport) -> list[str]:
    if report.mirrored or not report.measured:
        return []
    how = f"left and right differ by {report.asymmetry:.2f} of the motion (at most {MOST_SYMMETRIC:g} if symmetric)"
    return [
        f"learned without the mirror image of the clip, which halves the data: {how}; "
        "if the style is symmetric, learn it with mirror=True (few-shot --mirror True)"
    ]


def _error_warnings(error: float, without: float, reference: RunError | None) -> list[str]:
    advice = "check how the clip is read (pfnn-jax skeleton), take a longer one, or pretrain on styles nearer to it"
    if not error <= MOST_ERROR:  # also where it is not a number
        what = f"at most {MOST_ERROR:g}, that of predicting the mean of the run's data"
        return [f"the style does not fit the run: held-out error {error:.2f} ({what}); {advice}"]
    if error >= without:
        return [f"the style adds nothing: held-out error {error:.2f}, without the style {without:.2f}; {advice}"]
    if reference is not None and error > FAR * reference.error and error > MOST_LEFT * without:
        times = f"{error / reference.error:.1f} times {reference.what} (at most {FAR:g})"
        left = f"{error / without:.0%} of the error without the style (at most {MOST_LEFT:.0%})"
        return [f"the style is only partly learned: held-out error {error:.2f}, {times} and {left}; {advice}"]
    return []


def _turns(result: StyleResult) -> list[str]:
    if result.stable_on_turns:
        return []
    what = f"within {SECONDS:g} s of circles at {np.rad2deg(TURN_RATE):.0f}° per second, to the left or right"
    rule = "expect falls, or pretrain the run for longer or on more styles"
    return [f"the style diverges or does not turn {what}: {rule}"]


def _travel(world: WorldMotion) -> tuple[float, float]:
    """Returns the median speed in metres per second, and the angle in radians from facing to the mean velocity."""
    if world.num_frames < 2:
        return 0.0, 0.0
    root = root_motion(world.positions, world.roles, world.fps)
    velocity = to_local(np.diff(root.positions, axis=0) * world.fps, root.facing[:-1])
    across, ahead = velocity.mean(axis=0)
    return float(np.median(np.linalg.norm(velocity, axis=1))), float(np.arctan2(across, ahead))
