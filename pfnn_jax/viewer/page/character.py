"""One character on library: driven by keys or a stick, in any style, through time as a clock tells it."""

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
from pfnn_jax.inference.mixture import SUM
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.viewer.page.clock import Clock
from pfnn_jax.viewer.page.drive_input import DriveInput, HeldKeys
from pfnn_jax.viewer.page.recording import Recording
from pfnn_jax.viewer.page.run_library import LoadedRun, RunLibrary, make_command
from pfnn_jax.viewer.page.view import RootHistory, View, view_of

RUN = 2.0
"""By what Shift multiplies the speed (the published demos' running biases are 2 to 4 times those of walking)."""

TURN_RATE = math.radians(100.0)
"""Radians per second by which Q and E turn the heading."""

FASTEST = 6.0
"""Metres per second: the largest speed that can be asked for."""


class Character:
    """A character with its own state, keys, style and clock. Safe to use from several threads.

    The heading is where W leads; Q and E turn it. A character faces where it goes, and does not sidestep unless
    `set_strafe` asks for it: few networks were shown how. Time comes from outside: `press` and `advance` are given
    `now` in seconds of one clock, and the same presses and times give the same motion.

    Args:
        library: the runs.
        run, style: to begin with; by default the first of the first run.

    Raises:
        InputError: for an unknown run or style.
    """

    def __init__(self, library: RunLibrary, run: str | None = None, style: str | None = None) -> None:
        self._library = library
        self._lock = threading.RLock()
        self._run = run or library.runs[0]
        loaded = library.get(self._run)
        self._shares = {style or loaded.styles[0]: 1.0}
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

    # What is asked of it

    def press(self, key: str, shift: bool = False, now: float | None = None) -> None:
        """A key has gone down or repeats: w, a, s, d, q or e; `now` by default `time.monotonic()`."""
        with self._lock:
            self._presses.append((time.monotonic() if now is None else now, key, shift))

    def set_stick(self, ahead: float, left: float, turn: float = 0.0, run: bool = False) -> None:
        """On-screen controls: stays until it is set anew; keys go before it.

        Args:
            ahead, left: -1 to 1, seen from the heading; the length is the share of the speed.
            turn: -1 to 1, positive to the left.
            run: faster.

        Raises:
            ValueError: if a value is not finite or beyond 1.
        """
        length = max(math.hypot(ahead, left), 1.0)
        with self._lock:
            self._stick = DriveInput(ahead / length, left / length, turn, run)

    def set_heading(self, yaw: float) -> None:
        """Where W leads from now on, radians about +Y: that of a camera moved by hand."""
        if math.isfinite(yaw):
            with self._lock:
                self._heading = yaw

    def set_strafe(self, strafe: bool) -> None:
        """Whether it goes on facing the heading while it steps aside or back."""
        with self._lock:
            self._strafe = strafe

    def set_speed(self, speed: float | None) -> None:
        """Metres per second of walking; None for the style's own.

        Raises:
            ValueError: unless it is above 0 and at most `FASTEST`.
        """
        if speed is not None and not 0.0 < speed <= FASTEST:
            raise ValueError(f"`speed` must be above 0 and at most {FASTEST:g} m/s, got {speed}.")
        with self._lock:
            self._speed = speed

    def choose(self, run: str, style: str) -> None:
        """Another style; of another run too, whose character then stands where this one is.

        Raises:
            InputError: for an unknown run or style.
        """
        self._take(run, {style: 1.0})

    def mix(self, names: Sequence[str], weights: Sequence[float]) -> None:
        """A mixture of styles of the present run, by weights that are not negative and sum to one.

        Raises:
            InputError: for an unknown style or other weights.
        """
        values = [float(weight) for weight in weights]
        sound = len(values) == len(names) > 0 and all(value >= 0.0 for value in values)
        if not sound or not abs(sum(values) - 1.0) <= SUM:
            shown = ", ".join(f"{value:g}" for value in values[:8])
            raise InputError("library", "style weights", shown, "one for each style, not negative, that sum to one")
        shares: dict[str, float] = {}
        for name, value in zip(names, values, strict=True):
            shares[name] = shares.get(name, 0.0) + value
        self._take(self._run, shares)

    def reset(self) -> None:
        """Back to the middle, standing, in the same style; keys and stick let go."""
        with self._lock:
            self._presses.clear()
            self._keys.clear()
            self._stick = DriveInput()
            self._heading = 0.0
            self._begin(self._library.get(self._run), np.zeros(2, np.float32), 0.0)

    # What it does

    def advance(self, now: float | None = None) -> View:
        """As many steps of 1/60 s as are due (`clock.CATCH_UP` at most), and what there is to see then.

        The first call starts the clock. `now` is by default `time.monotonic()`.
        """
        now = time.monotonic() if now is None else now
        with self._lock:
            loaded = self._library.get(self._run)
            for moment in self._clock.due(now):
                self._step(loaded, moment)
            return self._view(loaded)

    def start_recording(self) -> None:
        """Every step from now on is kept, for 10 minutes at most, until the character is put somewhere else.

        A change of run or `reset` ends the recording, which then waits for `stop_recording`. One that runs or waits is
        dropped and begun anew.
        """
        with self._lock:
            loaded = self._library.get(self._run)
            label = "+".join(self._shares)
            self._recording = Recording(loaded.run.skeleton, loaded.run.layout.fps, label, str(loaded.run.path.name))

    def stop_recording(self) -> MotionClip | None:
        """The recorded clip, up to a change of run or reset if there was one; None where nothing was recorded."""
        with self._lock:
            recording, self._recording = self._recording, None
            return None if recording is None else recording.clip()

    @property
    def run(self) -> str:
        """Name of its run."""
        return self._run

    @property
    def shares(self) -> dict[str, float]:
        """The styles asked for and their weights."""
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

    def _begin(self, loaded: LoadedRun, root: np.ndarray, yaw: float) -> None:
        """Standing at `root` [2] facing `yaw`; a recording cannot go on from there without a leap."""
        if self._recording is not None:
            self._recording.close()
        controller = loaded.controller
        first = max(self._shares, key=lambda name: self._shares[name])
        self._state: ControllerState = controller.start(position=root, yaw=yaw, style=controller.styles.index(first))
        self._facing_yaw, self._wanted = yaw, 0.0
        self._root = np.asarray(root, np.float32)  # as asked for: some layouts' bodies are one frame behind it
        self._history = RootHistory(np.array(self._state.root), np.array(self._state.facing), loaded.run.layout.fps)

    def _step(self, loaded: LoadedRun, clock: float) -> None:
        """One step of the state, by what is held at `clock` seconds."""
        while self._presses and self._presses[0][0] <= clock + 1e-9:
            pressed, key, shift = self._presses.popleft()
            self._keys.press(key, shift, pressed)
        command = self._command(loaded, clock)
        self._state = fitted(self._state, loaded.controller.capacity)
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
        self._wanted = min(length * self._walk(loaded) * (RUN if drive.run else 1.0), FASTEST)
        going = self._heading + math.atan2(drive.left, drive.ahead)
        if length > 0.0 and not self._strafe:
            self._facing_yaw = going
        elif length > 0.0 or drive.turn:
            self._facing_yaw = self._heading
        return make_command(self._wanted, going, self._facing_yaw, loaded.controller.style_weights(self._shares))

    def _walk(self, loaded: LoadedRun) -> float:
        """Metres per second of walking: as set, else the styles' own."""
        if self._speed is not None:
            return self._speed
        return sum(weight * loaded.speeds[name] for name, weight in self._shares.items())

    def _view(self, loaded: LoadedRun) -> View:
        recording = self._recording
        return view_of(
            self._state,
            loaded.run.layout,
            loaded.styles,
            self._history,
            run=self._run,
            frame=self._frame,
            heading=self._heading,
            wanted_speed=self._wanted,
            phase_scale=loaded.phase_scale,
            step_milliseconds=1e3 * float(np.mean(self._durations)) if self._durations else 0.0,
            steps_per_second=self._clock.rate,
            recorded_seconds=None if recording is None else recording.seconds,
            recording=recording is not None and recording.open,
        )


def fitted(state: ControllerState, capacity: int) -> ControllerState:
    """The state with style weights [C] for a bank that has grown since; those it had keep their rows."""
    if len(state.style) == capacity:
        return state
    weights = np.zeros(capacity, np.float32)
    weights[: len(state.style)] = state.style
    return replace(state, style=jax.device_put(weights, jax.devices()[0]))


def _wrapped(angle: float) -> float:
    return math.remainder(angle, 2.0 * math.pi)
