"""The transformation network: three convolutions over time that transfer a clip into a style (Holden et al. 2017)."""

from __future__ import annotations

import chex
import jax
from flax import struct

from pfnn_jax.models.convolution import Convolution
from pfnn_jax.transfer.config import TransformationConfig


@struct.dataclass
class TransformationNetwork:
    """Three convolutions over the frames of a clip, with ReLU on all but the last.

    There is one network for each style. It is a pure function of one clip of any length; `jax.vmap` adds a batch.
    """

    layers: tuple[Convolution, Convolution, Convolution]

    def __call__(self, x: jax.Array, mask: jax.Array | None = None) -> jax.Array:
        """Returns the transferred clip [T, D] of a content x [T, D], both normalised.

        Args:
            x: zeros lie beyond its ends.
            mask: [T], 1 within a clip and 0 beyond its end, where a clip is padded to a longer one: the result is then
                that of the shorter clip. None where it is not padded.
        """
        chex.assert_shape(x, (None, self.layers[0].filters.shape[1]))
        within = 1.0 if mask is None else mask[:, None]
        first, second, last = self.layers
        value = jax.nn.relu(first(x * within)) * within
        return last(jax.nn.relu(second(value)) * within) * within

    @property
    def receptive_field(self) -> int:
        """Number of frames of a clip that one frame of the result depends on."""
        return 1 + sum(len(layer.filters) - 1 for layer in self.layers)


def init_transformation(config: TransformationConfig, size: int, *, key: jax.Array) -> TransformationNetwork:
    """Returns a freshly initialised network for rows of `size` numbers."""
    widths = (size, config.hidden, config.hidden, size)
    keys = jax.random.split(key, 3)
    layers = [
        Convolution.init(config.width, inputs, outputs, key=key)
        for inputs, outputs, key in zip(widths[:-1], widths[1:], keys, strict=True)
    ]
    return TransformationNetwork(layers=(layers[0], layers[1], layers[2]))
