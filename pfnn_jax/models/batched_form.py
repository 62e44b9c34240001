"""Functions of one frame that are computed in another way for a batch of frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import jax

OneFrame = TypeVar("OneFrame", bound=Callable[..., jax.Array])


def with_batched_form(batched: OneFrame) -> Callable[[OneFrame], OneFrame]:
    """Returns a decorator for a function of one frame that under `vmap` of more than one is replaced by `batched`.

    Some layouts of a product are fast for one frame and slow for many, and the reverse. Both functions take and return
    one frame and compute the same values up to rounding. Derivatives are those of `batched`, with or without `vmap`.

    Args:
        batched: positional arguments to one array, as the decorated function.
    """

    def decorate(single: OneFrame) -> OneFrame:
        # A function of its own for each decoration: `custom_vmap` keeps the rule on it.
        call = jax.custom_batching.custom_vmap(lambda *args: single(*args))

        @call.def_vmap
        def _(axis_size, in_batched, *args):
            if axis_size == 1:  # compilers drop the axis, and are left with the form that is slow for one frame
                alone = jax.tree.map(lambda is_batched, leaf: leaf[0] if is_batched else leaf, in_batched, list(args))
                return call(*alone)[None], True
            axes = jax.tree.map(lambda is_batched: 0 if is_batched else None, tuple(in_batched))
            return jax.vmap(batched, in_axes=axes, axis_size=axis_size)(*args), True

        # `custom_vmap` has no reverse-mode derivative of its own.
        function = jax.custom_jvp(lambda *args: call(*args))
        function.defjvp(lambda primals, tangents: jax.jvp(batched, primals, tangents))
        return function  # pyright: ignore[reportReturnType]

    return decorate
