"""Compilation of characters: programs of thousands of small operations, which take longer to compile than to run."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

import jax
from jax.core import Tracer

QUICK: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False, "xla_cpu_parallel_codegen_split_count": 4}
"""Options of XLA's compiler for CPUs. Its fusion emitters take half of the time to compile a character's step, which
runs as fast without them (docs/results_appendix.md). Training needs them: its steps take 1.4 times as long without."""

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def jit_quickly(function: Callable[Arguments, Result], **options: Any) -> Callable[Arguments, Result]:
    """Returns a jitted function that compiles quickly on a CPU.

    Within functions that are themselves compiled or mapped, which decide for all that they call, it is the function.

    Args:
        function: to be compiled; it may be jitted.
        options: of `jax.jit`, such as `static_argnums`.

    Returns:
        The function; its attribute `compiled` returns what `jax.jit` has made of it.
    """

    @cache  # at the first call: a backend cannot be asked for when a module is imported
    def compiled() -> Callable[Arguments, Result]:
        return jax.jit(function, compiler_options=_quick_options(), **options)

    @wraps(function)
    def call(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((args, kwargs))):
            return function(*args, **kwargs)
        return compiled()(*args, **kwargs)

    vars(call)["compiled"] = compiled
    return call


@cache
def _quick_options() -> dict[str, Any] | None:
    """Returns the options for the default backend, or None where it is not a CPU or XLA does not know them."""
    if jax.default_backend() != "cpu":
        return None
    try:
        jax.jit(lambda: 0, compiler_options=QUICK).lower().compile()
    except jax.errors.JaxRuntimeError:
        return None
    return QUICK
