"""Timing of functions within one run: interleaved repetitions, medians and quartiles."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np

Work = Callable[[], Any]
"""Does the work once and returns arrays, which the timer waits for."""


@dataclass(frozen=True)
class Figure:
    """One measured number.

    Attributes:
        section, name: what was measured.
        value: median over the repetitions.
        unit: unit of the value.
        low, high: quartiles over the repetitions.
        repetitions: number of measurements.
        aim: the value to reach, or None.
        at_most: whether the aim is an upper limit.
    """

    section: str
    name: str
    value: float
    unit: str
    low: float
    high: float
    repetitions: int
    aim: float | None = None
    at_most: bool = True

    @property
    def meets_aim(self) -> bool | None:
        """Whether the aim is reached; None without an aim."""
        if self.aim is None:
            return None
        return self.value <= self.aim if self.at_most else self.value >= self.aim

    def to_json(self) -> dict[str, Any]:
        """Returns the attributes and whether the aim is reached."""
        return {**asdict(self), "meets_aim": self.meets_aim}


def figure(
    section: str,
    name: str,
    values: np.ndarray,
    unit: str,
    *,
    at_most: float | None = None,
    at_least: float | None = None,
) -> Figure:
    """Returns the median and quartiles of repeated values [n], with at most one of the two kinds of aim."""
    low, value, high = np.percentile(values, (25, 50, 75))
    aim = at_most if at_least is None else at_least
    count = len(np.atleast_1d(values))
    return Figure(section, name, float(value), unit, float(low), float(high), count, aim, at_least is None)


REST = 0.2
"""Seconds after which the threads of NumPy, PyTorch and onnxruntime have stopped waiting for their next product."""


def interleave(
    works: Mapping[str, Work], repetitions: int, *, warm_up: bool = True, rest: float = 0.0
) -> dict[str, np.ndarray]:
    """Returns the seconds [n] of several works, interleaved so that a busy machine slows all of them equally.

    Args:
        works: works by name.
        repetitions: n.
        warm_up: whether to run each work once beforehand, so that it is compiled.
        rest: seconds to sleep before each measurement. Libraries whose threads wait without giving up their cores would
            slow the work after theirs; see `REST`.
    """
    if warm_up:
        for work in works.values():
            jax.block_until_ready(work())
    seconds = {name: np.empty(repetitions) for name in works}
    for repetition in range(repetitions):
        for name, work in works.items():
            time.sleep(rest)
            started = time.perf_counter()
            jax.block_until_ready(work())
            seconds[name][repetition] = time.perf_counter() - started
    return seconds


def machine() -> dict[str, Any]:
    """Returns the processor, its number of cores, and JAX's device."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "backend": jax.default_backend(),
        "device": jax.devices()[0].device_kind,
        "inline": not jax.config.read("jax_cpu_enable_async_dispatch"),
    }


def versions() -> dict[str, str]:
    """Returns the versions of Python and of the packages whose speed is measured."""
    packages = ("pfnn-jax", "jax", "jaxlib", "flax", "optax", "numpy", "scipy")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}


def _processor() -> str:
    """Returns the processor's name with its model numbers, because cloud machines often hide the name."""
    info = Path("/proc/cpuinfo")
    if not info.is_file():
        return platform.processor() or platform.machine()
    first = info.read_text(encoding="utf-8").split("\n\n")[0]
    fields = dict(
        line.split("\t", 1)[:1] + [line.split(":", 1)[1].strip()] for line in first.splitlines() if "\t" in line
    )
    known = [f"{key} {fields[key]}" for key in ("cpu family", "model") if key in fields]
    return ", ".join([fields.get("model name", platform.machine()), *known])
