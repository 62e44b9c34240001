"""The runs that are played: each loaded once for all characters, with room for styles that are learned later."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from pfnn_jax.control.abilities import can_strafe
from pfnn_jax.control.controller import Command, Controller, make_controller
from pfnn_jax.control.forms import zeros_of
from pfnn_jax.control.kept_calibration import calibrate
from pfnn_jax.errors import InputError
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.placement import commit
from pfnn_jax.motion.datasets.sources import check_style_name
from pfnn_jax.run import Run, load_run, load_style
from pfnn_jax.run_config import list_styles
from pfnn_jax.viewer.page import background
from pfnn_jax.viewer.page.journal import finish_moves
from pfnn_jax.viewer.page.learning import LearningBoard
from pfnn_jax.viewer.page.style_bank import StyleRow, bank_rows, calibrated_row, with_row
from pfnn_jax.viewer.page.style_files import (
    DeletedStyle,
    delete_style,
    empty_trash,
    remove_unfinished,
    rename_style,
    restore_style,
)
from pfnn_jax.viewer.page.view import phase_scale
from pfnn_jax.workflows.base import is_base
from pfnn_jax.workflows.learn import default_config

DELETED = "\0"
"""First character of the name of a bank's row whose style was deleted; one more stands before it for each style of the
same name that was deleted later. No style can have such a name."""


class Preparation(NamedTuple):
    """Locks of a run that keep two threads from compiling the same at the same time.

    Attributes:
        training: held while a style is learned, or learning is compiled.
        calibration: held while a style is calibrated, or its calibration and the rollouts that judge it are compiled.
            Learning, which needs these rollouts last, does not wait for it.
    """

    training: threading.Lock
    calibration: threading.Lock


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
        renamed: earlier name of a style -> its present one.
    """

    name: str
    run: Run
    controller: Controller
    speeds: Mapping[str, float]
    phase_scale: np.ndarray | None
    renamed: Mapping[str, str] = field(default_factory=dict)

    @property
    def styles(self) -> tuple[str, ...]:
        """Names of the styles, in the order of the bank; those learned last come last."""
        return tuple(name for name in self.controller.styles if not name.startswith(DELETED))

    def present_style(self, name: str) -> str:
        """Returns the present name of a style; for one that was deleted, the style in which a character begins."""
        name = self.renamed.get(name, name)
        return name if name in self.styles else self.first_style

    def is_learned(self, name: str) -> bool:
        """Returns whether a style was learned later than the run, and is saved in it: it can be renamed and deleted."""
        return name in self.styles and name not in self.run.config.styles and name in list_styles(self.run.path)

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
        few_shot = default_config(run)
        later = AdapterConfig(few_shot.method, few_shot.rank) if few_shot.restyled else None
        controller = make_controller(run, styles, capacity=bank_rows(len(styles)), later=later)
        controller = replace(controller, params=commit(controller.params))  # so that its step is compiled once
        return cls(name, run, controller, _speeds(controller), phase_scale(run.normaliser))

    def calibrated_row(self, style: str) -> StyleRow:
        """Returns the row of a style that has been saved in the run's folder; takes a second of trial walks.

        Raises:
            InputError: for an unknown style, or a style of another kind than the run's.
        """
        return calibrated_row(self.run, self._with_place(style).controller, style, load_style(self.run, style))

    def with_style(self, style: str, row: StyleRow) -> LoadedRun:
        """Returns the run with a style, given its row, which `calibrated_row` may have found in an earlier state."""
        controller = with_row(self._with_place(style).controller, style, row)
        renamed = {old: new for old, new in self.renamed.items() if old != style}
        return replace(self, controller=controller, speeds=_speeds(controller), renamed=renamed)

    def _with_place(self, style: str) -> LoadedRun:
        """Returns the run with the name of a new style on a row whose style was deleted, if no row is spare."""
        names = self.controller.styles
        free = next((name for name in names if name.startswith(DELETED)), None)
        if free is None or style in names or len(names) < self.controller.capacity:
            return self
        return self._with_names({free: style})

    def with_renamed(self, old: str, new: str) -> LoadedRun:
        """Returns the run with another name for a style."""
        renamed = {before: new if after == old else after for before, after in self.renamed.items() if before != new}
        return replace(self._with_names({old: new}), renamed={**renamed, old: new})

    def without_style(self, style: str) -> LoadedRun:
        """Returns the run without a style; its row of the bank stays, so that nothing is compiled again."""
        return self._with_names({name: f"{DELETED}{name}" for name in self._rows_of(style)})

    def with_restored(self, style: str) -> LoadedRun | None:
        """Returns the run with the style of a name deleted last, or None if another style has its row by now."""
        rows = self._rows_of(style)
        if f"{DELETED}{style}" not in rows:
            return None
        renamed = {old: new for old, new in self.renamed.items() if old != style}
        return replace(self._with_names({name: name.removeprefix(DELETED) for name in rows}), renamed=renamed)

    def _rows_of(self, style: str) -> list[str]:
        """Returns the names of the bank's rows whose style has this name, or had it when it was deleted."""
        return [name for name in self.controller.styles if name.lstrip(DELETED) == style]

    def _with_names(self, names: Mapping[str, str]) -> LoadedRun:
        controller = replace(self.controller, styles=tuple(names.get(name, name) for name in self.controller.styles))
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
        learning: what is being learned, for all tabs.
    """

    def __init__(self, run_paths: Sequence[str | Path], report: Callable[[str], None] = lambda what: None) -> None:
        if not run_paths:
            raise InputError("play", "runs", "none", "pass at least one run directory")
        paths = [Path(path) for path in run_paths]
        self._lock = threading.RLock()
        self._report = report
        names = run_names(paths)
        for path in paths:
            finish_moves(path)
        self._loaded = {name: LoadedRun.load(name, path, report) for name, path in zip(names, paths, strict=True)}
        self._preparations = {name: Preparation(threading.Lock(), threading.Lock()) for name in self._loaded}
        self._version = 0
        self._deleted: list[tuple[str, DeletedStyle]] = []
        self._strafes: dict[tuple[str, str], bool] = {}
        self.closing, self.learning = threading.Event(), LearningBoard()
        self.empty_trash()
        for loaded in self._loaded.values():
            remove_unfinished(loaded.run.path)

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
        """Counts the changes of styles."""
        return self._version

    def get(self, run: str) -> LoadedRun:
        """Returns a run in its present state.

        Raises:
            InputError: for an unknown run.
        """
        if run not in self._loaded:
            raise InputError("page", "run", ascii(run)[:60], f"must be one of {', '.join(self.runs)}")
        return self._loaded[run]

    def preparation(self, run: str) -> Preparation:
        """Returns the locks to hold while something is compiled in a run or used for the first time.

        Raises:
            InputError: for an unknown run.
        """
        return self._preparations[self.get(run).name]

    def warm_up(self, meanwhile: Callable[[str], None] = lambda run: None) -> None:
        """Compiles one step of every run, so that the first character does not wait for it.

        Args:
            meanwhile: called with the name of each run, in another thread, while its step is still being compiled.
        """
        for name in self.runs:
            self._report(f"Compiling a step of {name} for this machine")
            compile_character(self.get(name).controller, partial(meanwhile, name))

    def add_style(self, run: str, style: str) -> None:
        """Adds a new style, which has been saved in a run's folder, to its bank; characters can choose it at once.

        Raises:
            InputError: for an unknown run or style, or a style of another kind than the run's.
        """
        before = self.get(run)
        row, compiled = before.calibrated_row(style), before.controller.capacity  # without the lock: it takes a second
        while True:
            with self._lock:
                present = self.get(run)
                after = present.with_style(style, row)
                if after.controller.capacity in (compiled, present.controller.capacity):
                    self._replace(run, after)
                    return
            compile_character(after.controller)  # now, so that no character waits for it
            compiled = after.controller.capacity

    def rename_style(self, run: str, old: str, new: str) -> None:
        """Renames a learned style, in the run's folder and for all characters.

        Raises:
            InputError: for a style that was not learned here, or a name that cannot be a folder's or is taken.
        """
        with self._lock:
            loaded = self._need_learned(run, old)
            check_style_name(new, run)  # here, so that a refusal names the run as the page does, not its folder
            if new.lower() in (style.lower() for style in loaded.styles if style != old):
                raise InputError(run, "style name", new, "is taken by another style; choose another name")
            rename_style(loaded.run.path, old, new)
            self._replace(run, loaded.with_renamed(old, new))

    def delete_style(self, run: str, name: str) -> None:
        """Deletes a learned style; characters that walk in it take another. `restore_style` brings it back.

        Raises:
            InputError: for a style that was not learned here or is the only one, or a run that cannot be written.
        """
        with self._lock:
            loaded = self._need_learned(run, name)
            if len(loaded.styles) == 1:
                raise InputError(run, "style", name, "is the only style of the run, which needs one")
            self._deleted.append((run, delete_style(loaded.run.path, name)))
            self._replace(run, loaded.without_style(name))

    def deleted_style(self, run: str) -> str | None:
        """Returns the style of a run that was deleted last and can be restored, or None."""
        return next((deleted.name for name, deleted in reversed(self._deleted) if name == run), None)

    def restore_style(self, run: str) -> str:
        """Restores the style of a run that was deleted last; returns its name.

        Raises:
            InputError: if there is none, its name has been taken meanwhile, or the run cannot be written.
        """
        with self._lock:
            found = next((entry for entry in reversed(self._deleted) if entry[0] == run), None)
            if found is None:
                raise InputError(run, "style", "none", "nothing was deleted that could be restored")
            loaded, name = self.get(run), found[1].name
            restore_style(loaded.run.path, found[1])
            self._deleted.remove(found)
            restored = loaded.with_restored(name)
            if restored is not None:
                self._replace(run, restored)
                return name
        with self.preparation(run).calibration:
            self.add_style(run, name)
        return name

    def strafes(self, run: str, style: str) -> bool | None:
        """Returns whether a style can sidestep; None until `try_strafe` has found out."""
        return self._strafes.get((run, style))

    def try_strafe(self, run: str, style: str) -> bool:
        """Finds out whether a style can sidestep, by commanding it to: takes a fraction of a second.

        Raises:
            InputError: for an unknown run or style.
        """
        loaded = self.get(run)
        if style not in loaded.styles:  # renamed or deleted meanwhile
            raise InputError(run, "style", ascii(style)[:60], f"must be one of {', '.join(loaded.styles)}")
        found = can_strafe(loaded.controller, style)
        self._strafes = {**self._strafes, (run, style): found}
        return found

    def empty_trash(self) -> None:
        """Removes what was deleted for good."""
        self._deleted.clear()
        for loaded in self._loaded.values():
            empty_trash(loaded.run.path)

    def _need_learned(self, run: str, name: str) -> LoadedRun:
        loaded = self.get(run)
        if not loaded.is_learned(name):
            raise InputError(
                run, "style", ascii(name)[:60], "must be a style that was learned; the run's own ones stay"
            )
        return loaded

    def _replace(self, run: str, loaded: LoadedRun) -> None:
        self._loaded = {**self._loaded, run: loaded}
        self._strafes = {}  # a name can be that of another style now
        self._version += 1


def compile_calibration(controller: Controller) -> None:
    """Calibrates one style, so that everything is compiled that a learned style needs."""
    calibrate(controller.setup, controller.params, [0])


def compile_character(controller: Controller, meanwhile: Callable[[], None] = lambda: None) -> None:
    """Starts a character and takes one step from a state of zeros, so that everything is compiled that one needs.

    Both are compiled at the same time.

    Args:
        controller: of the character.
        meanwhile: called in the thread of the start once that is compiled, while the step still is, which leaves a core
            idle; not waited for.
    """
    started, errors = threading.Event(), []

    def start() -> None:
        try:
            background.do(lambda: jax.block_until_ready(controller.start()))
        except Exception as error:  # raised below, in the calling thread
            errors.append(error)
            return
        finally:
            started.set()
        meanwhile()

    threading.Thread(target=start, name="start", daemon=True).start()
    state = commit(zeros_of(controller.start))
    command = make_command(1.0, 0.0, 0.0, controller.style_weights(controller.styles[0]))
    jax.block_until_ready(controller.step(state, command))
    started.wait()
    if errors:
        raise errors[0]


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
