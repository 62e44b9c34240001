"""Mixtures: styles of one run by barycentric weights, combined before modulation (Mason 2022 §5.1).

A mixture adds to the network the weighted sum of what its styles add, wherever it is asked for: here as parameters of
one style (`models.style`), in a controller, whose weights change from frame to frame, as a `MixedLayer`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.inference.style_choice import StyleChoice, check_weights
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.models.style import Style, mix_styles
from pfnn_jax.run import Run, load_style
from pfnn_jax.run_config import list_styles


def load_choice(run: Run, choice: StyleChoice) -> Style | None:
    """The parameters of a choice of style; a mixture of CP styles has the sum of their ranks.

    Args:
        run: as `load_run` returns it.
        choice: a name; weights by name (any number, also negative ones); or None, which is no style at all, and on a
            FiLM run, whose network knows no motion without one, the mean of its pretraining styles.

    Raises:
        InputError: for an unknown style, weights that do not sum to one, or styles of different kinds.
    """
    weights = choice_weights(run, choice)
    if not weights:
        return None
    if isinstance(choice, str):
        return load_style(run, choice)
    check_weights(tuple(weights.values()), run.path, "style weights")
    return mix_styles(load_bank(run, tuple(weights)), jnp.asarray(list(weights.values()), jnp.float32))


def choice_weights(run: Run, choice: StyleChoice) -> dict[str, float]:
    """Weights of a choice by name; of none at all where the network moves without a style.

    Raises:
        InputError: for None on a FiLM run without styles, whose network knows no motion without one.
    """
    if choice is None and run.config.adapter.kind == "film":
        names = [name for name in run.config.styles if name in list_styles(run.path)]
        need_style(run, names)
        return dict.fromkeys(names, 1.0 / len(names))
    return {choice: 1.0} if isinstance(choice, str) else dict(choice or {})


def need_style(run: Run, names: Sequence[str]) -> None:
    """Refuses a FiLM run of which no style is named: its network knows no motion without one.

    Raises:
        InputError: naming the run.
    """
    if not names and run.config.adapter.kind == "film":
        raise InputError(run.path, "styles", "none", "a FiLM run needs at least one style to move")


def load_bank(run: Run, names: Sequence[str]) -> Style:
    """The parameters of some of a run's styles, stacked [S, ...] in the order of the names.

    Raises:
        InputError: for an unknown style, or styles of different kinds.
    """
    return stack_styles({name: load_style(run, name) for name in names}, run.path)


def stack_styles(styles: Mapping[str, Any], source: str | Path) -> Any:
    """Returns styles by name as one bank, leaves [S, ...] in the order of the names.

    Raises:
        InputError: for styles of different kinds or sizes; `source` names where they are from.
    """
    names = tuple(styles)
    shapes = [jax.tree.map(np.shape, style) for style in styles.values()]
    for name, shape in zip(names, shapes, strict=True):
        if shape != shapes[0]:
            raise InputError(
                source, "style", name, f"only styles of one kind can be mixed, and {names[0]} is of another"
            )
    return jax.tree.map(lambda *leaves: np.stack(leaves), *styles.values())


def mix_rows(bank: FiLMStyle, indices: jax.Array, weights: jax.Array) -> FiLMStyle:
    """One mixture for each row: a bank [S, 2, H], indices [N, M] and weights [N, M] give Films [N, 2, H]."""
    return jax.tree.map(lambda leaf: jnp.einsum("nm,nmlh->nlh", weights, leaf[indices]), bank)
