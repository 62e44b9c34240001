"""What do products of fewer bits do to a network's outputs, to its training, and to its walks?

Parent    float32, in which the papers' networks are trained and evaluated.
Question  `pretrain --precision tf32` and `bfloat16` round the factors of matrix products on GPUs and TPUs. How far are
          outputs from float64, which error does a training reach, and do the trained styles still walk circles?
Data      the authors' PFNN and LPN with their golden rows in float64 (`--reference`); 8 procedural styles.
Measured  emulated: factors rounded to 10 or 7 bits of mantissa, sums in float32 (`common/rounded_products.py`).
          A CPU computes in float32 whatever is asked. Parameters, Adam and losses are float32. Trainings see the same
          minibatches and masks; walks are evaluated in float32, on circles at 45 degrees per second.
Expect    see docs/scale.md.
Run       python -m experiments.precision --reference FOLDER --out runs/precision
          About 3 minutes of processor time.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
import optax
import tyro

from experiments.common.markdown import markdown_table
from experiments.common.results_files import write_results
from experiments.common.rounded_products import round_products
from pfnn_jax.control.stability import make_stability_check
from pfnn_jax.inference.predictor import evaluate, make_predictor
from pfnn_jax.interop.released.holden2017 import import_released_pfnn
from pfnn_jax.interop.released.mason2022 import STYLES, import_released_lpn
from pfnn_jax.models.style import Style
from pfnn_jax.motion.datasets.dataset import Dataset
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.synthetic.styles import PRETRAINING_STYLES
from pfnn_jax.motion.synthetic.walks import synthetic_clips
from pfnn_jax.run import load_style
from pfnn_jax.training.config import Precision, PretrainConfig
from pfnn_jax.training.data import Batch, Rows, evenly_spaced, make_gather
from pfnn_jax.training.loop import TrainState, scan_steps
from pfnn_jax.training.losses import Objective
from pfnn_jax.training.order import order_of
from pfnn_jax.training.pretraining import POSE_NOISE, init_state
from pfnn_jax.training.steps import Frozen, equal_dropout, make_pretrain_step, predict_batch, with_pose_noise

PRECISIONS: tuple[Precision, ...] = get_args(Precision)

HELD_OUT_ROWS = 256
"""Rows of each style that the error is measured on."""


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        out: folder of results.
        reference: folder with the authors' weights and golden rows (`pfnn`, `lpn`); None leaves them out.
        steps: of each training.
        batch_size: frames of a minibatch.
        learning_rate: of Adam.
        seeds: number of trainings at each precision.
        seconds_per_style: seconds of procedural motion of each style.
        hidden: H.
    """

    out: Path
    reference: Path | None = None
    steps: int = 1200
    batch_size: int = 128
    learning_rate: float = 1e-3
    seeds: int = 2
    seconds_per_style: float = 60.0
    hidden: int = 512


def golden_errors(reference: Path) -> list[dict[str, Any]]:
    """Returns the errors of the authors' networks against float64, by precision, in standard deviations of outputs."""
    with tempfile.TemporaryDirectory() as folder:
        pfnn = import_released_pfnn(reference / "pfnn", Path(folder) / "pfnn")
        lpn = import_released_lpn(reference / "lpn", Path(folder) / "lpn")
        films = [load_style(lpn, name) for name in STYLES]
        predictors = make_predictor(pfnn), make_predictor(lpn)
    rows = np.load(reference / "pfnn_golden_dev.npz"), np.load(reference / "lpn_golden_dev.npz")
    bank = jax.tree.map(lambda *leaves: jnp.stack(leaves), *films)
    style = jax.tree.map(lambda leaf: leaf[rows[1]["style"]], bank)
    cases = [
        ("PFNN of 2017", predictors[0], None, rows[0]["x"], rows[0]["phase"], rows[0]["y_cubic"]),
        ("LPN of 2022", predictors[1], style, rows[1]["x"], rows[1]["gating_x"], rows[1]["y"]),
    ]
    found = []
    for name, predictor, style, x, gating, y in cases:

        def outputs(style: Style | None, x: jax.Array, gating: jax.Array, predictor=predictor) -> jax.Array:
            one = lambda style, x, gating: evaluate(replace(predictor, style=style), x, gating)  # noqa: E731
            return jax.vmap(one, in_axes=(None if style is None else 0, 0, 0))(style, x, gating)

        arguments = style, jnp.asarray(x, jnp.float32), jnp.asarray(gating, jnp.float32)
        for precision in PRECISIONS:
            predicted = np.asarray(jax.jit(round_products(outputs, precision))(*arguments))
            error = np.abs(predicted - y) / np.asarray(predictor.output_std)
            found.append({"network": name, "precision": precision, "mean": error.mean(), "largest": error.max()})
    return found


def train(config: Config, rows: Rows, precision: Precision, seed: int) -> TrainState:
    """Returns the state after a training whose products have rounded factors; as `pretrain` otherwise."""
    settings = PretrainConfig(
        hidden=config.hidden, batch_size=config.batch_size, learning_rate=config.learning_rate, seed=seed
    )
    step = make_pretrain_step(
        optax.adam(settings.learning_rate), Objective.for_layout(rows.layout), equal_dropout(settings.dropout)
    )
    step = round_products(with_pose_noise(step, POSE_NOISE, rows.layout), precision)
    scan = scan_steps(step, make_gather(rows.layout))
    key, order = jax.random.key(seed), order_of(rows, settings.batch_size, seed)
    state = init_state(settings, rows.layout, len(rows.styles), key=key)
    frozen = Frozen(jax.random.fold_in(key, 1))
    return scan(state, order.draw(0, config.steps), rows.on_device(), frozen)[0]


def judge(state: TrainState, dataset: Dataset) -> dict[str, float]:
    """Returns the held-out error, mean over styles, and the share of styles that walk both circles."""
    errors, stable = [], []
    for index, name in enumerate(dataset.styles):
        style = jax.tree.map(lambda leaf, i=index: leaf[i], state.params.modulation)
        rows = Rows.from_dataset(dataset, [name], split="validation")
        batch: Batch = rows.take(evenly_spaced(rows.first_row[-1], HELD_OUT_ROWS))
        errors.append(float(jnp.mean((predict_batch(state.params.shared, style, batch, None, None) - batch.y) ** 2)))
        x, y, phase = (np.asarray(values) for values in dataset.arrays(name))
        check = make_stability_check(state.params.shared, dataset.normaliser, dataset.layout, x, y, phase)
        stable.append(check(style))
    return {"error": float(np.mean(errors)), "stable": float(np.mean(stable))}


def run(config: Config) -> dict[str, Any]:
    """Measures everything and writes `results.json` and `table.md`."""
    clips = [clip for style in PRETRAINING_STYLES for clip in synthetic_clips(style, config.seconds_per_style, 0)]
    goldens = [] if config.reference is None else golden_errors(config.reference)
    trainings = []
    with tempfile.TemporaryDirectory() as folder:
        dataset = prepare(clips, Path(folder) / "data", PrepareConfig(mirror=False, validation=0.1))
        rows = Rows.from_dataset(dataset)
        for seed in range(config.seeds):
            for precision in PRECISIONS:
                found = judge(train(config, rows, precision, seed), dataset)
                trainings.append({"precision": precision, "seed": seed, **found})
                print(trainings[-1], flush=True)
    return write_results(config, tables(goldens, trainings), goldens=goldens, trainings=trainings)


def tables(goldens: list[dict[str, Any]], trainings: list[dict[str, Any]]) -> str:
    """Returns both tables in Markdown."""
    golden_rows = [list(row.values()) for row in goldens]
    training_rows = [list(row.values()) for row in trainings]
    return "\n".join(
        (
            markdown_table(["network", "precision", "mean error", "largest error"], golden_rows),
            markdown_table(["precision", "seed", "held-out error", "styles that walk both circles"], training_rows),
        )
    )


if __name__ == "__main__":
    run(tyro.cli(Config))
