"""Dropout whose rate may be a traced value: the rates used in training, and the mask."""

from __future__ import annotations

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from flax import struct


@struct.dataclass(kw_only=True)
class Dropout:
    """Drop probabilities.

    `main` acts before every layer of the shared network and of its gating network, including the first; `adapter`
    before the adapter (Mason 2018 §7.2), whose input for a one-hot style is that style's input of 1.
    """

    main: jax.Array  # []
    adapter: jax.Array  # []


def drop(key: jax.Array, rate: jax.Array, x: jax.Array) -> jax.Array:
    """Applies inverted dropout to x [...] at drop probability `rate` [], rounded to 1/256."""
    threshold = jnp.round(rate * 256.0)
    kept = random_bytes(key, x.shape).astype(x.dtype) >= threshold
    # At rate 1 nothing is kept: a scale of 1/0 would make the gradient NaN, although `where` hides it in the value.
    scale = 256.0 / jnp.maximum(256.0 - threshold, 1.0)
    return jnp.where(kept, x * scale, 0.0)


def random_bytes(key: jax.Array, shape: Sequence[int]) -> jax.Array:
    """Returns uniformly drawn bytes, uint8 of a shape.

    Four bytes are cut from each drawn word of 32 bits. `jax.random.bits` spends a word on each byte, and masks are the
    largest part of a training step on a CPU that is not a matrix product.
    """
    size = math.prod(shape)
    words = jax.random.bits(key, (-(-size // 4),), jnp.uint32)
    return jax.lax.bitcast_convert_type(words, jnp.uint8).reshape(-1)[:size].reshape(shape)


def need_key(dropout: object, key: jax.Array | None) -> None:
    """Checks that dropout comes with a random key.

    Raises:
        ValueError: if `dropout` is given and `key` is not.
    """
    if dropout is not None and key is None:
        raise ValueError("`key` is needed where `dropout` is given, got None.")
