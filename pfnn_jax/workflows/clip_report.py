"""What may be wrong with a clip and with the style learned from it, as warnings of one line each.

The command, the API and the page show these warnings; nothing else decides them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.ground import to_local
from pfnn_jax.motion.labels.asymmetry import MOST_SYMMETRIC, asymmetry, find_phase
from pfnn_jax.motion.labels.contacts import measured_leg_length
from pfnn_jax.motion.trajectory import root_motion
from pfnn_jax.motion.world_motion import WorldMotion, world_motion
from pfnn_jax.run import Run
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

MOST_ERROR = 1.0
"""Held-out error of predicting the mean."""

FAR = 3.0
"""How many times the run's own training loss a held-out error is at most. Styles learned from walks that resemble the
run's data have 0.5 to 1.5 times."""


@dataclass(frozen=True)
class ClipReport:
    """What was found in a clip before learning, and whether its mirror image is used.

    Attributes:
        mirrored: whether the style is also learned from the mirror image.
        measured: whether that was decided by the clip, not by the caller.
        asymmetry: as `motion.labels.asymmetry` returns it; None if it cannot be measured.
        has_steps: whether there are alternating steps.
        speed: median along the ground in metres per second.
        angle: radians from facing to the mean direction of travel, positive to the left.
        bounce: metres between the lowest and the highest place of the hips.
        leg: length of a leg in metres.
    """

    mirrored: bool
    measured: bool
    asymmetry: float | None
    has_steps: bool
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
        speed=speed,
        angle=angle,
        bounce=float(np.ptp(height)),
        leg=measured_leg_length(world.positions, world.roles),
    )


def clip_warnings(report: ClipReport) -> list[str]:
    """Returns what is doubtful about a clip: it is not a forward walk, or it is learned without its mirror image."""
    return [*_gait_warnings(report), *_mirror_warnings(report)]


def training_loss(run: Run) -> float | None:
    """Returns the last training loss of a run's own styles, or None for a run without a record of it.

    Raises:
        InputError: if the record is malformed.
    """
    losses = [record.get("loss") for record in read_metrics(run.path)]
    return losses[-1] if losses else None


def result_warnings(info: Mapping[str, Any], loss: float | None) -> list[str]:
    """Returns what is doubtful about a learned style: it does not fit the run, or its walks on circles diverge.

    Args:
        info: of the style; reads `choice`, `error_without_style` and `stable_on_turns`.
        loss: as `training_loss` returns it.
    """
    return [*_error_warnings(info["choice"]["held_out_error"], info["error_without_style"], loss), *_turns(info)]


def _gait_warnings(report: ClipReport) -> list[str]:
    found = []
    if not report.has_steps:
        found.append("no alternating steps, as in a hop, a slide or a jump")
    if report.speed < SLOWEST:
        found.append(f"it moves at {report.speed:.2f} m/s, and a walk at {SLOWEST:g} or more")
    elif abs(report.angle) > BACKWARD:
        found.append("it moves backwards")
    elif abs(report.angle) > LARGEST_ANGLE:
        side = "left" if report.angle > 0 else "right"
        found.append(f"it moves {np.rad2deg(abs(report.angle)):.0f}° to the {side} of where the body faces")
    if report.bounce > MOST_BOUNCE * report.leg:
        found.append(f"the hips rise and fall by {report.bounce:.2f} m, as in a jump or on stairs")
    rule = "learn from a forward walk on flat ground, or expect a poor style"
    return [f"the clip is no walk ahead: {'; '.join(found)}; {rule}"] if found else []


def _mirror_warnings(report: ClipReport) -> list[str]:
    if report.mirrored or not report.measured:
        return []
    how = f"left and right differ by {report.asymmetry:.2f} of the motion, more than {MOST_SYMMETRIC:g}"
    return [f"not mirrored, which halves the data: {how}; mirror=True (--mirror True) learns from the mirror image too"]


def _error_warnings(error: float, without: float, loss: float | None) -> list[str]:
    if not error <= MOST_ERROR:  # also where it is not a number
        rule = "above 1.0 is worse than predicting the mean: the clip does not fit the run"
        return [f"held-out error {error:.2f}: {rule}"]
    if loss is not None and error > FAR * loss:
        times = f"{error / loss:.1f} times the training loss of the run's own styles ({loss:.2f})"
        return [f"held-out error {error:.2f}, {times}: the clip differs much from what the run was trained on"]
    if error >= without:
        return [f"held-out error {error:.2f}, without the style {without:.2f}: the style adds nothing"]
    return []


def _turns(info: Mapping[str, Any]) -> list[str]:
    if info["stable_on_turns"]:
        return []
    return ["no setting walks circles without diverging: pretrain the run for longer, or expect falls"]


def _travel(world: WorldMotion) -> tuple[float, float]:
    """Returns the median speed in metres per second, and the angle in radians from facing to the mean velocity."""
    if world.num_frames < 2:
        return 0.0, 0.0
    root = root_motion(world.positions, world.roles, world.fps)
    velocity = to_local(np.diff(root.positions, axis=0) * world.fps, root.facing[:-1])
    across, ahead = velocity.mean(axis=0)
    return float(np.median(np.linalg.norm(velocity, axis=1))), float(np.arctan2(across, ahead))
