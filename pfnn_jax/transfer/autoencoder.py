"""The motion autoencoder: one convolution with pooling, and its inverse (Holden 2016 §4; Holden 2017, Eq. 1 and 2)."""

from __future__ import annotations

import chex
import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.models.convolution import POOLING, Convolution, convolve_repeated, max_pool
from pfnn_jax.transfer.config import AutoencoderConfig


@struct.dataclass(kw_only=True)
class MotionAutoencoder:
    """Parameters of a motion autoencoder. All rows are normalised, T is even, and zeros lie beyond both ends.

    Functions are for one clip; use `jax.vmap` for many.

    Attributes:
        encoder: filters [W, D, F] and bias b0 [F].
        decoder: filters [W, F, D] and bias [D], as in the released network; None where it is tied to the encoder, as
            in the paper.
    """

    encoder: Convolution
    decoder: Convolution | None = None

    def encode(self, x: jax.Array) -> jax.Array:
        """Returns the hidden units [T / 2, F] of rows x [T, D]: Eq. 1."""
        chex.assert_shape(x, (None, self.encoder.filters.shape[1]))
        chex.assert_is_divisible(x.shape[0], POOLING)
        return jax.nn.relu(max_pool(self.encoder(x)))

    def decode(self, hidden: jax.Array, mask: jax.Array | None = None) -> jax.Array:
        """Returns the rows [T, D] of hidden units [T / 2, F]: Eq. 2, with average depooling.

        Args:
            hidden: hidden units.
            mask: [T / 2], 1 within a clip and 0 beyond its end, where a clip is padded to a longer one: its rows are
                then those of the shorter clip. None where it is not padded.
        """
        chex.assert_shape(hidden, (None, self.encoder.filters.shape[2]))
        # Depooled frames come in equal pairs, so the convolution is computed from the halved frames before they are
        # repeated; `average_depool` and a convolution are the same, at twice the cost.
        value = hidden / POOLING
        if self.decoder is None:
            value = value - self.encoder.bias[None]
        if mask is not None:
            value = value * mask[:, None]
        if self.decoder is None:
            return convolve_repeated(value, transposed(self.encoder.filters))
        return convolve_repeated(value, self.decoder.filters) + self.decoder.bias[None]

    def project(self, x: jax.Array) -> jax.Array:
        """Returns the reconstruction [T, D] of rows x [T, D]: the nearest motion that the hidden units can express."""
        return self.decode(self.encode(x))


def transposed(filters: jax.Array) -> jax.Array:
    """Returns the filters [W, O, I] of the adjoint of a convolution with filters [W, I, O], W odd."""
    return jnp.flip(filters, axis=0).swapaxes(1, 2)


def init_autoencoder(config: AutoencoderConfig, size: int, *, key: jax.Array) -> MotionAutoencoder:
    """Returns a freshly initialised autoencoder of rows of `size` numbers: Glorot-uniform filters, zero biases."""
    keys = jax.random.split(key)
    encoder = Convolution.init(config.width, size, config.filters, key=keys[0])
    decoder = None if config.tied else Convolution.init(config.width, config.filters, size, key=keys[1])
    return MotionAutoencoder(encoder=encoder, decoder=decoder)


def config_of(autoencoder: MotionAutoencoder) -> AutoencoderConfig:
    """Returns the sizes of an autoencoder."""
    width, _, filters = autoencoder.encoder.filters.shape
    return AutoencoderConfig(filters, width, autoencoder.decoder is None)
