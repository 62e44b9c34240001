"""How long does one frame take in an engine's formats?

Question: milliseconds of one evaluated frame by onnxruntime, by JAX and by NumPy, on one core, for the same network and
style; measured in turns, so that the machine's load falls on all alike.

Parent: Holden et al. 2017 §7 (a frame in about a millisecond).

    nice python -m experiments.export_speed RUN --style NAME
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

from pfnn_jax.inference.predictor import evaluate, make_predictor
from pfnn_jax.interop.export.batch import sample_rows
from pfnn_jax.interop.export.reference_loop import load_network
from pfnn_jax.interop.export.run import export_run
from pfnn_jax.run import load_run

ROUNDS = 300


def measure(run_path: Path, style: str | None) -> dict[str, float]:
    """Median milliseconds of one frame, by what evaluates it."""
    import onnxruntime

    run = load_run(run_path)
    x, phase = sample_rows(run.normaliser, run.layout, 1)
    predictor, compiled = make_predictor(run, style), jax.jit(evaluate)
    with tempfile.TemporaryDirectory() as folder:
        export_run(run_path, "onnx", Path(folder) / "onnx", style=style)
        told = export_run(run_path, "bins", Path(folder) / "bins", style=style)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        session = onnxruntime.InferenceSession(Path(folder) / "onnx" / "network.onnx", options)
        plain = load_network(Path(folder) / "bins", told)
    calls: dict[str, Callable[[], object]] = {
        "onnxruntime": lambda: session.run(None, {"x": x, "phase": phase}),
        "JAX": lambda: jax.block_until_ready(compiled(predictor, x[0], phase[0])),
        "NumPy (float64, reference loop)": lambda: plain(x[0], phase[0]),
    }
    times: dict[str, list[float]] = {name: [] for name in calls}
    for number in range(ROUNDS + 10):
        for name, call in calls.items():
            started = time.perf_counter()
            call()
            if number >= 10:  # the first ones compile and fill caches
                times[name].append(1e3 * (time.perf_counter() - started))
    return {name: float(np.median(values)) for name, values in times.items()}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Milliseconds of one frame in an engine's formats.")
    parser.add_argument("run", type=Path)
    parser.add_argument("--style")
    arguments = parser.parse_args()
    for name, value in measure(arguments.run, arguments.style).items():
        print(f"{name}: {value:.2f} ms")
