"""Loads styles and mixtures of styles of a run (barycentric weights, combined before modulation: Mason 2022 §4.4).

Here the weights are fixed, so a mixture becomes the parameters of one style. A controller, whose weights change from
frame to frame, mixes with `Style.mix_dynamic`; `models.style` explains why there are two forms.
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
from pfnn_jax.models.style import Style, StyleSum, is_additive, mix_styles
from pfnn_jax.run import Run, load_style
from pfnn_jax.run_config import list_styles


def load_choice(run: Run, choice: StyleChoice) -> Style | None:
    """Returns the parameters of a choice of style; a mixture of CP styles has the sum of their ranks.

    Args:
        run: a loaded run.
        choice: a name; weights by name (any number of styles, negative weights allowed); or None for style-agnostic
            motion. A FiLM network cannot run without a style, so None then means the mean of the pretraining styles.

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
    """Returns the weights of a choice by name; empty if the network runs without a style.

    Raises:
        InputError: for None on a FiLM run without styles.
    """
    if choice is None and run.config.adapter.kind == "film":
        names = [name for name in run.config.styles if name in list_styles(run.path)]
        need_style(run, names)
        return dict.fromkeys(names, 1.0 / len(names))
    return {choice: 1.0} if isinstance(choice, str) else dict(choice or {})


def need_style(run: Run, names: Sequence[str]) -> None:
    """Refuses a FiLM run without any style: its network cannot run without one.

    Raises:
        InputError: naming the run.
    """
    if not names and run.config.adapter.kind == "film":
        raise InputError(run.path, "styles", "none", "a FiLM run must have at least one style")


def load_bank(run: Run, names: Sequence[str]) -> Style:
    """Loads styles of a run and stacks their parameters, leaves [S, ...], in the order of the names.

    Raises:
        InputError: for an unknown style, or styles of different kinds.
    """
    return stack_styles({name: load_style(run, name) for name in names}, run.path)


def stack_styles(styles: Mapping[str, Any], source: str | Path, also: Sequence[Style] = ()) -> Any:
    """Stacks styles into one bank, leaves [S, ...] in the order of the mapping.

    Styles of several kinds make a `StyleSum`, if all of them only add to layers: each is zero in the parts of the
    others.

    Args:
        styles: by name, at least one.
        source: named in messages.
        also: styles of further kinds, for which the bank is to have a part.

    Raises:
        InputError: for styles of one kind and different sizes, or of different kinds that cannot be added.
    """
    firsts: dict[type, tuple[str, Style]] = {}
    for name, style in [*styles.items(), *(("also", style) for style in also)]:
        first, like = firsts.setdefault(type(style), (name, style))
        if jax.tree.map(np.shape, style) != jax.tree.map(np.shape, like):
            raise InputError(source, "style", name, f"must be of the same size as {first} to be mixed with it")
        other = next(iter(firsts.values()))
        if len(firsts) > 1 and not (is_additive(style) and is_additive(other[1])):
            raise InputError(source, "style", name, f"must be of the same kind as {other[0]} to be mixed with it")
    rows = list(styles.values())
    if len(firsts) > 1:
        parts = StyleSum(tuple(like for _, like in sorted(firsts.values(), key=lambda first: first[1].kind)))
        rows = [in_parts(style, parts) for style in rows]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *rows)


def in_parts(style: Style, parts: StyleSum) -> StyleSum:
    """Returns a style as a sum like `parts`: itself in the part of its kind, zeros in the others."""
    zeros = jax.tree.map(lambda leaf: np.zeros(np.shape(leaf), np.float32), parts)
    return StyleSum(tuple(style if type(style) is type(part) else part for part in zeros.parts))


def mix_rows(bank: FiLMStyle, indices: jax.Array, weights: jax.Array) -> FiLMStyle:
    """Mixes FiLM styles per row: a bank [S, 2, H], indices [N, M] and weights [N, M] give styles [N, 2, H]."""

    def mix(indices: jax.Array, weights: jax.Array) -> FiLMStyle:
        return jax.tree.map(lambda leaf: leaf[indices], bank).mix(weights)

    return jax.vmap(mix)(indices, weights)
