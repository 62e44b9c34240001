"""The precision of matrix products in training; parameters, optimiser states and losses are float32 in any case."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import jax

from pfnn_jax.training.config import Precision

JAX_PRECISIONS: dict[Precision, str] = {
    "float32": "float32",
    # As a level and not as an algorithm: TPUs have no TF32, and take the next better product of three bfloat16 ones.
    "tf32": "tensorfloat32",
    # As an algorithm: JAX's level `bfloat16` is each device's fastest, on GPUs TF32. Convolutions know levels alone.
    "bfloat16": "BF16_BF16_F32",
}
"""What each precision is called by `jax.default_matmul_precision`; CPUs compute all of them in float32."""


def at_precision(function: Callable, precision: Precision) -> Callable:
    """Returns a function that computes its matrix products, and those of its gradients, in a precision.

    Args:
        function: called inside a compiled function, or compiled itself.
        precision: of the factors; sums are float32.
    """

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        with jax.default_matmul_precision(JAX_PRECISIONS[precision]):
            return function(*args, **kwargs)

    return call
