"""Lowers compiled functions for other platforms in place of running them.

    with lowering(platforms) as lowered:
        pretrain(rows, config)
    assert "pfnn_jax.training.loop.scan" in lowered
    assert "stablehlo.dot_general" in lowered["pfnn_jax.training.loop.scan"]

Inside the block every function that `jax.jit` has compiled in the package is exported for the platforms, with the
arguments that the package itself gives it, and returns ones of the right shapes. Nothing is compiled.
"""

from __future__ import annotations

import importlib
import pkgutil
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from typing import Any

import jax
import jax.export
import jax.numpy as jnp
import pytest
from jax.core import Tracer

import pfnn_jax

PLATFORMS = ("cuda", "tpu")

FORBIDDEN = {
    "a host callback": r"custom_call @\w*callback",
    "a number of 64 bits": r"[<x]f64[,>]",
    "a dynamic shape": r"tensor<(?:\d+x)*\?",
}
"""What must not stand in a program, by the pattern that finds it in StableHLO."""

Jitted = type(jax.jit(lambda: None))


def name_of(function: Callable) -> str:
    """Returns the module and the qualified name of a function, without the function that it is defined in."""
    return f"{function.__module__}.{function.__qualname__.rsplit('.', 1)[-1]}"


def compiled_functions(packages: Sequence[str]) -> dict[str, Any]:
    """Returns the functions of some packages that are compiled where they are defined, by name."""
    found = {}
    for package in packages:
        root = importlib.import_module(f"pfnn_jax.{package}")
        for module in pkgutil.walk_packages(root.__path__, f"{root.__name__}."):
            for value in vars(importlib.import_module(module.name)).values():
                if isinstance(value, Jitted) and value.__module__ == module.name:
                    found[name_of(value)] = value
    return found


def lower(function: Any, platforms: Sequence[str], *args: Any, **kwargs: Any) -> jax.export.Exported:
    """Returns a compiled function lowered for some platforms; refuses what must not stand in a program."""
    exported = jax.export.export(function, platforms=platforms)(*args, **kwargs)
    program = exported.mlir_module()
    for what, pattern in FORBIDDEN.items():
        found = re.search(pattern, program)
        assert found is None, f"{name_of(function)} contains {what}: {program[found.start() :].splitlines()[0]}"
    return exported


@contextmanager
def lowering(packages: Sequence[str], platforms: Sequence[str] = PLATFORMS) -> Iterator[dict[str, str]]:
    """Replaces the compiled functions of some packages; yields the programs of those lowered last, by name."""
    lowered: dict[str, str] = {}

    def replaced(function: Any, named: Callable) -> Callable:
        @wraps(named)
        def call(*args: Any, **kwargs: Any) -> Any:
            if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((args, kwargs))):
                return function(*args, **kwargs)  # inside another compiled function, which is lowered as a whole
            exported = lower(function, platforms, *args, **kwargs)
            lowered[name_of(named)] = exported.mlir_module()
            ones = [jnp.ones(aval.shape, aval.dtype) for aval in exported.out_avals]
            return jax.tree.unflatten(exported.out_tree, ones)

        return call

    jit = jax.jit

    def jit_and_lower(function: Callable, **options: Any) -> Any:
        compiled = jit(function, **options)
        inner = getattr(function, "func", function)  # of a `functools.partial`
        return replaced(compiled, inner) if inner.__module__.startswith("pfnn_jax.") else compiled

    wrappers = {id(function): replaced(function, function) for function in compiled_functions(packages).values()}
    modules = [module for name, module in sys.modules.items() if name.startswith(pfnn_jax.__name__)]
    with pytest.MonkeyPatch.context() as patch:
        for module in modules:
            for name, value in list(vars(module).items()):
                jitted = getattr(value, "__wrapped__", None)  # by `jit_quickly`, with options of its own
                for known in (value, jitted) if isinstance(jitted, Jitted) else (value,):
                    if id(known) in wrappers:
                        patch.setattr(module, name, wrappers[id(known)])
        patch.setattr(jax, "jit", jit_and_lower)
        yield lowered
