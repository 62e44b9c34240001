"""Where JAX computes on processors: in a thread of its own, or in the one that calls."""

from __future__ import annotations

import jax


def dispatch_inline() -> None:
    """Makes JAX compute in the thread that calls a compiled function, for a program that waits for every frame.

    By default another thread computes, so that the caller can prepare the next call. Who waits for the result, as a
    game does for one frame of one character, waits for that thread to wake up as well: some 30 microseconds on an idle
    machine, several times as long on a busy one. Call this before the first computation; later it has no effect.
    """
    jax.config.update("jax_cpu_enable_async_dispatch", False)
