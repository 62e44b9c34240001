"""`pfnn-jax benchmark`: times on this machine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pfnn_jax.cli.command import Command


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    """Time training, learning, one frame, crowds, preparation and style transfer here, next to naive versions."""

    def run(self) -> Any:
        from pfnn_jax.benchmarks.suite import print_benchmark, run_benchmark
        from pfnn_jax.inference.dispatch import dispatch_inline

        dispatch_inline()
        result = run_benchmark()
        print_benchmark(result)
        return result
