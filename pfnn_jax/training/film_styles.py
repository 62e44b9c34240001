"""FiLM styles from a generator: of each window of a style, and their mean."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.models.film_generator import FiLMGenerator
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.training.data import Rows, evenly_spaced
from pfnn_jax.training.steps import generate_styles

CHUNK = 16  # clips through the generator at once

MEAN_WINDOWS = 100
"""Windows of a style, evenly spaced, over which its mean FiLM style is taken. A style of 100STYLE has 500, and the
generator takes as long for ten of them as for a training step."""


def window_styles(generator: FiLMGenerator, rows: Rows, style: int) -> FiLMStyle:
    """Returns the FiLM style, leaves [W, 2, H], of each of a style's windows.

    Args:
        generator: of FiLM parameters.
        rows: rows and windows of S styles.
        style: number of the style; its windows shorter than the generator's clips are padded.
    """
    return _styles_of(generator, rows, rows.windows_of(style))


def _styles_of(generator: FiLMGenerator, rows: Rows, windows: np.ndarray) -> FiLMStyle:
    found = []
    for begin in range(0, len(windows), CHUNK):
        chunk = np.resize(windows[begin : begin + CHUNK], (CHUNK, 2))  # one shape, one compilation
        clips = jnp.asarray(rows.take_clips(chunk, generator.clip_frames))
        found.append(jax.tree.map(np.asarray, _generate(generator, clips)))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[: len(windows)], *found)


def mean_styles(generator: FiLMGenerator, rows: Rows) -> FiLMStyle:
    """Returns the mean FiLM style of every style over at most `MEAN_WINDOWS` of its windows, leaves [S, 2, H]."""
    means = []
    for style in range(len(rows.styles)):
        windows = rows.windows_of(style)
        chosen = windows[evenly_spaced(len(windows), MEAN_WINDOWS)]
        means.append(jax.tree.map(partial(np.mean, axis=0), _styles_of(generator, rows, chosen)))
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *means)


@jax.jit
def _generate(generator: FiLMGenerator, clips: jax.Array) -> FiLMStyle:
    return generate_styles(generator, clips, None, None)
