"""Films of whole styles: the mean over a style's clips of what a generator makes of each."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.models.film_generator import FiLMGenerator
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.training.data import Rows, clip_columns, window_rows
from pfnn_jax.training.steps import generate_films

CHUNK = 16  # clips through the generator at once


def style_films(generator: FiLMGenerator, parameters: Any, data: Rows, style: int) -> FiLMStyle:
    """The Film, leaves [W, 2, H], of each of a style's windows.

    Args:
        generator, parameters: the generator.
        data: rows and windows of S styles.
        style: number of the style; its windows shorter than the generator's clips are padded.
    """
    assert data.windows is not None and data.first_window is not None
    windows = data.windows[data.first_window[style] : data.first_window[style + 1]]
    columns, found = clip_columns(data.layout), []
    for begin in range(0, len(windows), CHUNK):
        chunk = windows[begin : begin + CHUNK]
        rows = window_rows(np.resize(chunk, (CHUNK, 2)), generator.config.clip_frames)  # one shape, one compilation
        films = _films(generator, parameters, jnp.asarray(data.take_clips(rows, columns)))
        found.append(jax.tree.map(np.asarray, films))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[: len(windows)], *found)


def mean_films(generator: FiLMGenerator, parameters: Any, data: Rows) -> FiLMStyle:
    """The mean Film of every style over its windows, leaves [S, 2, H]."""
    means = [
        jax.tree.map(partial(np.mean, axis=0), style_films(generator, parameters, data, style))
        for style in range(len(data.first_row) - 1)
    ]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *means)


@partial(jax.jit, static_argnums=0)
def _films(generator: FiLMGenerator, parameters: Any, clips: jax.Array) -> FiLMStyle:
    return generate_films(generator, parameters, clips, None, None)
