"""What a style is: where it acts on the shared network, and how several styles are mixed.

A network computes `third(act(second(act(first(x)))))`. A style acts at four places, the hooks `after_first`,
`after_second`, `after_third` and `modulate` of `Style`, each of which changes nothing by default. A residual adapter is
a `Layer` whose output is added to the second layer's (Mason 2018 Eq. 4), an output adapter is added to the third's, a
one-hot style shifts the first layer, and FiLM modulates both hidden layers.

Mixing by barycentric weights (Mason 2022 §4.4) means that a mixture adds the weighted sum of what its styles add.
There are two forms of it, which compute the same function:

- `Style.mix` returns one style of the same kind. It suits weights that stay fixed: a mixture then costs as much as one
  style. A style that is linear in its parameters is mixed by a weighted sum of parameters; a CP layer is not, because
  its factors multiply each other, and mixing S layers of rank R gives one layer of rank S R.
- `Style.mix_dynamic` suits weights that change from frame to frame or differ between the samples of a batch. A layer
  becomes a `MixedLayer`, which sums outputs: under `vmap` no sample needs its own weight matrix, and styles of
  weight zero cost nothing where a single sample is evaluated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Self, TypeAlias, TypeVar

import chex
import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.models.batched_form import with_batched_form
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.layers import register_style, style_class

Tree = TypeVar("Tree")
StyleBank = TypeVar("StyleBank", bound="Style")
Drop: TypeAlias = Callable[[jax.Array], jax.Array]
Norm: TypeAlias = Callable[[jax.Array], jax.Array]
Affine: TypeAlias = tuple[Any, Any]
"""Weights [O, I] (a scalar zero where there are none) and biases [O], of NumPy or JAX."""


class Style:
    """What one style changes in the shared network.

    Subclasses are records of arrays (`flax.struct.dataclass`). One that declares a `kind` is registered under it.

    Attributes:
        kind: the name in `AdapterConfig` and in run directories.
        foldable: whether a lookup table adds the style into the network's matrices; otherwise it is evaluated
            separately. Only for styles with `affine_terms`.
    """

    kind: ClassVar[str]
    foldable: ClassVar[bool] = False

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "kind" in vars(cls):
            register_style(cls)

    @classmethod
    def init(cls, inputs: int, outputs: int, num_experts: int, *, rank: int = 30, key: jax.Array) -> Self:
        """Returns freshly initialised parameters.

        Args:
            inputs, outputs: I and O of the layer; both are H for most styles, see `for_network`.
            num_experts: K.
            rank: R of CP factors.
            key: random key. A kind ignores the arguments that it has no use for.
        """
        raise NotImplementedError

    @classmethod
    def for_network(cls, sizes: NetworkConfig, *, rank: int = 30, key: jax.Array) -> Self:
        """Returns freshly initialised parameters for a network: `init` with H, H and K, unless it acts elsewhere."""
        return cls.init(sizes.hidden, sizes.hidden, sizes.num_control_points, rank=rank, key=key)

    @property
    def config(self) -> AdapterConfig:
        """The configuration that `init_style` makes such a style from."""
        return AdapterConfig(kind=self.kind)

    def after_first(self, f: jax.Array, coefficients: jax.Array, x: jax.Array, drop: Drop) -> jax.Array:
        """Returns the first layer's output with the style.

        Args:
            f: [H] output of the network's first layer, before any activation.
            coefficients: [K] blending coefficients.
            x: [I] input of that layer, without dropout.
            drop: the style's dropout; the identity at run time.
        """
        return f

    def after_second(self, f: jax.Array, coefficients: jax.Array, hidden: jax.Array, drop: Drop) -> jax.Array:
        """Returns the second layer's output with the style.

        Args:
            f: [H] output of the network's second layer, before any activation.
            coefficients, drop: as in `after_first`.
            hidden: [H] input of that layer, without dropout.
        """
        return f

    def after_third(self, y: jax.Array, coefficients: jax.Array, hidden: jax.Array, drop: Drop) -> jax.Array:
        """Returns the network's normalised output with the style.

        Args:
            y: [O] output of the network's third layer.
            coefficients, drop: as in `after_first`.
            hidden: [H] input of that layer, without dropout.
        """
        return y

    def modulate(self, index: int, f: jax.Array, norm: Norm) -> jax.Array:
        """Returns what enters the activation of hidden layer `index` (0 or 1), from that layer's output f [H]."""
        return f

    def at(self, coefficients: jax.Array) -> Style:
        """Returns the style at coefficients [K], as a style of one control point; other arrays are shared."""
        return self

    def affine_terms(self, coefficients: Any) -> Mapping[int, Affine]:
        """Returns what the style adds to the network's layers at coefficients [K], by the layer's index.

        Raises:
            TypeError: for a style that does more than add affine maps.
        """
        raise TypeError(f"A style of kind {self.kind} does not only add to layers.")

    def mix(self, weights: jax.Array) -> Self:
        """Returns the mixture of a bank of S styles (leaves [S, ...]) by fixed weights [S], as one style.

        By default the weighted sum of parameters, for styles that are linear in them. Weights usually sum to one.
        """
        return weighted_sum(self, weights)

    def mix_dynamic(self, weights: jax.Array) -> Style:
        """Returns the mixture of a bank of S styles by weights [S] that change from frame to frame."""
        return self.mix(weights)

    def named_arrays(self) -> dict[str, jax.Array]:
        """Returns the style's arrays by the names of their fields."""
        leaves, _ = jax.tree_util.tree_flatten_with_path(self)
        return {path[-1].name: leaf for path, leaf in leaves}


class Layer(Style):
    """A linear map of one frame whose parameters may be blended by coefficients c [K].

    A network stacks layers; as a style, a layer is a residual on the second layer (Mason 2018 Eq. 4).
    """

    def __call__(self, coefficients: jax.Array, x: jax.Array) -> jax.Array:
        """Returns the output [O], before any activation, for coefficients [K] and the input x [I] of one frame."""
        raise NotImplementedError

    def affine(self, coefficients: Any) -> Affine:
        """Returns the layer at coefficients [K] as weights [O, I] and biases [O].

        Computes with the arrays' own library and precision, so that exporters may use float64 NumPy arrays.
        """
        raise NotImplementedError

    def after_second(self, f: jax.Array, coefficients: jax.Array, hidden: jax.Array, drop: Drop) -> jax.Array:
        return f + self(coefficients, drop(hidden))

    def affine_terms(self, coefficients: Any) -> Mapping[int, Affine]:
        return {1: self.affine(coefficients)}

    def mix_dynamic(self, weights: jax.Array) -> Style:
        return MixedLayer(layers=self, weights=weights)


def _sum_of_all(layers: Any, weights: jax.Array, coefficients: jax.Array, x: jax.Array) -> jax.Array:
    """Returns the sum [O] of S layers (leaves [S, ...]) by weights [S]. A scan, so that one layer is read at a time."""

    def add(total: jax.Array, part: tuple[jax.Array, Any]) -> tuple[jax.Array, None]:
        weight, layer = part
        return total + weight * layer(coefficients, x), None

    return jax.lax.scan(add, _no_output(layers, coefficients, x), (weights, layers))[0]


@with_batched_form(_sum_of_all)
def _sum_of_used(layers: Any, weights: jax.Array, coefficients: jax.Array, x: jax.Array) -> jax.Array:
    """Returns the same as `_sum_of_all`, and reads only layers whose weight is not 0.

    Not under `vmap`, where a condition that differs between samples would gather a layer for each of them.
    """

    def add(index: jax.Array, total: jax.Array) -> jax.Array:
        def used() -> jax.Array:
            layer = jax.tree.map(lambda leaf: leaf[index], layers)
            return total + weights[index] * layer(coefficients, x)

        return jax.lax.cond(weights[index] != 0.0, used, lambda: total)

    return jax.lax.fori_loop(0, len(weights), add, _no_output(layers, coefficients, x))


def _no_output(layers: Any, coefficients: jax.Array, x: jax.Array) -> jax.Array:
    """Returns zeros [O] in the form of the output of one of S layers."""
    output = jax.eval_shape(lambda: jax.tree.map(lambda leaf: leaf[0], layers)(coefficients, x))
    return jnp.zeros(output.shape, output.dtype)


@struct.dataclass(kw_only=True)
class MixedLayer(Layer):
    """A weighted sum of S layers of one kind: `y = Σ_s w_s layer_s(x)`; see `Style.mix_dynamic`."""

    layers: Any  # a `Layer` with leaves [S, ...]
    weights: jax.Array  # [S]

    def __call__(self, coefficients: jax.Array, x: jax.Array) -> jax.Array:
        return _sum_of_used(self.layers, self.weights, coefficients, x)

    def at(self, coefficients: jax.Array) -> MixedLayer:
        return MixedLayer(layers=jax.vmap(lambda layer: layer.at(coefficients))(self.layers), weights=self.weights)


@struct.dataclass
class StyleSum(Style):
    """Several styles that act one after another, e.g. a bank whose styles are of several kinds.

    A bank of S styles has S rows in every part; a style is zero in the parts of other kinds than its own, where it
    therefore adds nothing.
    """

    parts: tuple[Style, ...]

    def after_first(self, f: jax.Array, coefficients: jax.Array, x: jax.Array, drop: Drop) -> jax.Array:
        for part in self.parts:
            f = part.after_first(f, coefficients, x, drop)
        return f

    def after_second(self, f: jax.Array, coefficients: jax.Array, hidden: jax.Array, drop: Drop) -> jax.Array:
        for part in self.parts:
            f = part.after_second(f, coefficients, hidden, drop)
        return f

    def after_third(self, y: jax.Array, coefficients: jax.Array, hidden: jax.Array, drop: Drop) -> jax.Array:
        for part in self.parts:
            y = part.after_third(y, coefficients, hidden, drop)
        return y

    def at(self, coefficients: jax.Array) -> StyleSum:
        return StyleSum(tuple(part.at(coefficients) for part in self.parts))

    def affine_terms(self, coefficients: Any) -> Mapping[int, Affine]:
        terms: dict[int, Affine] = {}
        for part in self.parts:
            for index, (weights, biases) in part.affine_terms(coefficients).items():
                before = terms.get(index, (0.0, 0.0))
                terms[index] = (before[0] + weights, before[1] + biases)
        return terms

    def mix(self, weights: jax.Array) -> StyleSum:
        return StyleSum(tuple(part.mix(weights) for part in self.parts))

    def mix_dynamic(self, weights: jax.Array) -> StyleSum:
        return StyleSum(tuple(part.mix_dynamic(weights) for part in self.parts))

    def named_arrays(self) -> dict[str, jax.Array]:
        return {
            f"{name}_{index}": array
            for index, part in enumerate(self.parts)
            for name, array in part.named_arrays().items()
        }


def is_additive(style: Style) -> bool:
    """Returns whether a style only adds affine maps, so that one of zeros changes nothing and it fits a `StyleSum`."""
    return type(style).affine_terms is not Style.affine_terms


def init_style(config: AdapterConfig, sizes: NetworkConfig, *, key: jax.Array) -> Style:
    """Returns a freshly initialised style for a network of the given sizes.

    Bias and one-hot styles start at zero and FiLM at scale 1 and shift 0; the others with the authors' small uniform
    weights.
    """
    return style_class(config.kind).for_network(sizes, rank=config.rank, key=key)


def init_bank(config: AdapterConfig, sizes: NetworkConfig, num_styles: int, *, key: jax.Array) -> Style:
    """Returns S freshly initialised styles of the configured kind, stacked: leaves [S, ...]."""
    keys = jax.random.split(key, num_styles)
    return jax.vmap(lambda k: init_style(config, sizes, key=k))(keys)


def mix_styles(bank: StyleBank, weights: jax.Array) -> StyleBank:
    """Returns the mixture of S styles of one kind, stacked (leaves [S, ...]), by fixed weights [S]; see `Style.mix`."""
    return bank.mix(weights)


def weighted_sum(trees: Tree, weights: jax.Array) -> Tree:
    """Returns the sum over the first axis of every leaf [S, ...], weighted by `weights` [S]."""
    chex.assert_rank(weights, 1)
    return jax.tree.map(lambda leaf: jnp.tensordot(weights, leaf, axes=1), trees)


def small_uniform(key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    """Draws uniform weights in ± sqrt(6 / product of the last two sizes), the initialisation of the authors' code."""
    bound = (6.0 / (shape[-1] * shape[-2])) ** 0.5
    return jax.random.uniform(key, shape, minval=-bound, maxval=bound)
