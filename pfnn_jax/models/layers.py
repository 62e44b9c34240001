"""Layers whose parameters are blended by coefficients c [K]: the one mathematics of networks and of style adapters.

Every record here is a linear map x -> y of a single frame. A network stacks them; a style adapter *is* one of
them, added to the second layer (Mason 2018 Eq. 4). Under `vmap` a blended layer is one matrix product over the
flattened c ⊗ x, so that no weight matrix of a single sample is ever built.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import chex
import jax
import jax.numpy as jnp
from flax import struct


@struct.dataclass(kw_only=True)
class BlendedLayer:
    """K full weight matrices: `y = Σ_k c_k (x W_k + b_k)`. As an adapter: the full residual."""

    weights: jax.Array  # [K, I, O]
    biases: jax.Array  # [K, O]

    @property
    def num_control_points(self) -> int:
        return self.biases.shape[0]


@struct.dataclass(kw_only=True)
class CPLayer:
    """A canonical polyadic decomposition: `y = A diag(D(c)) Bᵀ x + bias` (Mason 2018 Eq. 6).

    Only the diagonal is blended; the factors and the bias are the same at every phase, as in the authors' code.
    """

    a: jax.Array  # [O, R]
    b: jax.Array  # [I, R]
    d: jax.Array  # [K, R]
    bias: jax.Array  # [O]

    @property
    def num_control_points(self) -> int:
        return self.d.shape[0]


@struct.dataclass(kw_only=True)
class DiagonalLayer:
    """A blended diagonal matrix and bias: `y = Σ_k c_k (w_k ∘ x + b_k)`, I = O = H."""

    weights: jax.Array  # [K, H]
    biases: jax.Array  # [K, H]

    @property
    def num_control_points(self) -> int:
        return self.biases.shape[0]


@struct.dataclass(kw_only=True)
class BiasLayer:
    """A blended bias that ignores its input: `y = Σ_k c_k b_k`."""

    biases: jax.Array  # [K, H]

    @property
    def num_control_points(self) -> int:
        return self.biases.shape[0]


@struct.dataclass(kw_only=True)
class DenseLayer:
    """An ordinary layer `y = x W + b`, the same at every phase: it ignores the coefficients.

    As an adapter: the residual that Mason 2022 gives to networks without a global phase (§5.2.1).
    """

    weights: jax.Array  # [I, O]
    biases: jax.Array  # [O]


@struct.dataclass(kw_only=True)
class MixedLayer:
    """A weighted sum of C layers of one kind: `y = Σ_c w_c layer_c(x)`.

    As an adapter: a mixture of styles whose parameters stay shared under `vmap`, whatever each sample's weights.
    Layers of weight zero cost nothing where a single sample is evaluated.
    """

    layers: Any  # one of the other records, with leaves [C, ...]
    weights: jax.Array  # [C]


Layer: TypeAlias = BlendedLayer | CPLayer | DiagonalLayer | BiasLayer | DenseLayer


def linear(layer: Layer | MixedLayer, coefficients: jax.Array, x: jax.Array) -> jax.Array:
    """One frame through one layer.

    Args:
        layer: any of the six records.
        coefficients: [K] blending coefficients c (a dense layer ignores them, whatever their number).
        x: [I] input of one frame.

    Returns:
        [O] output, before any activation.
    """
    chex.assert_rank([coefficients, x], 1)
    match layer:
        case BlendedLayer(weights=weights, biases=biases):
            chex.assert_shape(weights, (coefficients.shape[0], x.shape[0], None))
            scaled = (coefficients[:, None] * x[None, :]).reshape(-1)
            return scaled @ weights.reshape(scaled.shape[0], -1) + coefficients @ biases
        case CPLayer(a=a, b=b, d=d, bias=bias):
            chex.assert_shape([b, d], [(x.shape[0], None), (coefficients.shape[0], None)])
            return a @ ((coefficients @ d) * (x @ b)) + bias
        case DiagonalLayer(weights=weights, biases=biases):
            chex.assert_shape(weights, (coefficients.shape[0], x.shape[0]))
            return (coefficients @ weights) * x + coefficients @ biases
        case BiasLayer(biases=biases):
            return coefficients @ biases
        case DenseLayer(weights=weights, biases=biases):
            chex.assert_shape(weights, (x.shape[0], None))
            return x @ weights + biases
        case MixedLayer(layers=layers, weights=weights):
            return _mixed(layers, weights, coefficients, x)
    raise TypeError(
        "`layer` must be a BlendedLayer, CPLayer, DiagonalLayer, BiasLayer, DenseLayer or MixedLayer, "
        f"got {type(layer).__name__}."
    )


def _mixed(layers: Any, weights: jax.Array, coefficients: jax.Array, x: jax.Array) -> jax.Array:
    """[O] the weighted sum of layers [C, ...], in a loop so that at no time more than one of them is read."""

    def output(index: int | jax.Array) -> jax.Array:
        return weights[index] * linear(jax.tree.map(lambda leaf: leaf[index], layers), coefficients, x)

    def add(index: jax.Array, total: jax.Array) -> jax.Array:
        return jax.lax.cond(weights[index] != 0.0, lambda: total + output(index), lambda: total)

    total = jax.eval_shape(output, 0)
    return jax.lax.fori_loop(0, weights.shape[0], add, jnp.zeros(total.shape, total.dtype))


def _uniform(key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    """Uniform in ± sqrt(6 / product of the last two sizes), as the authors initialise every weight."""
    bound = (6.0 / (shape[-1] * shape[-2])) ** 0.5
    return jax.random.uniform(key, shape, minval=-bound, maxval=bound)


def init_blended(key: jax.Array, num_control_points: int, inputs: int, outputs: int) -> BlendedLayer:
    """A blended layer [K, I, O] with the authors' uniform weights and zero biases."""
    return BlendedLayer(
        weights=_uniform(key, (num_control_points, inputs, outputs)),
        biases=jnp.zeros((num_control_points, outputs)),
    )


def init_cp(key: jax.Array, num_control_points: int, inputs: int, outputs: int, rank: int) -> CPLayer:
    """A CP layer of rank R with all three factors uniform.

    The uniform D is the authors' choice. D = 0 would start at the identity, but with factors this small its
    gradient is so weak that the layer barely trains at the paper's learning rate of 1e-4.
    """
    key_a, key_b, key_d = jax.random.split(key, 3)
    return CPLayer(
        a=_uniform(key_a, (outputs, rank)),
        b=_uniform(key_b, (rank, inputs)).T,
        d=_uniform(key_d, (num_control_points, 1, rank))[:, 0],
        bias=jnp.zeros(outputs),
    )


def init_diagonal(key: jax.Array, num_control_points: int, hidden: int) -> DiagonalLayer:
    """A diagonal layer with the authors' uniform weights and zero biases."""
    return DiagonalLayer(
        weights=_uniform(key, (num_control_points, 1, hidden))[:, 0],
        biases=jnp.zeros((num_control_points, hidden)),
    )


def init_bias(num_control_points: int, hidden: int) -> BiasLayer:
    """A bias layer of zeros: the identity as an adapter, and its gradient does not vanish there."""
    return BiasLayer(biases=jnp.zeros((num_control_points, hidden)))


def init_dense(key: jax.Array, inputs: int, outputs: int) -> DenseLayer:
    """A dense layer [I, O] with the authors' uniform weights and zero biases."""
    return DenseLayer(weights=_uniform(key, (inputs, outputs)), biases=jnp.zeros(outputs))
