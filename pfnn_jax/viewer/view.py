"""What there is to see of a character at one moment, as plain NumPy: nothing in it is of JAX, nor of a page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.frame_layout import FrameLayout
from pfnn_jax.motion.normaliser import Normaliser

END_NAMES = ("left hand", "right hand", "left toe", "right toe")
"""The end effectors of local phases, in the order of their numbers."""


@dataclass(frozen=True)
class Dial:
    """One phase as a hand of a clock.

    Attributes:
        name: what it is the phase of.
        angle: radians; of the gait cycle 0 is the right foot's contact and π the left one's.
        amplitude: length of the hand, about 0 to 1.
    """

    name: str
    angle: float
    amplitude: float = 1.0


@dataclass(frozen=True, eq=False)
class View:
    """A character at one moment. Metres, seconds, radians; Y up; quaternions wxyz.

    Attributes:
        run, skeleton_key: name of its run; `skeleton_key` changes when the body must be built anew.
        frame: steps since the actor came on stage.
        joints: [J, 3] world positions.
        world_rotations: [J, 4] of the joints' frames.
        root: [2] on the ground (x, z).
        facing: [2] unit vector on the ground.
        heading: [] radians about +Y: where W leads; the camera's yaw when it follows.
        past_positions, past_directions: [P, 2] trajectory behind, oldest first, every tenth frame.
        future_positions, future_directions: [F, 2] ahead, from the present on.
        contacts: [4] in 0..1: left heel, left toe, right heel, right toe.
        dials: the phases: one of the gait cycle, four local ones, or none.
        speed: metres per second along the ground, now.
        wanted_speed: metres per second asked for, now.
        style_weights: style -> share of those that the character is in, smoothed; shares below a thousandth left out.
        step_milliseconds: mean of the last steps' computation.
        steps_per_second: simulated in the last second.
        recorded_seconds: length of the running recording, or None.
    """

    run: str
    skeleton_key: str
    frame: int
    joints: np.ndarray
    world_rotations: np.ndarray
    root: np.ndarray
    facing: np.ndarray
    heading: float
    past_positions: np.ndarray
    past_directions: np.ndarray
    future_positions: np.ndarray
    future_directions: np.ndarray
    contacts: np.ndarray
    dials: tuple[Dial, ...]
    speed: float
    wanted_speed: float
    style_weights: Mapping[str, float]
    step_milliseconds: float
    steps_per_second: float
    recorded_seconds: float | None


def phase_dials(layout: FrameLayout, phase: np.ndarray, scale: np.ndarray | None = None) -> tuple[Dial, ...]:
    """The hands that a state's phase is shown by.

    Args:
        layout: tells what the phase is.
        phase: [] radians, or [G] as the layout's networks read it.
        scale: [4] amplitudes of local phases that count as one, see `phase_scale`.
    """
    if layout.phase_kind == "global":
        return (Dial("gait", float(phase) % (2.0 * np.pi)),)
    if layout.phase_kind == "local":
        pairs = np.asarray(phase, np.float64).reshape(4, 2)  # sine, cosine, scaled by amplitude and speed
        pairs = pairs / (np.ones(4) if scale is None else scale)[:, None]
        return tuple(
            Dial(name, float(np.arctan2(sine, cosine) % (2.0 * np.pi)), float(np.hypot(sine, cosine)))
            for name, (sine, cosine) in zip(END_NAMES, pairs, strict=True)
        )
    return ()


def phase_scale(normaliser: Normaliser) -> np.ndarray | None:
    """[4] lengths of local phases that count as one: twice their root mean square in the data; else None."""
    if normaliser.phases is None or len(normaliser.phases.mean) != 8:
        return None
    squares = np.asarray(normaliser.phases.mean) ** 2 + np.asarray(normaliser.phases.std) ** 2
    return np.maximum(2.0 * np.sqrt(squares.reshape(4, 2).sum(axis=1)), 1e-6)
