"""Banks of styles without room for another."""

from __future__ import annotations

from dataclasses import replace

import jax

from pfnn_jax.control.controller import Controller


def without_spare_rows(controller: Controller) -> Controller:
    """Returns the controller without its spare rows."""
    params = controller.params
    names = ("bank", "speeds", "speed_gains", "stances", "waiting")
    rows = {name: jax.tree.map(lambda leaf: leaf[: len(controller.styles)], getattr(params, name)) for name in names}
    return replace(controller, params=replace(params, **rows))
