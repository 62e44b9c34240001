"""Plans the root path of a procedural walk, and plants the feet along it.

A walk is defined by its root path and its phase. Each foot is planted where the root passes in the middle of that
foot's stance, and stays there exactly: the ankle from contact until the heel rises, the toe joint from when the sole is
down until it leaves the ground. In between the foot moves along a smooth curve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.kinematics import quat_from_yaw, quat_rotate
from pfnn_jax.motion.synthetic.skeleton import ANKLE_HEIGHT
from pfnn_jax.motion.synthetic.styles import SyntheticStyle

ROLL = 0.12
"""Share of the stance that the sole takes to come down after contact."""
LONGEST_STANCE = 0.86
"""Maximum distance in metres that the body travels over a planted foot; cadence rises with speed to respect it."""
SET_BACK = 0.06
"""Metres by which a foot is planted behind the middle of its stance, as the ankle comes forward at push-off."""
TOE = np.array([0.0, -0.065, 0.14])  # from ankle to toe joint, as in the skeleton
PLANT_SCATTER = 0.008  # metres, standard deviation: people do not step exactly on a line


@dataclass(frozen=True, eq=False)
class Walk:
    """The plan of a walk, with one entry per frame.

    Attributes:
        fps: frames per second.
        position: [T, 2] metres, x and z of the root on the ground.
        yaw: [T] radians about +Y, continuous.
        speed: [T] m/s.
        turn_rate: [T] rad/s.
        phase: [T] radians, continuous: right contacts at multiples of 2π, left ones half a cycle later.
        vigour: [T] stride length relative to that of the style's natural walk.
    """

    fps: float
    position: np.ndarray
    yaw: np.ndarray
    speed: np.ndarray
    turn_rate: np.ndarray
    phase: np.ndarray
    vigour: np.ndarray


@dataclass(frozen=True, eq=False)
class Foot:
    """The motion of one foot.

    Attributes:
        ankle: [T, 3] metres, world position of the ankle joint.
        yaw: [T] radians.
        pitch: [T] radians of the foot, positive with toes down.
        toe_pitch: [T] radians of the toes in the world.
    """

    ankle: np.ndarray
    yaw: np.ndarray
    pitch: np.ndarray
    toe_pitch: np.ndarray


def plan_walk(style: SyntheticStyle, turn_rate: np.ndarray, speed: np.ndarray, fps: float, start: float) -> Walk:
    """Integrates turn rate [T] (rad/s) and speed [T] (m/s) to a path, and the resulting cadence to a phase.

    Cadence grows with the square root of speed, as it does in people. It is at least 0.45 times the natural cadence,
    and high enough that the body travels no further than `LONGEST_STANCE` over one foot. `start` is the phase of the
    first frame in radians.
    """
    ratio = np.maximum(speed, 0.0) / style.speed
    cadence = style.cadence * np.maximum(np.sqrt(ratio), 0.45)
    cadence = np.maximum(cadence, speed * style.duty / LONGEST_STANCE)
    yaw = _integrate(turn_rate, fps)
    steps = speed[:, None] * np.stack([np.sin(yaw), np.cos(yaw)], axis=-1)
    position = np.stack([_integrate(steps[:, axis], fps) for axis in range(2)], axis=-1)
    vigour = (speed / cadence) / (style.speed / style.cadence)
    return Walk(fps, position, yaw, speed, turn_rate, start + 2 * np.pi * _integrate(cadence, fps), vigour)


def _integrate(rate: np.ndarray, fps: float) -> np.ndarray:
    middle = (rate[1:] + rate[:-1]) / 2
    return np.concatenate([[0.0], np.cumsum(middle)]) / fps


def smoothstep(u: np.ndarray) -> np.ndarray:
    """Rises from 0 to 1 over [0, 1], with slope 0 at both ends."""
    u = np.clip(u, 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


def cycle_of(phase: np.ndarray, left: bool) -> np.ndarray:
    """Returns the cycles since a foot's first contact, from phase in radians: the integer part counts contacts."""
    return phase / (2 * np.pi) - (0.5 if left else 0.0)


def stance_contacts(style: SyntheticStyle, phase: np.ndarray) -> np.ndarray:
    """Returns which joints of the feet are exactly still.

    Args:
        style: of the synthesised walk.
        phase: [T] radians.

    Returns:
        [T, 4] bool: left heel, left toe, right heel, right toe.
    """
    columns = []
    for left in (True, False):
        stance = (cycle_of(phase, left) % 1.0) / style.duty
        columns += [stance <= style.heel_off, (stance >= ROLL) & (stance <= 1.0)]
    return np.stack(columns, axis=-1)


def place_foot(style: SyntheticStyle, walk: Walk, left: bool, rng: np.random.Generator) -> Foot:
    """Returns the motion of a foot along a walk; `rng` scatters where it is planted by some millimetres."""
    side = 1.0 if left else -1.0
    cycle = cycle_of(walk.phase, left)
    number = np.floor(cycle).astype(int)
    stance = (cycle - number) / style.duty
    swing = np.clip((cycle - number - style.duty) / (1 - style.duty), 0.0, 1.0)
    spots, yaws = _plants(style, walk, np.arange(number[0], number[-1] + 2), left, rng)
    before, share = number - number[0], smoothstep(swing)
    yaw = yaws[before] + share * (yaws[before + 1] - yaws[before])
    ground = spots[before] + share[:, None] * (spots[before + 1] - spots[before])
    bump = 16 * swing**2 * (1 - swing) ** 2
    vigour = np.clip(walk.vigour, 0.25, 1.25)
    pitch = np.deg2rad(foot_pitch(style, stance, swing)) * vigour
    pivot = np.where(stance >= style.heel_off, 1 - share, 0.0)  # 1: about the toe joint, 0: about the ankle
    arc = np.stack([side * style.circumduction * bump, style.swing_height * bump, np.zeros_like(bump)], axis=-1)
    turned = TOE - _pitched(TOE, pitch)
    ankle = quat_rotate(quat_from_yaw(yaw), arc + pivot[:, None] * turned)
    ankle[:, [0, 2]] += ground
    ankle[:, 1] += ANKLE_HEIGHT
    return Foot(ankle, yaw, pitch, pitch * (1 - pivot))


def _plants(
    style: SyntheticStyle, walk: Walk, numbers: np.ndarray, left: bool, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Returns ground position [N, 2] and yaw [N] of each numbered stance: under the root in its middle."""
    middle = 2 * np.pi * (numbers + style.duty / 2 + (0.5 if left else 0.0))
    frames = np.interp(middle, walk.phase, np.arange(len(walk.phase)))
    when = np.arange(len(walk.phase))
    x, z, yaw = (np.interp(frames, when, values) for values in (*walk.position.T, walk.yaw))
    side = 1.0 if left else -1.0
    across = np.stack([np.cos(yaw), -np.sin(yaw)], axis=-1)
    along = np.stack([np.sin(yaw), np.cos(yaw)], axis=-1)
    spots = np.stack([x, z], axis=-1) + side * style.step_width / 2 * across - SET_BACK * along
    spots += PLANT_SCATTER * rng.standard_normal(spots.shape)
    return spots, yaw + side * np.deg2rad(style.toe_out)


def foot_pitch(style: SyntheticStyle, stance: np.ndarray, swing: np.ndarray) -> np.ndarray:
    """Returns the pitch of the foot in degrees, positive with toes down, from progress in stance and swing (0 to 1).

    Toes are up at contact, the foot is level once the sole is down, and the heel is up at push-off. A cubic joins
    push-off to the next contact with matching slope, so that the pitch is smooth.
    """
    landing = -style.strike * (1 - smoothstep(stance / ROLL))
    push = np.clip((stance - style.heel_off) / (1 - style.heel_off), 0.0, 1.0)
    pushing = style.push_off * push**2 * (3 - push) / 2
    rate = 1.5 * style.push_off * (1 - style.duty) / (style.duty * (1 - style.heel_off))
    u = swing
    flying = (
        style.push_off * (1 - smoothstep(u))
        - style.strike * smoothstep(u)
        + rate * u * (1 - u) ** 2  # Hermite tangent at the start
    )
    return np.where(swing > 0, flying, landing + pushing)


def _pitched(vector: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """Rotates a vector [3] about +X by each angle of `pitch` [T]."""
    c, s = np.cos(pitch), np.sin(pitch)
    return np.stack([vector[0] + 0 * c, c * vector[1] - s * vector[2], s * vector[1] + c * vector[2]], axis=-1)
