"""A character: driven by keys or a stick, in any style, at steps of equal length."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np

from pfnn_jax.control.controller import Command, ControllerState
from pfnn_jax.control.loop.state import ROOT
from pfnn_jax.errors import InputError
from pfnn_jax.inference.style_choice import SUM_TOLERANCE
from pfnn_jax.models.placement import commit
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.viewer.page.drive_input import DriveInput, HeldKeys
from pfnn_jax.viewer.page.recording import Recording
from pfnn_jax.viewer.page.run_library import LoadedRun, RunLibrary, make_command
from pfnn_jax.viewer.page.view import RootHistory, View, future_trajectory, phase_dials, shown_weights

RUN = 2.0
"""Factor of Shift on the speed (the running biases of the published demos are 2 to 4 times those of walking)."""

TURN_RATE = math.radians(100.0)
"""Radians per second at which Q and E turn the heading."""

FASTEST = 6.0
"""Largest speed that can be commanded, m/s."""


CATCH_UP = 6
"""Most steps taken at once; after a longer pause, as on a busy machine, the other steps are skipped."""

ROUNDING = 1e-6
"""Fraction of a step by which it may be early: times are sums of floating-point numbers."""


class Clock:
    """Says which steps of a simulation are due: step n, n / `fps` seconds after the clock was first read.

    Args:
        fps: steps per second.
    """

    def __init__(self, fps: float) -> None:
        self._fps = fps
        self._origin: float | None = None
        self._steps = 0
        self._made: deque[tuple[float, int]] = deque()

    def due(self, now: float) -> list[float]:
        """Returns the moments of the steps due since the last call, at most `CATCH_UP`; none at the first call.

        Args:
            now: seconds; if it is earlier than in a previous call, nothing is due until time has caught up.
        """
        if self._origin is None:
            self._origin = now
        behind = math.floor((now - self._origin) * self._fps + ROUNDING) - self._steps
        if behind > CATCH_UP:
            self._origin += (behind - CATCH_UP) / self._fps
            behind = CATCH_UP
        first, self._steps = self._steps, self._steps + max(behind, 0)
        self._count(now, self._steps - first)
        return [self._origin + step / self._fps for step in range(first + 1, self._steps + 1)]

    def share(self, now: float) -> float:
        """Returns how much of the step that is due next has passed, 0 to 1."""
        if self._origin is None:
            return 1.0
        return min(max((now - self._origin) * self._fps - self._steps, 0.0), 1.0)

    @property
    def rate(self) -> float:
        """Number of steps that became due in the second before the last call of `due`."""
        return float(sum(steps for _, steps in self._made))

    def _count(self, now: float, steps: int) -> None:
        self._made.append((now, steps))
        while self._made[0][0] <= now - 1.0:
            self._made.popleft()


class Character:
    """A character with its own state, keys, style and clock. Safe to use from several threads.

    The heading is the direction of W; Q and E turn it. A character faces its direction of travel unless `set_strafe`
    is set: few networks were trained to strafe. `press` and `advance` take the time `now` in seconds of one clock, and
    the same presses and times give the same motion.

    Args:
        library: the runs.
        run, style: initial ones; by default the first run, in the style learned last or else its first.

    Raises:
        InputError: for an unknown run or style.
    """

    def __init__(self, library: RunLibrary, run: str | None = None, style: str | None = None) -> None:
        self._library = library
        self._lock = threading.RLock()
        self._run = run or library.runs[0]
        loaded = library.get(self._run)
        self._shares = {style or loaded.first_style: 1.0}
        self._presses: deque[tuple[float, str, bool]] = deque(maxlen=256)
        self._keys = HeldKeys()
        self._stick = DriveInput()
        self._speed: float | None = None
        self._strafe = False
        self._recording: Recording | None = None
        self._clock = Clock(loaded.run.layout.fps)  # every layout's is the same
        self._frame = 0
        self._durations: deque[float] = deque(maxlen=60)
        self._heading = 0.0
        self._begin(loaded, np.zeros(2, np.float32), 0.0)

    # Input

    def press(self, key: str, shift: bool = False, now: float | None = None) -> None:
        """Notes that a key (w, a, s, d, q or e) goes down or repeats; `now` is by default `time.monotonic()`."""
        with self._lock:
            self._presses.append((time.monotonic() if now is None else now, key, shift))

    def set_stick(self, ahead: float, left: float, turn: float = 0.0, run: bool = False) -> None:
        """Sets the on-screen stick, which holds until it is set again; keys take precedence.

        Args:
            ahead, left: -1 to 1, relative to the heading; the length is the fraction of the speed.
            turn: -1 to 1, positive to the left.
            run: whether to go faster.

        Raises:
            ValueError: if a value is not finite or beyond 1.
        """
        length = max(math.hypot(ahead, left), 1.0)
        with self._lock:
            self._stick = DriveInput(ahead / length, left / length, turn, run)

    def set_heading(self, yaw: float) -> None:
        """Sets the direction of W, radians about +Y, such as the yaw of a camera moved by hand."""
        if math.isfinite(yaw):
            with self._lock:
                self._heading = yaw

    def set_strafe(self, strafe: bool) -> None:
        """Sets whether the character keeps facing the heading while it walks sideways or backwards."""
        with self._lock:
            self._strafe = strafe

    def set_speed(self, speed: float | None) -> None:
        """Sets the walking speed in m/s; None for the style's natural speed.

        Raises:
            ValueError: unless it is above 0 and at most `FASTEST`.
        """
        if speed is not None and not 0.0 < speed <= FASTEST:
            raise ValueError(f"`speed` must be above 0 and at most {FASTEST:g} m/s, got {speed}.")
        with self._lock:
            self._speed = speed

    def choose(self, run: str, style: str) -> None:
        """Changes the style; a character of another run then stands where this one is.

        Raises:
            InputError: for an unknown run or style.
        """
        self._take(run, {style: 1.0})

    def mix(self, names: Sequence[str], weights: Sequence[float]) -> None:
        """Changes to a mixture of styles of the present run, by weights that are not negative and sum to one.

        Raises:
            InputError: for an unknown style or other weights.
        """
        values = [float(weight) for weight in weights]
        sound = len(values) == len(names) > 0 and all(value >= 0.0 for value in values)
        if not sound or not abs(sum(values) - 1.0) <= SUM_TOLERANCE:
            shown = ", ".join(f"{value:g}" for value in values[:8])
            raise InputError("page", "style weights", shown, "must be one for each style, not negative, with sum one")
        shares: dict[str, float] = {}
        for name, value in zip(names, values, strict=True):
            shares[name] = shares.get(name, 0.0) + value
        self._take(self._run, shares)

    def reset(self) -> None:
        """Returns to the middle, standing, in the same style, and releases keys and stick."""
        with self._lock:
            self._presses.clear()
            self._keys.clear()
            self._stick = DriveInput()
            self._heading = 0.0
            loaded = self._library.get(self._run)
            self._follow_changes(loaded)
            self._begin(loaded, np.zeros(2, np.float32), 0.0)

    # Output

    def advance(self, now: float | None = None) -> View:
        """Takes the steps of 1/60 s that are due (at most `CATCH_UP`) and returns what is shown then.

        The first call starts the clock. `now` is by default `time.monotonic()`.
        """
        now = time.monotonic() if now is None else now
        with self._lock:
            loaded = self._library.get(self._run)
            self._follow_changes(loaded)
            for moment in self._clock.due(now):
                self._step(loaded, moment)
            return self._view(loaded, now)

    def start_recording(self) -> None:
        """Records every step from now on, for at most 10 minutes, until the character is moved elsewhere.

        A change of run or `reset` ends the recording, which then waits for `stop_recording`. A recording that is
        running or waiting already is discarded.
        """
        with self._lock:
            loaded = self._library.get(self._run)
            label = "+".join(self._shares)
            self._recording = Recording(loaded.run.skeleton, loaded.run.layout.fps, label, loaded.name)

    def stop_recording(self) -> MotionClip | None:
        """Ends the recording and returns its clip, up to a change of run or reset; None if nothing was recorded."""
        with self._lock:
            recording, self._recording = self._recording, None
            return None if recording is None else recording.clip()

    @property
    def run(self) -> str:
        """Name of the run."""
        return self._run

    @property
    def shares(self) -> dict[str, float]:
        """The styles that were chosen and their weights."""
        return dict(self._shares)

    def _take(self, run: str, shares: dict[str, float]) -> None:
        with self._lock:
            loaded = self._library.get(run)
            for name in shares:
                if name not in loaded.styles:
                    rule = f"must be one of {', '.join(loaded.styles)}"
                    raise InputError(loaded.run.path, "style", ascii(name)[:60], rule)
            self._shares = shares
            if run != self._run:
                self._run = run
                faced = np.asarray(self._state.motion.directions)[ROOT]
                self._begin(loaded, self._root, math.atan2(faced[0], faced[1]))

    def _follow_changes(self, loaded: LoadedRun) -> None:
        """Takes the present names of styles that were renamed, and other styles for those that were deleted."""
        if all(name in loaded.styles for name in self._shares):
            return
        before, self._shares = self._shares, {}
        for name, weight in before.items():
            present = loaded.present_style(name)
            self._shares[present] = self._shares.get(present, 0.0) + weight

    def _begin(self, loaded: LoadedRun, root: np.ndarray, yaw: float) -> None:
        """Stands at `root` [2] facing `yaw`; a recording ends, because the character jumps."""
        if self._recording is not None:
            self._recording.close()
        controller = loaded.controller
        first = max(self._shares, key=lambda name: self._shares[name])
        self._state: ControllerState = controller.start(position=root, yaw=yaw, style=controller.styles.index(first))
        self._facing, self._wanted = yaw, 0.0
        self._before: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._root = np.asarray(root, np.float32)  # as given: with some layouts the body is one frame behind
        self._history = RootHistory(np.array(self._state.root), np.array(self._state.facing), loaded.run.layout.fps)

    def _step(self, loaded: LoadedRun, clock: float) -> None:
        """Takes one step with the input at `clock` seconds."""
        while self._presses and self._presses[0][0] <= clock + 1e-9:
            pressed, key, shift = self._presses.popleft()
            self._keys.press(key, shift, pressed)
        command = self._command(loaded, clock)
        self._state = with_capacity(self._state, loaded.controller.capacity)
        self._before = np.asarray(self._state.joints), np.asarray(self._state.world_rotations), self._history.root
        started = time.perf_counter()
        self._state = jax.block_until_ready(loaded.controller.step(self._state, command))
        self._durations.append(time.perf_counter() - started)
        self._frame += 1
        self._root = np.array(self._state.root)
        self._history.add(self._root, np.array(self._state.facing))
        if self._recording is not None:
            self._recording.add(np.asarray(self._state.joints)[0], np.asarray(self._state.world_rotations))

    def _command(self, loaded: LoadedRun, clock: float) -> Command:
        keys = self._keys.drive_input(clock)
        drive = keys if keys.moves else self._stick
        self._heading = _wrapped(self._heading + drive.turn * TURN_RATE / loaded.run.layout.fps)
        length = math.hypot(drive.ahead, drive.left)
        self._wanted = min(length * self._walking_speed(loaded) * (RUN if drive.run else 1.0), FASTEST)
        heading = self._heading + math.atan2(drive.left, drive.ahead)
        if length > 0.0 and not self._strafe:
            self._facing = heading
        elif length > 0.0 or drive.turn:
            self._facing = self._heading
        return make_command(self._wanted, heading, self._facing, loaded.controller.style_weights(self._shares))

    def _walking_speed(self, loaded: LoadedRun) -> float:
        """Returns the walking speed in m/s: as set, else the mean natural speed of the styles."""
        if self._speed is not None:
            return self._speed
        return sum(weight * loaded.speeds[name] for name, weight in self._shares.items())

    def _view(self, loaded: LoadedRun, now: float) -> View:
        recording, state, history = self._recording, self._state, self._history
        future_positions, future_directions = future_trajectory(state, history)
        return View(
            run=self._run,
            frame=self._frame,
            joints=np.array(state.joints),
            world_rotations=np.array(state.world_rotations),
            root=history.root,
            facing=history.facing,
            heading=self._heading,
            past_positions=history.positions,
            past_directions=history.directions,
            future_positions=future_positions,
            future_directions=future_directions,
            contacts=np.array(state.contacts),
            dials=phase_dials(loaded.run.layout, np.asarray(state.motion.phase), loaded.phase_scale),
            speed=history.speed,
            wanted_speed=self._wanted,
            style_weights=shown_weights(loaded.controller.styles, np.asarray(state.style)),
            step_milliseconds=1e3 * float(np.mean(self._durations)) if self._durations else 0.0,
            steps_per_second=self._clock.rate,
            recorded_seconds=None if recording is None else recording.seconds,
            recording=recording is not None and recording.open,
            before=self._before,
            share=self._clock.share(now),
        )


def with_capacity(state: ControllerState, capacity: int) -> ControllerState:
    """Returns the state with style weights [C] for a bank that may have grown; its styles keep their rows."""
    if len(state.style) == capacity:
        return state
    weights = np.zeros(capacity, np.float32)
    weights[: len(state.style)] = state.style
    return replace(state, style=commit(weights))


def _wrapped(angle: float) -> float:
    return math.remainder(angle, 2.0 * math.pi)
