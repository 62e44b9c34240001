"""The rows of styles in a controller's arrays."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import numpy as np

from pfnn_jax.control.controller import Controller

ROWS = "bank", "speeds", "speed_gains", "stances", "waiting"
"""Arrays with a row for each style."""


def row_of(controller: Controller, style: str) -> dict[str, Any]:
    """Returns the rows of a style by the names of their arrays."""
    index = controller.styles.index(style)
    return {name: jax.tree.map(lambda leaf: np.asarray(leaf)[index], getattr(controller.params, name)) for name in ROWS}


def without_spare_rows(controller: Controller) -> Controller:
    """Returns the controller without its spare rows."""
    count, params = len(controller.styles), controller.params
    rows = {name: jax.tree.map(lambda leaf: leaf[:count], getattr(params, name)) for name in ROWS}
    return replace(controller, params=replace(params, **rows))
