"""Matrix products of reduced precision, emulated where the processor has none: factors are rounded, sums are float32.

This is what tensor cores compute, up to the order of sums. XLA for CPUs accepts a lower precision and ignores it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
from jax.core import eval_jaxpr
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from pfnn_jax.training.config import Precision

MANTISSA_BITS: dict[Precision, int] = {"float32": 23, "tf32": 10, "bfloat16": 7}
EXPONENT_BITS = 8
"""Of all three formats."""

PRODUCTS = ("dot_general", "conv_general_dilated")

CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "custom_jvp_call": "call_jaxpr", "custom_vmap_call": "call"}
"""Calls of other programs, and the parameter that holds each; gradients are already part of a program."""


def round_products(function: Callable, precision: Precision) -> Callable:
    """Returns a function of arrays whose products, and those of its gradients if it computes any, have rounded factors.

    Raises:
        NotImplementedError: for a product inside a loop or a branch.
    """

    def rounded(*args: Any) -> Any:
        leaves, structure = jax.tree.flatten(args)
        closed, shape = jax.make_jaxpr(lambda *flat: function(*jax.tree.unflatten(structure, flat)), return_shape=True)(
            *leaves
        )
        return jax.tree.unflatten(jax.tree.structure(shape), _evaluate(closed, leaves, MANTISSA_BITS[precision]))

    return rounded


def _evaluate(closed: ClosedJaxpr, args: list[Any], bits: int) -> list[Any]:
    """Returns the results of a program with the factors of its products rounded to some mantissa bits."""
    values: dict[Any, Any] = dict(zip(closed.jaxpr.constvars, closed.consts, strict=True))
    values.update(zip(closed.jaxpr.invars, args, strict=True))

    def read(variable: Any) -> Any:
        return variable.val if isinstance(variable, Literal) else values[variable]

    for equation in closed.jaxpr.eqns:
        inputs, name = [read(variable) for variable in equation.invars], equation.primitive.name
        if name in PRODUCTS:
            inputs = [jax.lax.reduce_precision(value, EXPONENT_BITS, bits) for value in inputs]
        if name in CALLS:
            outputs = _evaluate(equation.params[CALLS[name]], inputs, bits)
        elif any(_has_product(part) for part in _parts(equation.params)):
            raise NotImplementedError(f"A product inside `{name}` is not rounded.")
        else:
            named = {v: value for v, value in zip(equation.invars, inputs, strict=True) if not isinstance(v, Literal)}
            alone = closed.jaxpr.replace(constvars=[], invars=[*named], outvars=equation.outvars, eqns=[equation])
            outputs = eval_jaxpr(alone, (), *named.values())
        values.update(zip(equation.outvars, outputs, strict=True))
    return [read(variable) for variable in closed.jaxpr.outvars]


def _parts(params: dict[str, Any]) -> list[Jaxpr]:
    """Returns the programs among an equation's parameters."""
    found = jax.tree.leaves(list(params.values()), is_leaf=lambda leaf: isinstance(leaf, ClosedJaxpr | Jaxpr))
    return [
        leaf.jaxpr if isinstance(leaf, ClosedJaxpr) else leaf for leaf in found if isinstance(leaf, ClosedJaxpr | Jaxpr)
    ]


def _has_product(program: Jaxpr) -> bool:
    return any(
        equation.primitive.name in PRODUCTS or any(_has_product(part) for part in _parts(equation.params))
        for equation in program.eqns
    )
