"""Feature-wise linear modulation: a style as a scale and a shift of every hidden unit (Mason 2022 §4.2)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias, TypeVar

import chex
import jax
import jax.numpy as jnp
from flax import struct

Tree = TypeVar("Tree")
Normalise: TypeAlias = Callable[[jax.Array], jax.Array]

# Inside the root, so that a vector without variance has the value zero and a finite gradient. The trained networks'
# deviations before normalisation are 3 to 25: there this changes nothing that float32 holds.
_NO_VARIANCE = 1e-8


@struct.dataclass(kw_only=True)
class FiLMStyle:
    """Scale γ and shift β of both hidden layers (Mason 2022 Eq. 2); row l belongs to hidden layer l + 1."""

    scale: jax.Array  # [2, H]
    shift: jax.Array  # [2, H]


def identity_film(hidden: int) -> FiLMStyle:
    """Scale one, shift zero: the hidden layers are normalised and nothing else."""
    return FiLMStyle(scale=jnp.ones((2, hidden)), shift=jnp.zeros((2, hidden)))


def film_from_vector(vector: jax.Array) -> FiLMStyle:
    """A style from its numbers [4H] in the authors' order: scale 1, shift 1, scale 2, shift 2."""
    parts = vector.reshape(2, 2, -1)
    return FiLMStyle(scale=parts[:, 0], shift=parts[:, 1])


def film_to_vector(film: FiLMStyle) -> jax.Array:
    """The numbers [4H] of a style in the authors' order: scale 1, shift 1, scale 2, shift 2."""
    return jnp.stack([film.scale, film.shift], axis=1).reshape(-1)


def layer_norm(f: jax.Array) -> jax.Array:
    """f [H] with mean zero and population deviation one, as the authors' run time (Mason 2022 Eq. 3).

    A vector without variance becomes zero, with a finite gradient.
    """
    centred = f - jnp.mean(f)
    return centred * jax.lax.rsqrt(jnp.mean(centred**2) + _NO_VARIANCE)


def layer_norm_sample(f: jax.Array) -> jax.Array:
    """As `layer_norm` with the authors' training statistics: deviation over H - 1, and 1e-6 added to it."""
    centred = f - jnp.mean(f)
    variance = jnp.sum(centred**2) / (f.shape[0] - 1)
    return centred / (jnp.sqrt(variance + _NO_VARIANCE) + 1e-6)


def modulate(film: FiLMStyle, layer_index: int, f: jax.Array, normalise: Normalise = layer_norm) -> jax.Array:
    """What stands inside the ELU of Mason 2022 Eq. 3: γ ∘ normalise(f) + β.

    Args:
        film: one style.
        layer_index: 0 or 1, the hidden layer.
        f: [H] output of that layer before any activation.
        normalise: `layer_norm`, or `layer_norm_sample`.

    Returns:
        [H] modulated features.
    """
    chex.assert_rank(f, 1)
    chex.assert_shape([film.scale, film.shift], (2, f.shape[0]))
    return film.scale[layer_index] * normalise(f) + film.shift[layer_index]


def mix(styles: Tree, weights: jax.Array) -> Tree:
    """A linear combination of styles of one kind, taken before modulation (Mason 2022 §5.1, barycentric weights).

    Args:
        styles: any tree whose leaves stack S styles, [S, ...].
        weights: [S], usually with sum one; a vertex gives that style.

    Returns:
        The tree with leaves [...].
    """
    chex.assert_rank(weights, 1)
    return jax.tree.map(lambda leaf: jnp.tensordot(weights, leaf, axes=1), styles)
