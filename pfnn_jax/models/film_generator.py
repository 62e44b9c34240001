"""The FiLM generator: a clip of a style -> its Film (Mason 2022 §4.2 and §4.3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import chex
import jax
import jax.numpy as jnp
from flax import nnx

from pfnn_jax.models.config import GeneratorConfig
from pfnn_jax.models.dropout import drop, need_key
from pfnn_jax.models.layers.film import FiLMStyle

_POOL = 2  # each of the two poolings halves the number of frames


@dataclass(frozen=True)
class FiLMGenerator:
    """A generator as two pure functions over a plain tree of parameters.

    Attributes:
        config: its sizes.
        init: key -> parameters, a dictionary of dictionaries of arrays.
        apply: (parameters, clip [T, F] normalised, *, dropout: [] rate or None, key) -> Film. `dropout` acts behind
            the first dense layer only, as in the authors' code, and needs `key` (ValueError). For many clips:
            `jax.vmap(generator.apply, (None, 0))`, which is one convolution over the batch in each layer.
    """

    config: GeneratorConfig
    init: Callable[[jax.Array], Any]
    apply: Callable[..., FiLMStyle]


@lru_cache
def film_generator(config: GeneratorConfig) -> FiLMGenerator:
    """The generator of these sizes; made once for each configuration, so that compiled functions are reused."""
    structure, _ = nnx.split(nnx.eval_shape(lambda: _Generator(config, nnx.Rngs(0))))
    return FiLMGenerator(config=config, init=partial(_init, config), apply=partial(_apply, structure, config))


def paper_count(config: GeneratorConfig) -> int:
    """Parameters as Mason 2022 Table 2 counts them: `filters · width + width` for each of the two convolutions.

    A convolution has `inputs · filters · width + filters`; the dense layers are counted in full.
    """
    flat = config.clip_frames // _POOL**2 * config.filters
    outputs = 4 * config.film_hidden
    dense = (flat + 1) * config.hidden + (config.hidden + 1) * outputs
    return 2 * (config.filters * config.width + config.width) + dense


class _Generator(nnx.Module):
    def __init__(self, config: GeneratorConfig, rngs: nnx.Rngs):
        # Weights uniform in ± sqrt(6 / (inputs + outputs)), the default of the authors' framework; biases zero.
        weights = nnx.initializers.glorot_uniform()
        conv = partial(nnx.Conv, kernel_size=config.width, padding="SAME", kernel_init=weights, rngs=rngs)
        dense = partial(nnx.Linear, kernel_init=weights, rngs=rngs)
        flat = config.clip_frames // _POOL**2 * config.filters
        self.conv1 = conv(config.features, config.filters)
        self.conv2 = conv(config.filters, config.filters)
        self.dense1 = dense(flat, config.hidden)
        self.dense2 = dense(config.hidden, 4 * config.film_hidden)

    def __call__(self, clip: jax.Array, dropout: jax.Array | None, key: jax.Array | None) -> jax.Array:
        value = _pool(jax.nn.relu(self.conv1(clip)))
        value = _pool(jax.nn.relu(self.conv2(value)))
        value = jax.nn.relu(self.dense1(value.reshape(-1)))
        if dropout is not None and key is not None:
            value = drop(key, dropout, value)
        return self.dense2(value)


def _pool(value: jax.Array) -> jax.Array:
    """The larger of every two frames: [T, C] -> [T / 2, C].

    Written as a maximum of two slices: XLA's CPU compiler merges a reduction with the dense layer behind it into one
    kernel that takes six times as long for a few clips.
    """
    return jnp.maximum(value[0::_POOL], value[1::_POOL])


def _init(config: GeneratorConfig, key: jax.Array) -> Any:
    return nnx.to_pure_dict(nnx.state(_Generator(config, nnx.Rngs(key))))


def _apply(
    structure: Any,
    config: GeneratorConfig,
    params: Any,
    clip: jax.Array,
    *,
    dropout: jax.Array | None = None,
    key: jax.Array | None = None,
) -> FiLMStyle:
    chex.assert_shape(clip, (config.clip_frames, config.features))
    need_key(dropout, key)
    return FiLMStyle.from_vector(nnx.merge(structure, params)(clip, dropout, key))
