"""The experiment on batch sizes ends a training at the target, and reads times off its curve."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from experiments.batch_size import Config, Reached, Recorder, held_out_error, plot, seconds_to, table
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.loop import Progress
from pfnn_jax.training.pretraining import init_state
from pfnn_jax.training.steps import predict_batch
from tests.training.toy import toy_data, toy_rows

CURVE = [{"frames": 8.0 * n, "seconds": float(n), "error": error} for n, error in ((1, 0.5), (2, 0.1), (3, 0.3))]
FLOAT32 = 1e-6


def test_the_time_to_an_error_is_that_of_the_first_point_below_it():
    assert seconds_to(CURVE, 0.2) == 2
    assert seconds_to(CURVE, 0.05) is None


def test_a_training_ends_at_the_target_and_its_first_chunk_costs_what_the_second_does():
    rows, config = toy_rows(), PretrainConfig(AdapterConfig("cp", 3), hidden=8)
    state = init_state(config, rows.layout, len(rows.styles))
    held_out = toy_data()
    error = float(held_out_error(state.params, held_out))
    styles = [jax.tree.map(lambda leaf, i=i: leaf[i], state.params.modulation) for i in range(3)]
    batches = [jax.tree.map(lambda leaf, i=i: leaf[i], held_out) for i in range(3)]
    alone = [
        np.mean((predict_batch(state.params.shared, style, batch, None, None) - batch.y) ** 2)
        for style, batch in zip(styles, batches, strict=True)
    ]
    assert error == pytest.approx(np.mean(alone), rel=FLOAT32)
    record = Recorder(held_out, 8, target=2 * error)
    record(state, Progress(1, 2, 0.0, 0.0))
    with pytest.raises(Reached):
        record(state, Progress(2, 2, 0.0, 0.0))
    assert record.curve[1]["seconds"] == pytest.approx(2 * record.curve[0]["seconds"])
    assert [point["frames"] for point in record.curve] == [8, 16]


def test_table_and_plot_hold_every_setting(tmp_path):
    config = Config(tmp_path, batch_sizes=(2, 4), learning_rates=(1e-3, 1e-4))
    trainings = [
        {"batch_size": size, "learning_rate": rate, "curve": CURVE} for size in (2, 4) for rate in (1e-3, 1e-4)
    ]
    assert table(config, 0.2, trainings).splitlines()[2] == "| 2 | 2.0 s, 2.0 s | 2.0 s, 2.0 s |"
    plot(config, {"target": 0.2, "trainings": trainings}).savefig(tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 1000
