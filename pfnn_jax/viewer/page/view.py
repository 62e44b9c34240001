"""What is shown of a character at one moment, as plain NumPy, independent of JAX and of the page."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from pfnn_jax.control.loop.state import ROOT, STRIDE
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.motion.kinematics import quat_normalise

if TYPE_CHECKING:
    from pfnn_jax.control.controller import ControllerState

END_NAMES = ("left hand", "right hand", "left toe", "right toe")
"""The end effectors of local phases, in order."""

SPEED_SPAN = 15
"""Steps over which the shown speed is measured."""

LEAST_WEIGHT = 5e-3
"""Weights of styles up to this are not shown: they would read 0 %."""


@dataclass(frozen=True)
class Dial:
    """One phase as the hand of a clock.

    Attributes:
        name: the end effector whose phase it is, or "gait".
        angle: radians; in the gait cycle 0 is the right foot's contact and π the left foot's.
        amplitude: length of the hand, about 0 to 1.
    """

    name: str
    angle: float
    amplitude: float = 1.0


@dataclass(frozen=True, eq=False)
class View:
    """A character at one moment. Metres, seconds, radians; Y up; quaternions wxyz.

    Attributes:
        run: name of the run whose skeleton it has.
        frame: number of steps since the character was created.
        joints: [J, 3] world positions.
        world_rotations: [J, 4] of the joints' frames.
        root: [2] on the ground (x, z).
        facing: [2] unit vector on the ground.
        past_positions, past_directions: [P, 2] past trajectory, oldest first, every tenth frame.
        future_positions, future_directions: [F, 2] predicted trajectory from the present on, scaled by the time scale:
            a single point while the character stands.
        contacts: [4] in 0..1: left heel, left toe, right heel, right toe.
        heading: [] radians about +Y: the direction of W; the yaw of a camera that turns along.
        dials: the phases: one of the gait cycle, four local ones, or none.
        speed: present speed along the ground, m/s.
        wanted_speed: commanded speed, m/s.
        style_weights: style -> its smoothed weight; those that would be shown as 0 % are omitted.
        step_milliseconds: mean computing time of the last steps.
        steps_per_second: number of steps in the last second.
        recorded_seconds: length of the recording that is running or waits to be downloaded; None without one.
        recording: whether a recording is running.
        before: joints [J, 3], world rotations [J, 4] and root [2] one step earlier; None after a jump.
        share: of the step that has passed at the moment of drawing, 0 to 1.
    """

    run: str
    frame: int
    joints: np.ndarray
    world_rotations: np.ndarray
    root: np.ndarray
    facing: np.ndarray
    past_positions: np.ndarray
    past_directions: np.ndarray
    future_positions: np.ndarray
    future_directions: np.ndarray
    contacts: np.ndarray
    heading: float = 0.0
    dials: tuple[Dial, ...] = ()
    speed: float = 0.0
    wanted_speed: float = 0.0
    style_weights: Mapping[str, float] = field(default_factory=dict)
    step_milliseconds: float = 0.0
    steps_per_second: float = 0.0
    recorded_seconds: float | None = None
    recording: bool = False
    before: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
    share: float = 1.0


def at_moment(view: View) -> View:
    """Returns the view with joints, rotations and root between the last two steps, at the moment of drawing.

    Pictures are not drawn at the moments of steps: without this a character would move by one step now and by two or
    three then, which looks like a tremor.
    """
    if view.before is None or view.share >= 1.0:
        return view
    joints, rotations, root = view.before
    shares = 1.0 - view.share, view.share
    signs = np.where(np.sum(rotations * view.world_rotations, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    between = shares[0] * signs * rotations + shares[1] * view.world_rotations  # some degrees apart: a chord will do
    return replace(
        view,
        joints=shares[0] * joints + shares[1] * view.joints,
        world_rotations=quat_normalise(between),
        root=shares[0] * root + shares[1] * view.root,
    )


class RootHistory:
    """The roots of a character in its last steps.

    The past trajectory in the network's input is corrected by command tracking; this is where the character really was.

    Args:
        root: [2] metres on the ground, first position.
        facing: [2] unit vector.
        fps: steps per second.
    """

    def __init__(self, root: np.ndarray, facing: np.ndarray, fps: float) -> None:
        self._fps, self._steps = fps, 0
        self._roots = deque([root] * ROOT, maxlen=ROOT)
        self._facings = deque([facing] * ROOT, maxlen=ROOT)

    def add(self, root: np.ndarray, facing: np.ndarray) -> None:
        """Appends one step: root [2] and facing [2]."""
        self._roots.append(root)
        self._facings.append(facing)
        self._steps += 1

    @property
    def root(self) -> np.ndarray:
        """Present position [2] in metres."""
        return self._roots[-1]

    @property
    def facing(self) -> np.ndarray:
        """Present facing direction [2], a unit vector."""
        return self._facings[-1]

    @property
    def positions(self) -> np.ndarray:
        """Positions [P, 2] in metres of every tenth frame, oldest first, up to the present."""
        return np.stack(list(self._roots)[::-STRIDE][::-1])

    @property
    def directions(self) -> np.ndarray:
        """Facing directions [P, 2] at `positions`, unit vectors."""
        return np.stack(list(self._facings)[::-STRIDE][::-1])

    @property
    def speed(self) -> float:
        """Speed in m/s over the last `SPEED_SPAN` steps; 0 before the first."""
        span = min(self._steps, SPEED_SPAN)
        return float(np.linalg.norm(self._roots[-1] - self._roots[-1 - span])) * self._fps / span if span else 0.0


def future_trajectory(state: ControllerState, history: RootHistory) -> tuple[np.ndarray, np.ndarray]:
    """Returns the predicted positions [F, 2] and directions [F, 2], from the present on, every tenth frame.

    Args:
        state: of the character.
        history: its roots, which end with this state.
    """
    positions, directions = np.asarray(state.motion.positions), np.asarray(state.motion.directions)
    ahead = np.concatenate([history.root[None], positions[ROOT + STRIDE :: STRIDE]])
    # What the network predicts n frames ahead happens n / time_scale frames ahead, and never at time scale 0.
    return (
        history.root + float(state.time_scale) * (ahead - history.root),
        np.concatenate([history.facing[None], directions[ROOT + STRIDE :: STRIDE]]),
    )


def shown_weights(styles: Sequence[str], weights: np.ndarray) -> dict[str, float]:
    """Returns style -> weight without the weights that would be shown as 0 %.

    Args:
        styles: names of the first rows of the controller's bank.
        weights: [C] of all rows.
    """
    return {name: float(w) for name, w in zip(styles, weights, strict=False) if w > LEAST_WEIGHT}


def phase_dials(layout: FrameLayout, phase: np.ndarray, scale: np.ndarray | None = None) -> tuple[Dial, ...]:
    """Returns the hands that show a state's phase.

    Args:
        layout: its `phase_kind` says what the phase is.
        phase: [] radians, or [G] as the layout's networks read it.
        scale: [4] amplitudes of local phases that are shown as one, see `phase_scale`.
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
    """Returns the lengths [4] of local phases that are shown as one: twice their root mean square; else None."""
    if normaliser.phases is None or len(normaliser.phases.mean) != 8:
        return None
    squares = np.asarray(normaliser.phases.mean) ** 2 + np.asarray(normaliser.phases.std) ** 2
    return np.maximum(2.0 * np.sqrt(squares.reshape(4, 2).sum(axis=1)), 1e-6)
