"""Keeps the calibration of styles, because compiling the trial walks takes longer than the rest of a start.

A calibration is kept under a digest of all that it follows from: the network, the style, the statistics and the
settings. Nothing else finds it, so no style can get that of another. Those of the base network come with the package,
in `base_network/calibrations.safetensors`. Others lie in the private folder of compiled code, under a digest that also
names the source of the package, while a command keeps compiled code there.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.control.calibration import calibrate_speeds
from pfnn_jax.control.controller_state import ControllerParams, ControllerSetup, PredictedFrame, WaitingFrame
from pfnn_jax.control.loop.state import CharacterState
from pfnn_jax.control.stance import find_stances
from pfnn_jax.control.standing import Stance
from pfnn_jax.errors import InputError
from pfnn_jax.io.compilation_cache import folder_in_use
from pfnn_jax.io.tensors import read_tensors, write_tensors
from pfnn_jax.models.style import Style, StyleSum

PACKAGE = Path(__file__).resolve().parents[1]

SHIPPED = PACKAGE / "base_network" / "calibrations.safetensors"
"""Calibrations of the styles of the base network."""

SUFFIX = "-cache"
"""Ending of a kept file: what has been unused for long is removed as compiled code is."""

SOURCES = ("control", "inference", "models", "motion")
"""Packages whose source decides what a calibration finds."""


@struct.dataclass
class Calibration:
    """Holds what trial walks of S styles have shown; leaves [S, ...], in NumPy.

    Attributes:
        speeds: [S] natural speeds, metres per second.
        gains: [S], with which to request them.
        stances: of the styles.
        waiting: the frames in which their networks wait.
    """

    speeds: np.ndarray
    gains: np.ndarray
    stances: Stance
    waiting: WaitingFrame


def calibrate(setup: ControllerSetup, params: ControllerParams, rows: Sequence[int]) -> Calibration:
    """Calibrates S styles, rows of a controller's bank, by trial walks; nothing is kept."""
    params = replace(params, stances=None, waiting=None)  # which calibration does not read: it is then compiled once
    speeds, gains = (np.array(values) for values in (params.speeds, params.speed_gains))
    chosen = np.asarray(rows, int)
    speeds[chosen], gains[chosen] = calibrate_speeds(setup, params, rows)
    calibrated = replace(params, speeds=jnp.asarray(speeds), speed_gains=jnp.asarray(gains))
    stances, waiting = find_stances(setup, calibrated, rows)
    return Calibration(speeds[chosen], gains[chosen], stances, waiting)


def kept_calibration(setup: ControllerSetup, params: ControllerParams, rows: Sequence[int]) -> Calibration:
    """Returns the calibration of S styles: what is kept of it, and the rest by trial walks, which are then kept."""
    digests = style_digests(setup, params, rows)
    found = {row: _kept(digest) for row, digest in zip(rows, digests, strict=True)}
    missing = [row for row in rows if found[row] is None]
    if missing:
        fresh = calibrate(setup, params, missing)
        for number, row in enumerate(missing):
            one: Calibration = jax.tree.map(lambda leaf, i=number: np.asarray(leaf[i]), fresh)
            found[row] = one
            _keep(digests[list(rows).index(row)], one)
    return jax.tree.map(lambda *leaves: np.stack(leaves), *(found[row] for row in rows))


def write_calibrations(path: Path, setup: ControllerSetup, params: ControllerParams, rows: Sequence[int]) -> None:
    """Calibrates styles and writes what is found as one file, as `SHIPPED`."""
    found = calibrate(setup, params, rows)
    arrays = {}
    for number, digest in enumerate(style_digests(setup, params, rows)):
        one = jax.tree.map(lambda leaf, i=number: leaf[i], found)
        arrays |= {f"{digest}/{name}": value for name, value in _named(one).items()}
    write_tensors(path, arrays, {})


def style_digests(setup: ControllerSetup, params: ControllerParams, rows: Sequence[int]) -> list[str]:
    """Returns for each style a digest of everything that its calibration follows from.

    The initial row follows from the statistics and the default speed, and its last bits from the compiler. Other
    styles of the bank, and its parts in which the style is zero, make no difference.
    """
    shared = hashlib.sha256(repr(setup).encode())
    for leaf in jax.tree.leaves((params.predictor, params.default_speed, params.initial_phase, params.foot_heights)):
        _add(shared, leaf)
    speeds, digests = np.asarray(params.speeds), []
    bank = jax.tree.map(np.asarray, params.bank)
    for row in rows:
        digest = shared.copy()
        _add(digest, speeds[row])
        for part in _parts(bank):
            leaves = [leaf[row] for leaf in jax.tree.leaves(part)]
            if any(leaf.any() for leaf in leaves):
                digest.update(type(part).__name__.encode())
                for leaf in leaves:
                    _add(digest, leaf)
        digests.append(digest.hexdigest())
    return digests


def _parts(bank: Style | None) -> tuple[Style, ...]:
    if bank is None:
        return ()
    return bank.parts if isinstance(bank, StyleSum) else (bank,)


def _add(digest: Any, leaf: Any) -> None:
    array = np.asarray(leaf)
    digest.update(f"{array.dtype}{array.shape}".encode())
    digest.update(np.ascontiguousarray(array).tobytes())


def _kept(digest: str) -> Calibration | None:
    """Returns the calibration of a style, leaves without a leading axis, or None if it is not kept or is damaged."""
    shipped = _shipped()
    if f"{digest}/speeds" in shipped:
        return _record(lambda name: shipped.get(f"{digest}/{name}"))
    file = _file(digest)
    if file is None or not file.is_file():
        return None
    with suppress(InputError, KeyError):
        arrays, _ = read_tensors(file)
        return _record(arrays.get)
    return None


def _keep(digest: str, found: Calibration) -> None:
    """Keeps the calibration of a style for later starts, where this process keeps compiled code."""
    file = _file(digest)
    if file is not None:
        with suppress(InputError, OSError):
            write_tensors(file, _named(found), {})


def _file(digest: str) -> Path | None:
    folder = folder_in_use()
    if folder is None:
        return None
    return folder / f"walk-{hashlib.sha256((digest + _source_digest()).encode()).hexdigest()}{SUFFIX}"


@cache
def _shipped() -> dict[str, np.ndarray]:
    with suppress(InputError):
        return read_tensors(SHIPPED)[0]
    return {}


@cache
def _source_digest() -> str:
    """Returns a digest of the code that calibrates, so that nothing that another version found is used."""
    digest = hashlib.sha256()
    for package in SOURCES:
        for file in sorted((PACKAGE / package).rglob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _named(found: Calibration) -> dict[str, np.ndarray]:
    """Returns the arrays of a calibration under the names of their fields, joined by dots."""
    leaves = jax.tree_util.tree_leaves_with_path(found)
    return {
        ".".join(key.name for key in path): np.asarray(leaf, np.float32)  # type: ignore[attr-defined]
        for path, leaf in leaves
    }


def _record(get: Callable[[str], np.ndarray | None]) -> Calibration:
    """Returns the calibration whose arrays `get` finds by name.

    Raises:
        KeyError: if one is absent.
    """

    def fields(record: type, place: str, optional: tuple[str, ...] = ()) -> dict[str, np.ndarray | None]:
        names = list(record.__dataclass_fields__)
        found = {name: get(f"{place}.{name}") for name in names}
        absent = [name for name in names if found[name] is None and name not in optional]
        if absent:
            raise KeyError(f"{place}.{absent[0]}")
        return found

    def number(name: str) -> np.ndarray:
        value = get(name)
        if value is None:
            raise KeyError(name)
        return value

    motion: Any = fields(CharacterState, "waiting.motion", ("joint_forward", "joint_up"))
    frame: Any = fields(PredictedFrame, "waiting.frame")
    stance: Any = fields(Stance, "stances")
    waiting = WaitingFrame(motion=CharacterState(**motion), frame=PredictedFrame(**frame))
    return Calibration(number("speeds"), number("gains"), Stance(**stance), waiting)
