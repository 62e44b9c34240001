"""Convolves over time, pools by the maximum and depools by the average: frames [T, I] to frames [T, O].

All functions are for one clip without a batch axis; use `jax.vmap` for many.
"""

from __future__ import annotations

from typing import Self

import jax
import jax.numpy as jnp
from flax import struct

POOLING = 2
"""Frames that pooling merges into one."""


@struct.dataclass(kw_only=True)
class Convolution:
    """A convolution over time with zeros beyond the ends.

    Attributes:
        filters: [W, I, O]; frame t of the output sees frames t - W // 2 to t + (W - 1) // 2 of the input through
            filters[0] to filters[W - 1]. (This is what neural networks call a convolution; Theano's flips the filter.)
        bias: [O].
    """

    filters: jax.Array
    bias: jax.Array

    @classmethod
    def init(cls, width: int, inputs: int, outputs: int, *, key: jax.Array) -> Self:
        """Returns Glorot-uniform filters and a zero bias."""
        filters = jax.nn.initializers.glorot_uniform()(key, (width, inputs, outputs))
        return cls(filters=filters, bias=jnp.zeros(outputs))

    def __call__(self, frames: jax.Array) -> jax.Array:
        """Returns the convolution [T, O] of frames [T, I]."""
        return convolve(frames, self.filters) + self.bias[None]


def convolve(frames: jax.Array, filters: jax.Array, before: int | None = None) -> jax.Array:
    """Returns Σ_w frames[t + w - before] filters[w] for every frame t, with zeros beyond the ends.

    Even and odd frames are computed from three convolutions of even and odd frames with half as many taps, instead of
    four: the fast FIR algorithm of two phases (Parhi 1999, *VLSI Digital Signal Processing Systems*, §9.2). Each is one
    matrix product of all windows with all filters. On CPUs, XLA's own convolution takes 5 to 90 times as long in
    gradients within a compiled loop (jax-ml/jax#12868), and style transfer optimises in such a loop.

    Args:
        frames: [T, I].
        filters: [W, I, O].
        before: frames of a window that lie before t; by default W // 2, which centres windows of odd width.

    Returns:
        [T, O].
    """
    (num_frames, _), (width, _, outputs) = frames.shape, filters.shape
    before = width // 2 if before is None else before
    pairs, taps = -(-num_frames // 2), -(-width // 2)  # of even and odd frames, and of even and odd taps
    padded = jnp.pad(frames, ((before, 2 * (pairs + taps) - num_frames - before), (0, 0)))
    filters = jnp.pad(filters, ((0, 2 * taps - width), (0, 0), (0, 0)))
    even, odd, later = padded[0:-2:2], padded[1:-2:2], padded[2::2]
    first, second = filters[0::2], filters[1::2]
    # even frame: even * first + odd * second; odd frame: odd * first + later * second
    shared = _windows_times(odd, second - first)
    at_even = _windows_times(even + odd, first) + shared
    at_odd = _windows_times(odd + later, second) - shared
    return jnp.stack([at_even, at_odd], axis=1).reshape(2 * pairs, outputs)[:num_frames]


def _windows_times(frames: jax.Array, filters: jax.Array) -> jax.Array:
    """Returns the product [T - W + 1, O] of all windows of frames [T, I] with filters [W, I, O]."""
    width, inputs, outputs = filters.shape
    count = frames.shape[0] - width + 1
    windows = jnp.concatenate([frames[w : w + count] for w in range(width)], axis=1)
    return windows @ filters.reshape(width * inputs, outputs)


def max_pool(frames: jax.Array) -> jax.Array:
    """Returns the larger of every two frames: [T, C] -> [T / 2, C].

    Written as a maximum of two slices: XLA's CPU compiler merges a reduction with the dense layer after it into one
    kernel, which takes six times as long for a few clips.
    """
    return jnp.maximum(frames[0::POOLING], frames[1::POOLING])


def average_depool(frames: jax.Array) -> jax.Array:
    """Returns every frame twice and halved, which keeps the sum over time: [T, C] -> [2 T, C]."""
    return jnp.repeat(frames / POOLING, POOLING, axis=0)


def convolve_repeated(frames: jax.Array, filters: jax.Array) -> jax.Array:
    """Returns `convolve(jnp.repeat(frames, 2, axis=0), filters)`, at half of its cost.

    Two neighbouring taps that see the same frame are one tap with the sum of their filters. The even and the odd
    frames of the result are therefore two convolutions at half the frame rate, computed as one.

    Args:
        frames: [T, I].
        filters: [W, I, O], W odd.

    Returns:
        [2 T, O].
    """
    half = filters.shape[0] // 2
    before = (half + 1) // POOLING
    # Frame 2s + parity sees frame s + (parity + k) // 2 through the tap at k = -half to half.
    halves = [_merge_taps(filters, parity - half + POOLING * before) for parity in range(POOLING)]
    value = convolve(frames, jnp.concatenate(halves, axis=2), before)
    return value.reshape(POOLING * frames.shape[0], filters.shape[2])


def _merge_taps(filters: jax.Array, before: int) -> jax.Array:
    """Returns the sums of every two taps, after `before` taps of zero: [W, I, O] -> [taps, I, O]."""
    width, inputs, outputs = filters.shape
    taps = 2 * ((width // 2 + 1) // POOLING) + 1
    padded = jnp.pad(filters, ((before, POOLING * taps - width - before), (0, 0), (0, 0)))
    return padded.reshape(taps, POOLING, inputs, outputs).sum(axis=1)
