"""Adds a learned style to a controller: it is calibrated first, which takes long, and its row is then put in at once.

The calibration depends on nothing that other tabs can change meanwhile.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import numpy as np
from flax import struct

from pfnn_jax.control.controller import Controller, padded_bank
from pfnn_jax.control.controller_state import ControllerParams, WaitingFrame
from pfnn_jax.control.kept_calibration import kept_calibration
from pfnn_jax.control.run_settings import default_speed
from pfnn_jax.control.standing import Stance
from pfnn_jax.errors import InputError
from pfnn_jax.inference.mixture import in_parts
from pfnn_jax.models.placement import commit
from pfnn_jax.models.style import Style, StyleSum
from pfnn_jax.run import Run

SPARE = 8
"""Least number of spare rows of a bank of styles: this many can be learned before the step must be compiled again.
Banks have a power of two, so that what was compiled before a style was learned as a rule serves the next start too, and
that a run that learns many styles is rarely compiled again: what was compiled for a smaller bank stays in memory."""


@struct.dataclass
class StyleRow:
    """The row of one style in the arrays of a controller (`ControllerParams`), leaves without the leading axis.

    Attributes:
        style: parameters, of the kind of the bank.
        speed: [] metres per second, natural speed.
        speed_gain: [], with which to request it.
        stance, waiting: found in its walk; None before calibration.
    """

    style: Style
    speed: float | np.ndarray
    speed_gain: float | np.ndarray = 1.0
    stance: Stance | None = None
    waiting: WaitingFrame | None = None


def bank_rows(num_styles: int) -> int:
    """Returns the rows of a bank for some styles and at least `SPARE` more: a power of two."""
    return 1 << (num_styles + SPARE - 1).bit_length()


def calibrated_row(run: Run, controller: Controller, name: str, style: Style) -> StyleRow:
    """Returns the row of a style of a run, calibrated by trial walks, which take a second.

    Neither the other styles of the controller nor the place of the row makes a difference.

    Raises:
        InputError: for a style of another kind than those of the bank.
    """
    style = _of_bank(run, controller, name, style)
    trial = with_row(controller, name, StyleRow(style, default_speed(run, name)))
    found = kept_calibration(trial.setup, trial.params, [trial.styles.index(name)])
    speed, gain, stance, waiting = jax.tree.map(
        lambda leaf: np.asarray(leaf)[0], (found.speeds, found.gains, found.stances, found.waiting)
    )
    return StyleRow(style, speed, gain, stance, waiting)


def with_row(controller: Controller, name: str, row: StyleRow) -> Controller:
    """Returns a controller with the row of a style: where that style is, in a spare row, or else in a larger bank.

    The other styles keep their rows. In a run without styles the unmodified network remains the first style: a row of
    zeros, which changes nothing. Arrays are committed to a device, so that the step is compiled once.
    """
    styles = controller.styles if name in controller.styles else (*controller.styles, name)
    index, params = styles.index(name), controller.params
    if params.bank is None:
        zeros = jax.tree.map(lambda leaf: np.zeros((controller.capacity, *np.shape(leaf)), np.float32), row.style)
        params = replace(params, bank=zeros)
    if len(styles) > controller.capacity:
        params = _grown(params, bank_rows(len(styles)))
    arrays: dict[str, Any] = {
        "bank": _put(params.bank, index, row.style),
        "speeds": _put(params.speeds, index, row.speed),
        "speed_gains": _put(params.speed_gains, index, row.speed_gain),
    }
    if row.stance is not None:
        arrays |= {
            "stances": _put(params.stances, index, row.stance),
            "waiting": _put(params.waiting, index, row.waiting),
        }
    return replace(controller, params=commit(replace(params, **arrays)), styles=styles)


def _of_bank(run: Run, controller: Controller, name: str, style: Style) -> Style:
    """Returns the parameters of a style in the form of a controller's bank.

    Raises:
        InputError: if the style is of another kind than those of the bank.
    """
    bank = controller.params.bank
    if bank is None:
        return style
    if isinstance(bank, StyleSum) and type(style) in map(type, bank.parts):
        style = in_parts(style, jax.tree.map(lambda leaf: np.asarray(leaf)[0], bank))
    rows = [np.shape(leaf)[1:] for leaf in jax.tree.leaves(bank)]
    if _form(style) != (jax.tree.structure(bank), rows):
        raise InputError(run.path, "style", name, "must be of the kind of the run's other styles")
    return style


def _form(style: Style) -> tuple[Any, list[tuple[int, ...]]]:
    return jax.tree.structure(style), [np.shape(leaf) for leaf in jax.tree.leaves(style)]


def _grown(params: ControllerParams, rows: int) -> ControllerParams:
    """Returns the parameters with spare rows for styles, like those of `make_controller`.

    Nothing is read from disk, because not everything that is played is there: the network without a style is not.
    """
    names = "bank", "speeds", "stances", "waiting"
    arrays = {name: padded_bank(getattr(params, name), rows) for name in names}
    return replace(params, speed_gains=padded_bank(params.speed_gains, rows, 1.0), **arrays)


def _put(bank: Any, index: int, row: Any) -> Any:
    """Returns copies of leaves [C, ...] with one row replaced. It uses NumPy: JAX would compile the operation."""

    def put(rows: Any, value: Any) -> np.ndarray:
        rows = np.array(rows)
        rows[index] = value
        return rows

    return jax.tree.map(put, bank, row)
