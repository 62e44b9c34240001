"""The runs that are played: each loaded once for all characters, with room for styles that are learned later."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pfnn_jax.control.controller import Command, Controller, make_controller, with_calibrated_speeds
from pfnn_jax.control.controller_state import ControllerParams
from pfnn_jax.control.run_settings import default_speed
from pfnn_jax.errors import InputError
from pfnn_jax.run import Run, load_run, load_style
from pfnn_jax.run_config import list_styles
from pfnn_jax.viewer.page.view import phase_scale
from pfnn_jax.workflows.base import is_base

SPARE = 8
"""Spare rows of a bank of styles: this many can be learned before the step must be compiled again."""


@dataclass(frozen=True, eq=False)
class LoadedRun:
    """A run with the controller that plays it; immutable, and replaced when a style is added.

    Attributes:
        name: its name on the page: `base` for the base network, else the folder's, preceded by parent folders if two
            runs would have the same.
        run: as loaded.
        controller: of all of its styles, with spare rows.
        speeds: style -> its natural speed, m/s.
        phase_scale: [4] amplitudes of local phases that are shown as one, or None.
    """

    name: str
    run: Run
    controller: Controller
    speeds: Mapping[str, float]
    phase_scale: np.ndarray | None

    @property
    def styles(self) -> tuple[str, ...]:
        """Names of the styles, in the order of the bank; those learned last come last."""
        return self.controller.styles

    @property
    def first_style(self) -> str:
        """The style in which a character begins: the one learned last, or else the first of the run's own."""
        learned = [style for style in self.styles if style not in self.run.config.styles]
        return max(learned, key=self._saved_at, default=self.styles[0])

    def _saved_at(self, style: str) -> float:
        """Returns when a style was saved, or 0 if its folder has been removed since."""
        try:
            return (self.run.path / "styles" / style / "style.json").stat().st_mtime
        except OSError:
            return 0.0

    @classmethod
    def load(cls, name: str, path: Path, report: Callable[[str], None] = lambda what: None) -> LoadedRun:
        """Loads a run with the controller of all of its styles.

        Args:
            name, path: of the run.
            report: called with what is being done, a few words.

        Raises:
            InputError: if the folder is not a run directory, or its styles cannot be loaded.
        """
        report(f"Reading the network of {name}")
        run = load_run(path)
        styles = list_styles(run.path)
        report(
            f"Measuring how fast the {len(styles)} styles of {name} walk" if len(styles) > 1 else f"Preparing {name}"
        )
        controller = _on_device(make_controller(run, styles, capacity=len(styles) + SPARE))
        return cls(name, run, controller, _speeds(controller), phase_scale(run.normaliser))

    def with_style(self, style: str) -> LoadedRun:
        """Returns the run with a style that has been saved in its folder.

        Raises:
            InputError: for an unknown style, or a style of another kind than the run's.
        """
        controller = add_to_bank(self.run, self.controller, style, load_style(self.run, style))
        if controller.capacity != self.controller.capacity:
            compile_step(controller)  # now, so that no character waits for it
        return replace(self, controller=controller, speeds=_speeds(controller))


class RunLibrary:
    """The loaded runs, shared by all characters. Safe to use from several threads.

    Args:
        run_paths: run directories, at least one; loaded by `load_run`, which unpickles nothing.
        report: called with what is being done, a few words, while they are loaded and warmed up.

    Raises:
        InputError: for a folder that is not a run directory, a run given twice, or one whose styles cannot be loaded.

    Attributes:
        closing: set when the page ends; no style is learned after that.
    """

    def __init__(self, run_paths: Sequence[str | Path], report: Callable[[str], None] = lambda what: None) -> None:
        if not run_paths:
            raise InputError("play", "runs", "none", "pass at least one run directory")
        paths = [Path(path) for path in run_paths]
        self._lock = threading.RLock()
        self._report = report
        names = run_names(paths)
        self._loaded = {name: LoadedRun.load(name, path, report) for name, path in zip(names, paths, strict=True)}
        self._preparations = {name: threading.Lock() for name in self._loaded}
        self._version = 0
        self.closing = threading.Event()

    @property
    def runs(self) -> tuple[str, ...]:
        """Names of the runs, in the order given."""
        return tuple(self._loaded)

    @property
    def styles(self) -> list[tuple[str, str]]:
        """(run, style) of everything that can be chosen; grows when a style is learned."""
        return [(name, style) for name, loaded in self._loaded.items() for style in loaded.styles]

    @property
    def version(self) -> int:
        """Counts the styles that have been added."""
        return self._version

    def get(self, run: str) -> LoadedRun:
        """Returns a run in its present state.

        Raises:
            InputError: for an unknown run.
        """
        if run not in self._loaded:
            raise InputError("page", "run", ascii(run)[:60], f"must be one of {', '.join(self.runs)}")
        return self._loaded[run]

    def preparation(self, run: str) -> threading.Lock:
        """Returns the lock to hold while compiling or learning in a run, so that nothing is compiled twice.

        Raises:
            InputError: for an unknown run.
        """
        return self._preparations[self.get(run).name]

    def warm_up(self) -> None:
        """Compiles one step of every run, so that the first character does not wait for it."""
        for name in self.runs:
            self._report(f"Compiling a step of {name} for this machine")
            compile_step(self.get(name).controller)

    def add_style(self, run: str, style: str) -> None:
        """Adds a style that has been saved in a run's folder to its bank; characters can choose it at once.

        Raises:
            InputError: for an unknown run or style, or a style of another kind than the run's.
        """
        with self._lock:
            self._loaded = {**self._loaded, run: self.get(run).with_style(style)}
            self._version += 1


def compile_calibration(controller: Controller) -> None:
    """Calibrates the speed of one style, so that everything is compiled that a learned style needs."""
    with_calibrated_speeds(controller, controller.styles[:1])


def compile_step(controller: Controller) -> None:
    """Starts a character and takes one step, so that everything is compiled that a character needs."""
    command = make_command(1.0, 0.0, 0.0, controller.style_weights(controller.styles[0]))
    jax.block_until_ready(controller.step(controller.start(), command))


def make_command(speed: float, heading: float, facing: float, weights: np.ndarray) -> Command:
    """Returns a controller's command as NumPy arrays.

    Args:
        speed: m/s.
        heading: radians about +Y, direction of travel.
        facing: radians about +Y, direction of the body.
        weights: [C] of the styles.
    """
    arrays: dict[str, Any] = {
        "velocity": np.asarray([speed * math.sin(heading), speed * math.cos(heading)], np.float32),
        "direction": np.asarray([math.sin(facing), math.cos(facing)], np.float32),
        "style": np.asarray(weights, np.float32),
    }
    return Command(**arrays)


def add_to_bank(run: Run, controller: Controller, style: str, parameters: object) -> Controller:
    """Returns a controller with one more style, in a spare row if there is one, else in a larger bank.

    The other styles keep their rows and their calibrated speeds. In a run without styles the unmodified network remains
    the first style: a row of zeros, which changes nothing.

    Raises:
        InputError: if the style is of another kind than those of the bank.
    """
    if controller.params.bank is None:
        zeros = jax.tree.map(lambda leaf: np.zeros((controller.capacity, *np.shape(leaf)), np.float32), parameters)
        controller = replace(controller, params=replace(controller.params, bank=zeros))
    bank = controller.params.bank
    rows = [np.shape(leaf)[1:] for leaf in jax.tree.leaves(bank)]
    if jax.tree.structure(bank) != jax.tree.structure(parameters) or rows != [
        np.shape(leaf) for leaf in jax.tree.leaves(parameters)
    ]:
        raise InputError(run.path, "style", style, "must be of the kind of the run's other styles")
    styles = controller.styles if style in controller.styles else (*controller.styles, style)
    params = controller.params
    if len(styles) > controller.capacity:
        params = _padded(params, len(styles) + SPARE)
    index = styles.index(style)
    bank = jax.tree.map(lambda rows, row: _with_row(rows, index, row), params.bank, parameters)
    params = replace(params, bank=bank, speeds=_with_row(params.speeds, index, default_speed(run, style)))
    controller = _on_device(replace(controller, params=params, styles=styles))
    return _on_device(with_calibrated_speeds(controller, [style]))


def _padded(params: ControllerParams, capacity: int) -> ControllerParams:
    """Returns the parameters with spare rows for styles, like those of `make_controller`.

    Nothing is read from disk, because not everything that is played is there: the network without a style is not.
    """
    more = capacity - len(params.speeds)

    def longer(rows: Any, value: float) -> np.ndarray:
        rows = np.asarray(rows)
        return np.concatenate([rows, np.full((more, *rows.shape[1:]), value, rows.dtype)])

    bank = jax.tree.map(lambda leaf: longer(leaf, 0.0), params.bank)
    arrays: dict[str, Any] = {"speeds": longer(params.speeds, 0.0), "speed_gains": longer(params.speed_gains, 1.0)}
    return replace(params, bank=bank, **arrays)


def _with_row(rows: Any, index: int, row: Any) -> np.ndarray:
    """Returns a copy with one row replaced. It uses NumPy, because JAX would compile the operation."""
    rows = np.array(rows)
    rows[index] = row
    return rows


def _on_device(controller: Controller) -> Controller:
    """Commits the controller's arrays to the default device: uncommitted ones would trigger a recompilation."""
    return replace(controller, params=jax.device_put(controller.params, jax.devices()[0]))


def _speeds(controller: Controller) -> dict[str, float]:
    return {name: float(speed) for name, speed in zip(controller.styles, controller.params.speeds, strict=False)}


def run_names(paths: Sequence[Path]) -> list[str]:
    """Returns short, distinct names of runs: as many of the last parts of each path as that takes.

    The base network is `base`, as on the command line: its folder is named by a fingerprint.
    """
    whole = [path.resolve() for path in paths]
    if len(set(whole)) < len(whole):
        twice = next(path for path in whole if whole.count(path) > 1)
        raise InputError(twice, "run", "given twice", "pass each run once")
    parts = [("base",) if is_base(path) else path.parts for path in whole]
    for kept in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-kept:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    return [str(path) for path in whole]
