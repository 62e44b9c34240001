"""Where parameters lie."""

from __future__ import annotations

from typing import Any

import jax


def commit(tree: Any) -> Any:
    """Commits arrays to this process's first device, where compiled functions leave what they return.

    A function that is called with uncommitted arrays at first, and with its own results then, is compiled twice.
    """
    return jax.device_put(tree, jax.local_devices()[0])
