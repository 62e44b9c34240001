"""Which batch size and learning rate reach the same loss in the least time on a CPU?

Parent    Mason 2018 §7: minibatches of 32 frames, Adam at 1e-4, 25 epochs of 184,832 frames of 8 styles.
Question  how much processor time does pretraining take to the held-out error that the paper's setting has at its end,
          at other batch sizes and learning rates?
Data      8 procedural styles, of each `--seconds-per-style` seconds, not mirrored; a tenth of every clip is held out.
          Reduced: one minute of each style where the paper has 6.4, and at most `--frames` frames of training.
Measured  mean squared normalised error on the held-out rows, without dropout, along each training; the processor time
          of both cores up to there, without compilation and without measuring. A training ends at the paper's error.
Expect    see docs/results_appendix.md.
Run       python -m experiments.batch_size --out runs/batch_size
          About 10 minutes of processor time.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from matplotlib.figure import Figure

from experiments.common.markdown import markdown_table
from experiments.common.results_files import write_results
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.synthetic.styles import PRETRAINING_STYLES
from pfnn_jax.motion.synthetic.walks import synthetic_clips
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.data import Batch, Rows, evenly_spaced
from pfnn_jax.training.loop import Progress, TrainState
from pfnn_jax.training.pretraining import pretrain
from pfnn_jax.training.steps import PretrainParams, predict_batch

HELD_OUT_ROWS = 256
"""Rows of each style that the error is measured on."""

MEASUREMENTS = 40
"""Measurements of the error along a full training."""


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        out: folder of results.
        batch_sizes: frames of a minibatch; the first is the paper's.
        learning_rates: of Adam; the first is the paper's.
        frames: largest number of frames that a training sees.
        seconds_per_style: seconds of procedural motion of each style.
        hidden: H.
        seed: of initialisation, shuffling and dropout.
    """

    out: Path
    batch_sizes: tuple[int, ...] = (32, 64, 128, 256, 512)
    learning_rates: tuple[float, ...] = (1e-4, 3e-4, 1e-3, 3e-3)
    frames: int = 200_000
    seconds_per_style: float = 60.0
    hidden: int = 512
    seed: int = 0


class Reached(Exception):
    """Ends a training whose error is small enough."""


class Recorder:
    """Measures a training from its callback: frames seen, processor seconds and held-out error.

    Args:
        held_out: rows [S, N, ...] of all styles.
        batch_size: B.
        target: error that ends the training.
    """

    def __init__(self, held_out: Batch, batch_size: int, target: float):
        self.held_out, self.batch_size, self.target = held_out, batch_size, target
        self.curve: list[dict[str, float]] = []
        self._seconds, self._started = 0.0, time.process_time()

    def __call__(self, state: TrainState, progress: Progress) -> None:
        chunk = time.process_time() - self._started
        if len(self.curve) == 1:  # the first chunk compiled: it is taken to cost what the second does
            self._seconds = self.curve[0]["seconds"] = chunk
        self._seconds += chunk
        error = float(held_out_error(state.params, self.held_out))
        frames = progress.step * self.batch_size
        self.curve.append({"frames": frames, "seconds": self._seconds, "error": error})
        if error <= self.target and len(self.curve) > 1:
            raise Reached
        self._started = time.process_time()


@jax.jit
def held_out_error(params: PretrainParams, held_out: Batch) -> jax.Array:
    """Returns the mean squared normalised error [] over the rows [S, N, ...] of all styles, without dropout."""

    def one(style: Any, batch: Batch) -> jax.Array:
        return jnp.mean((predict_batch(params.shared, style, batch, None, None) - batch.y) ** 2)

    return jnp.mean(jax.vmap(one)(params.modulation, held_out))


def load_data(config: Config) -> tuple[Rows, Batch]:
    """Returns the rows to train on, and held-out rows [S, N, ...]."""
    clips = [clip for style in PRETRAINING_STYLES for clip in synthetic_clips(style, config.seconds_per_style, 0)]
    with tempfile.TemporaryDirectory() as folder:
        dataset = prepare(clips, Path(folder) / "data", PrepareConfig(mirror=False, validation=0.1))
        held = [
            rows.take(evenly_spaced(rows.first_row[-1], HELD_OUT_ROWS))
            for rows in (Rows.from_dataset(dataset, [style], split="validation") for style in dataset.styles)
        ]
        return Rows.from_dataset(dataset), jax.tree.map(lambda *leaves: jnp.stack(leaves), *held)


def train(config: Config, rows: Rows, held_out: Batch, batch_size: int, rate: float, target: float) -> dict[str, Any]:
    """Returns one training's setting and its curve, which ends at the target."""
    steps = config.frames // batch_size
    settings = PretrainConfig(
        hidden=config.hidden,
        batch_size=batch_size,
        learning_rate=rate,
        steps=steps,
        steps_per_dispatch=max(1, steps // MEASUREMENTS),
        seed=config.seed,
    )
    recorder = Recorder(held_out, batch_size, target)
    try:
        pretrain(rows, settings, state_callback=recorder)
    except Reached:
        pass
    return {"batch_size": batch_size, "learning_rate": rate, "curve": recorder.curve}


def run(config: Config) -> dict[str, Any]:
    """Trains with every setting, the paper's first, and writes `results.json`, `table.md` and `batch_size.png`."""
    rows, held_out = load_data(config)
    settings = [(size, rate) for size in config.batch_sizes for rate in config.learning_rates]
    trainings: list[dict[str, Any]] = []
    target = 0.0
    for size, rate in settings:
        trainings.append(train(config, rows, held_out, size, rate, target))
        if not target:
            target = trainings[0]["curve"][-1]["error"]
        last = trainings[-1]["curve"][-1]
        print(f"batch {size}, rate {rate:g}: error {last['error']:.4f} after {last['seconds']:.0f} s", flush=True)
    result = write_results(config, table(config, target, trainings), target=target, trainings=trainings)
    plot(config, result).savefig(config.out / "batch_size.png", dpi=120)
    return result


def seconds_to(curve: list[dict[str, float]], error: float) -> float | None:
    """Returns the processor seconds after which a training first has an error this small; None if it never has."""
    return next((point["seconds"] for point in curve if point["error"] <= error), None)


def table(config: Config, target: float, trainings: list[dict[str, Any]]) -> str:
    """Returns processor seconds to twice the target and to the target as a Markdown table, by batch size."""
    found = {(one["batch_size"], one["learning_rate"]): one["curve"] for one in trainings}

    def cell(curve: list[dict[str, float]]) -> str:
        seconds = (seconds_to(curve, error) for error in (2 * target, target))
        return ", ".join("–" if value is None else f"{value:.1f} s" for value in seconds)

    header = ["batch size", *(f"{rate:g}" for rate in config.learning_rates)]
    return markdown_table(
        header,
        [[str(size), *(cell(found[size, rate]) for rate in config.learning_rates)] for size in config.batch_sizes],
    )


def plot(config: Config, result: dict[str, Any]) -> Figure:
    """Draws the error along each batch size's fastest training, and the time to twice the target of all."""
    figure, target = Figure(figsize=(10, 4), layout="constrained"), result["target"]
    curves, times = figure.subplots(1, 2)
    for size in config.batch_sizes:
        own = [one for one in result["trainings"] if one["batch_size"] == size]
        best = min(own, key=lambda one: seconds_to(one["curve"], 2 * target) or np.inf)
        points = best["curve"]
        label = f"batch {size}, rate {best['learning_rate']:g}"
        curves.plot([point["seconds"] for point in points], [point["error"] for point in points], label=label)
    curves.axhline(target, color="grey", linestyle=":", label="the paper's setting at its end")
    curves.set(xlabel="processor time (s)", ylabel="held-out error", yscale="log", xscale="log")
    curves.set_ylim(bottom=target / 8)  # room for the legend
    curves.legend(fontsize=8, loc="lower left")
    for rate in config.learning_rates:
        own = [one for one in result["trainings"] if one["learning_rate"] == rate]
        reached = [(one["batch_size"], seconds_to(one["curve"], 2 * target)) for one in own]
        points = [(size, seconds) for size, seconds in reached if seconds is not None]
        times.plot([size for size, _ in points], [seconds for _, seconds in points], marker="o", label=f"rate {rate:g}")
    times.set(xlabel="batch size", ylabel="processor time to twice that error (s)", xscale="log", ylim=(0, None))
    times.set_xticks(config.batch_sizes, [str(size) for size in config.batch_sizes])
    times.minorticks_off()
    times.legend(fontsize=8)
    return figure


if __name__ == "__main__":
    run(tyro.cli(Config))
