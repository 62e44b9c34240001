"""What this package expects of the installed JAX, and one version of it gets wrong."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np


def test_a_sum_over_products_of_many_rows_is_right():
    """In 0.10.2, compiled code for processors takes rows near the last from elsewhere (jax-ml/jax#39103)."""
    rows = np.zeros((40_000, 3), np.float32)
    rows[:, 0] = np.arange(len(rows))
    squares = jax.jit(jax.vmap(lambda row: jnp.sum((jnp.eye(3) @ row) ** 2)))(rows)
    np.testing.assert_allclose(squares, rows[:, 0] ** 2, rtol=1e-6)  # single precision
