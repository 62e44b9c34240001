"""Feature-wise linear modulation: a scale and a shift of every hidden unit (Mason 2022 §4.2)."""

from __future__ import annotations

from typing import ClassVar, Self

import chex
import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.models.style import Norm, Style

# Added to the variance, so that a vector without variance is normalised to zero with a finite gradient. The trained
# networks' standard deviations before normalisation are 3 to 25: there it changes nothing that float32 can represent.
_MIN_VARIANCE = 1e-8


def layer_norm(f: jax.Array) -> jax.Array:
    """Returns f [H] with mean zero and population standard deviation one, as the authors' demo does (Mason 2022 Eq. 3).

    A vector without variance becomes zero, with a finite gradient.
    """
    centred = f - jnp.mean(f)
    return centred * jax.lax.rsqrt(jnp.mean(centred**2) + _MIN_VARIANCE)


def layer_norm_sample(f: jax.Array) -> jax.Array:
    """Returns f [H] normalised as in the authors' training code: by the sample standard deviation plus 1e-6."""
    centred = f - jnp.mean(f)
    variance = jnp.sum(centred**2) / (f.shape[0] - 1)
    return centred / (jnp.sqrt(variance + _MIN_VARIANCE) + 1e-6)


@struct.dataclass(kw_only=True)
class FiLMStyle(Style):
    """Scale γ and shift β of both hidden layers (Mason 2022 Eq. 2); row l belongs to hidden layer l + 1."""

    scale: jax.Array  # [2, H]
    shift: jax.Array  # [2, H]

    kind: ClassVar[str] = "film"

    @classmethod
    def init(cls, inputs: int, outputs: int, num_experts: int, *, rank: int = 30, key: jax.Array) -> Self:
        return cls.identity(outputs)

    @classmethod
    def identity(cls, hidden: int) -> Self:
        """Returns scale one and shift zero: the hidden layers are only normalised."""
        return cls(scale=jnp.ones((2, hidden)), shift=jnp.zeros((2, hidden)))

    @classmethod
    def from_vector(cls, vector: jax.Array) -> Self:
        """Returns the style of a vector [4H] in the authors' order: scale 1, shift 1, scale 2, shift 2."""
        parts = vector.reshape(2, 2, -1)
        return cls(scale=parts[:, 0], shift=parts[:, 1])

    def to_vector(self) -> jax.Array:
        """Returns the parameters [4H] in the authors' order: scale 1, shift 1, scale 2, shift 2."""
        return jnp.stack([self.scale, self.shift], axis=1).reshape(-1)

    def modulate(self, index: int, f: jax.Array, norm: Norm = layer_norm) -> jax.Array:
        """Returns the argument [H] of the ELU in Mason 2022 Eq. 3: γ ∘ norm(f) + β."""
        chex.assert_rank(f, 1)
        chex.assert_shape([self.scale, self.shift], (2, f.shape[0]))
        return self.scale[index] * norm(f) + self.shift[index]

    def named_arrays(self) -> dict[str, jax.Array]:
        return {"film": self.to_vector()}
