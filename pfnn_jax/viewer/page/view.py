"""What there is to see of a character at one moment, as plain NumPy: nothing in it is of JAX, nor of a page."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pfnn_jax.control.loop.state import ROOT, STRIDE
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser

if TYPE_CHECKING:
    from pfnn_jax.control.controller import ControllerState

END_NAMES = ("left hand", "right hand", "left toe", "right toe")
"""The end effectors of local phases, in the order of their numbers."""

SPEED_SPAN = 15
"""Steps over which the shown speed is measured."""

SEEN_SHARE = 1e-3
"""Of a style: smaller shares are not shown."""


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
        run: name of its run, to which its body belongs.
        frame: steps since the character came on library.
        joints: [J, 3] world positions.
        world_rotations: [J, 4] of the joints' frames.
        root: [2] on the ground (x, z).
        facing: [2] unit vector on the ground.
        heading: [] radians about +Y: where W leads; the camera's yaw when it follows.
        past_positions, past_directions: [P, 2] trajectory behind, oldest first, every tenth frame.
        future_positions, future_directions: [F, 2] ahead, from the present on, where it is going at its pace: all in
            one point for who stands.
        contacts: [4] in 0..1: left heel, left toe, right heel, right toe.
        dials: the phases: one of the gait cycle, four local ones, or none.
        speed: metres per second along the ground, now.
        wanted_speed: metres per second asked for, now.
        style_weights: style -> share of those that the character is in, smoothed; shares below a thousandth left out.
        step_milliseconds: mean of the last steps' computation.
        steps_per_second: simulated in the last second.
        recorded_seconds: length of the recording that waits to be fetched, running or ended; None where there is none.
        recording: whether it still grows.
    """

    run: str
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
    recording: bool


class RootHistory:
    """Where a character has been in its last steps.

    What the network remembers of its way is turned with it; this is where it really was.

    Args:
        root: [2] metres on the ground, where it stands at first.
        facing: [2] unit vector.
        fps: steps per second.
    """

    def __init__(self, root: np.ndarray, facing: np.ndarray, fps: float) -> None:
        self._fps, self._steps = fps, 0
        self._roots = deque([root] * ROOT, maxlen=ROOT)
        self._facings = deque([facing] * ROOT, maxlen=ROOT)

    def add(self, root: np.ndarray, facing: np.ndarray) -> None:
        """One step further: root [2] and facing [2]."""
        self._roots.append(root)
        self._facings.append(facing)
        self._steps += 1

    @property
    def root(self) -> np.ndarray:
        """[2] metres, now."""
        return self._roots[-1]

    @property
    def facing(self) -> np.ndarray:
        """[2] unit vector, now."""
        return self._facings[-1]

    @property
    def positions(self) -> np.ndarray:
        """[P, 2] metres, oldest first and up to now, every tenth frame."""
        return np.stack(list(self._roots)[::-STRIDE][::-1])

    @property
    def directions(self) -> np.ndarray:
        """[P, 2] unit vectors at `positions`."""
        return np.stack(list(self._facings)[::-STRIDE][::-1])

    @property
    def speed(self) -> float:
        """Metres per second over the last `SPEED_SPAN` steps; 0 before the first."""
        span = min(self._steps, SPEED_SPAN)
        return float(np.linalg.norm(self._roots[-1] - self._roots[-1 - span])) * self._fps / span if span else 0.0


def view_of(
    state: ControllerState,
    layout: FrameLayout,
    styles: Sequence[str],
    history: RootHistory,
    *,
    run: str,
    frame: int,
    heading: float,
    wanted_speed: float,
    phase_scale: np.ndarray | None,
    step_milliseconds: float,
    steps_per_second: float,
    recorded_seconds: float | None,
    recording: bool,
) -> View:
    """The view of a driven character.

    Args:
        state: of the character, after the step by which `way` ends.
        layout: of its network.
        styles: names of the first rows of the controller's bank.
        way: where it has been.
        phase_scale: [4] amplitudes of local phases that count as one, or None.
        run, frame, heading, wanted_speed, step_milliseconds, steps_per_second, recorded_seconds, recording: as in
            `View`.
    """
    positions, directions = np.asarray(state.motion.positions), np.asarray(state.motion.directions)
    ahead, pace = np.concatenate([history.root[None], positions[ROOT + STRIDE :: STRIDE]]), float(state.time_scale)
    weights = np.asarray(state.style)
    return View(
        run=run,
        frame=frame,
        joints=np.array(state.joints),
        world_rotations=np.array(state.world_rotations),
        root=history.root,
        facing=history.facing,
        heading=heading,
        past_positions=history.positions,
        past_directions=history.directions,
        # What lies n frames ahead in its own time is walked in n / pace of the world's, and never at pace 0.
        future_positions=history.root + pace * (ahead - history.root),
        future_directions=np.concatenate([history.facing[None], directions[ROOT + STRIDE :: STRIDE]]),
        contacts=np.array(state.contacts),
        dials=phase_dials(layout, np.asarray(state.motion.phase), phase_scale),
        speed=history.speed,
        wanted_speed=wanted_speed,
        style_weights={n: float(w) for n, w in zip(styles, weights, strict=False) if w >= SEEN_SHARE},
        step_milliseconds=step_milliseconds,
        steps_per_second=steps_per_second,
        recorded_seconds=recorded_seconds,
        recording=recording,
    )


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
