"""How long does one frame take with the formats for game engines?

Parent    Holden et al. 2017 §7: a frame takes about a millisecond.
Question  how many milliseconds does one frame of the same network and style take with onnxruntime, JAX and NumPy, on
          one core? Evaluations are interleaved, so that a busy machine slows all of them equally.
Run       nice python -m experiments.export_speed --run RUN --style NAME
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
import tyro

from pfnn_jax.inference.predictor import evaluate, make_predictor
from pfnn_jax.interop.export.batch import sample_rows
from pfnn_jax.interop.export.reference_loop import load_network
from pfnn_jax.interop.export.run import export_run
from pfnn_jax.run import load_run

WARM_UP = 10
"""Untimed repetitions, which compile and fill caches."""


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        run: run directory.
        style: a style of the run; without style by default.
        repetitions: number of measurements.
    """

    run: Path
    style: str | None = None
    repetitions: int = 300


def measure(config: Config) -> dict[str, float]:
    """Returns the median milliseconds of one frame, by runtime."""
    import onnxruntime

    run, style = load_run(config.run), config.style
    x, phase = sample_rows(run.normaliser, run.layout, 1)
    predictor, compiled = make_predictor(run, style), jax.jit(evaluate)
    with tempfile.TemporaryDirectory() as folder:
        export_run(config.run, "onnx", Path(folder) / "onnx", style=style)
        description = export_run(config.run, "bins", Path(folder) / "bins", style=style)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        session = onnxruntime.InferenceSession(Path(folder) / "onnx" / "network.onnx", options)
        plain = load_network(Path(folder) / "bins", description)
    calls: dict[str, Callable[[], object]] = {
        "onnxruntime": lambda: session.run(None, {"x": x, "phase": phase}),
        "JAX": lambda: jax.block_until_ready(compiled(predictor, x[0], phase[0])),
        "NumPy (float64, reference loop)": lambda: plain(x[0], phase[0]),
    }
    times: dict[str, list[float]] = {name: [] for name in calls}
    for number in range(config.repetitions + WARM_UP):
        for name, call in calls.items():
            started = time.perf_counter()
            call()
            if number >= WARM_UP:
                times[name].append(1e3 * (time.perf_counter() - started))
    return {name: float(np.median(values)) for name, values in times.items()}


def main(config: Config) -> dict[str, float]:
    """Measures and prints the milliseconds of one frame."""
    result = measure(config)
    for name, value in result.items():
        print(f"{name}: {value:.2f} ms")
    return result


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
