"""The runs that are played, each loaded once for all characters, and how a new style joins one of them."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pfnn_jax.control.controller import Command, Controller, make_controller, with_calibrated_speeds
from pfnn_jax.control.controller_state import ControllerParams
from pfnn_jax.control.run_settings import default_speed
from pfnn_jax.errors import InputError
from pfnn_jax.run import Run, list_styles, load_run, load_style
from pfnn_jax.viewer.page.view import phase_scale

SPARE = 8
"""Rows of a bank beyond the styles there are: so many can be learned before the step is compiled once more."""


@dataclass(frozen=True, eq=False)
class LoadedRun:
    """A run as it is played: never changed, but replaced when a style joins.

    Attributes:
        name: by which pages call it: its folder's, with more of its path where two would be alike.
        run: as loaded.
        controller: of all of its styles, with spare rows.
        speeds: style -> metres per second of its own walk.
        phase_scale: amplitudes of local phases that count as one, or None.
    """

    name: str
    run: Run
    controller: Controller
    speeds: Mapping[str, float]
    phase_scale: np.ndarray | None

    @property
    def styles(self) -> tuple[str, ...]:
        """Names of the styles, in the order of the bank; those learned since come last."""
        return self.controller.styles


class RunLibrary:
    """Everything that all characters share. Safe to use from several threads.

    Args:
        run_paths: folders of runs, at least one; loaded by `load_run`, which unpickles nothing.

    Raises:
        InputError: for a folder that is no run, a run given twice, or one whose styles cannot be loaded.

    Attributes:
        ended: set when nothing shall be learned any more.
    """

    def __init__(self, run_paths: Sequence[str | Path]) -> None:
        if not run_paths:
            raise InputError("library", "runs", "none", "there must be at least one run to play")
        paths = [Path(path) for path in run_paths]
        self._lock = threading.RLock()
        self._loaded = {name: load_for_play(name, path) for name, path in zip(_names(paths), paths, strict=True)}
        self._preparations = {name: threading.Lock() for name in self._loaded}
        self._version = 0
        self.ended = threading.Event()

    @property
    def runs(self) -> tuple[str, ...]:
        """Names of the runs, in the order given."""
        return tuple(self._loaded)

    @property
    def styles(self) -> list[tuple[str, str]]:
        """(run, style) of all that can be chosen; grows when a style is learned."""
        return [(name, style) for name, loaded in self._loaded.items() for style in loaded.styles]

    @property
    def version(self) -> int:
        """Grows by one whenever `styles` does."""
        return self._version

    def get(self, run: str) -> LoadedRun:
        """A run as it is played now.

        Raises:
            InputError: for a run that is not on library.
        """
        if run not in self._loaded:
            raise InputError("library", "run", ascii(run)[:60], f"must be one of {', '.join(self.runs)}")
        return self._loaded[run]

    def preparation(self, run: str) -> threading.Lock:
        """Held by who compiles or learns in a run, so that nothing is compiled twice.

        Raises:
            InputError: for a run that is not on library.
        """
        return self._preparations[self.get(run).name]

    def warm_up(self) -> None:
        """Compiles one step of every run, so that the first character does not wait for it."""
        for name in self.runs:
            try_out(self.get(name).controller)

    def add_style(self, run: str, style: str) -> None:
        """Takes a style that has been saved in a run's folder into its bank; characters can choose it at once.

        Raises:
            InputError: for an unknown run or style, or a style of another kind than the run's.
        """
        parameters = load_style(self.get(run).run, style)
        with self._lock:
            loaded = self.get(run)
            controller = joined(loaded.run, loaded.controller, style, parameters)
            if controller.capacity != loaded.controller.capacity:
                try_out(controller)  # before characters have to wait for its compilation
            self._loaded = {**self._loaded, run: replace(loaded, controller=controller, speeds=_speeds(controller))}
            self._version += 1


def rehearse_walks(controller: Controller) -> None:
    """Tries one style as one that is learned will be, so that everything is compiled for that."""
    with_calibrated_speeds(controller, controller.styles[:1])


def try_out(controller: Controller) -> None:
    """A start and a step, for which everything is compiled that a character needs."""
    command = make_command(1.0, 0.0, 0.0, controller.style_weights(controller.styles[0]))
    jax.block_until_ready(controller.step(controller.start(), command))


def make_command(speed: float, going: float, facing: float, weights: np.ndarray) -> Command:
    """A controller's command, as NumPy: `speed` m/s along the yaw `going`, facing the yaw `facing`, styles [C]."""
    arrays: dict[str, Any] = {
        "velocity": np.asarray([speed * math.sin(going), speed * math.cos(going)], np.float32),
        "direction": np.asarray([math.sin(facing), math.cos(facing)], np.float32),
        "style": np.asarray(weights, np.float32),
    }
    return Command(**arrays)


def load_for_play(name: str, path: Path) -> LoadedRun:
    """A run with the controller of all of its styles."""
    run = load_run(path)
    styles = list_styles(run.path)
    controller = _bound(make_controller(run, styles, capacity=len(styles) + SPARE))
    return LoadedRun(name, run, controller, _speeds(controller), phase_scale(run.normaliser))


def joined(run: Run, controller: Controller, style: str, parameters: object) -> Controller:
    """A controller with one more style, in a spare row where there is one, else in a larger bank.

    The other styles keep their rows and what was found out of their walks. Where the run had no styles, its network as
    it is stays the first: a row of zeros, which adds nothing.

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
        raise InputError(run.path, "style", style, "must be of the kind of the run's other styles to be played")
    styles = controller.styles if style in controller.styles else (*controller.styles, style)
    params = controller.params
    if len(styles) > controller.capacity:
        params = _padded(params, len(styles) + SPARE)
    index = styles.index(style)
    bank = jax.tree.map(lambda rows, row: _with_row(rows, index, row), params.bank, parameters)
    params = replace(params, bank=bank, speeds=_with_row(params.speeds, index, default_speed(run, style)))
    return _bound(with_calibrated_speeds(_bound(replace(controller, params=params, styles=styles)), [style]))


def _padded(params: ControllerParams, capacity: int) -> ControllerParams:
    """The parameters with more rows for styles, as `make_controller` leaves spare ones. Nothing is read from disk:
    what is played need not be there, as the network without a style is not."""
    more = capacity - len(params.speeds)

    def longer(rows: Any, value: float) -> np.ndarray:
        rows = np.asarray(rows)
        return np.concatenate([rows, np.full((more, *rows.shape[1:]), value, rows.dtype)])

    bank = jax.tree.map(lambda leaf: longer(leaf, 0.0), params.bank)
    arrays: dict[str, Any] = {"speeds": longer(params.speeds, 0.0), "speed_gains": longer(params.speed_gains, 1.0)}
    return replace(params, bank=bank, **arrays)


def _with_row(rows: Any, index: int, row: Any) -> np.ndarray:
    """A copy with one row replaced, by NumPy: JAX would compile it."""
    rows = np.array(rows)
    rows[index] = row
    return rows


def _bound(controller: Controller) -> Controller:
    """The controller with its arrays bound to the default device: what is bound is compiled anew where it was not."""
    return replace(controller, params=jax.device_put(controller.params, jax.devices()[0]))


def _speeds(controller: Controller) -> dict[str, float]:
    return {name: float(speed) for name, speed in zip(controller.styles, controller.params.speeds, strict=False)}


def _names(paths: Sequence[Path]) -> list[str]:
    """Short names of folders, all different: as many of the last parts of each path as that takes."""
    whole = [path.resolve() for path in paths]
    if len(set(whole)) < len(whole):
        twice = next(path for path in whole if whole.count(path) > 1)
        raise InputError(twice, "run", "given twice", "each run is played once")
    for parts in range(1, max(len(path.parts) for path in whole) + 1):
        names = ["/".join(path.parts[-parts:]) for path in whole]
        if len(set(names)) == len(names):
            return names
    return [str(path) for path in whole]
