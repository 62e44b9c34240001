"""The benchmark: that both sides of every comparison compute the same, and that it runs at tiny sizes."""

from __future__ import annotations

import dataclasses
import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console

from pfnn_jax.benchmarks.runtime import NumpyTable, prepare_clips, random_predictor, write_synthetic
from pfnn_jax.benchmarks.suite import BenchmarkConfig, print_benchmark, run_benchmark
from pfnn_jax.benchmarks.timing import figure, interleave, machine, versions
from pfnn_jax.benchmarks.training import (
    flops,
    fresh_state,
    make_per_sample_step,
    per_sample_outputs,
    products,
    random_frames,
    stepper,
)
from pfnn_jax.inference.lookup import evaluate_lookup, make_lookup
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.network import Dropout, init_network
from pfnn_jax.models.style import init_style
from pfnn_jax.training.steps import predict_batch
from tests.models.helpers import randomise

FLOAT32 = 1e-5  # a few ulp over sums of 64 products, which the two sides add in different orders
SIZES = NetworkConfig(5, 4, hidden=16)
STILL = Dropout(main=jnp.float32(0), adapter=jnp.float32(0))
TINY = BenchmarkConfig(
    num_joints=4,
    hidden=8,
    rank=2,
    batch_sizes=(4,),
    steps_per_dispatch=2,
    few_shot_frames=40,
    few_shot_epochs=1,
    characters=(2,),
    lpn_joints=23,
    generator_filters=2,
    generator_hidden=4,
    clips=2,
    frames=2,
    seconds_per_style=5.0,
    repetitions=2,
    mocap=None,
)


@pytest.fixture(scope="module")
def result():
    return run_benchmark(TINY)


def test_per_sample_weights_compute_what_the_flattened_product_computes():
    network = randomise(init_network(SIZES, key=jax.random.key(0)), 1)
    adapter = randomise(init_style(AdapterConfig("cp", 3), 16, 4, key=jax.random.key(1)), 2)
    batch = random_frames((6,), SIZES)
    slow = jax.jit(per_sample_outputs)(network, adapter, batch, STILL, jax.random.key(0))
    fast = predict_batch(network, adapter, batch, None, None)
    np.testing.assert_allclose(slow, fast, rtol=FLOAT32, atol=FLOAT32 * float(jnp.abs(fast).max()))


def test_both_training_steps_update_one_style_and_count_steps():
    work = stepper(
        make_per_sample_step(STILL),
        fresh_state(SIZES, AdapterConfig("cp", 2)),
        random_frames((8, 16), SIZES),
        4,
        num_steps=3,
    )
    errors = work()
    assert errors.shape == (3,) and np.isfinite(errors).all()
    assert np.isfinite(work()).all()  # the state was donated and is held by the work


def test_the_products_of_a_step_are_those_of_three_layers_and_an_adapter():
    shapes = products(NetworkConfig(234, 400), rank=30, batch_size=256)
    assert len(shapes) == 5 + 1 + 2 * 4  # forward; backward of the first layer, and twice of every other
    forward = 2 * 256 * (4 * (234 * 512 + 512 * 512 + 512 * 400) + 2 * 30 * 512)
    assert flops(shapes) == 3 * forward - 2 * 256 * 4 * 234 * 512


def test_numpys_table_computes_what_the_lookup_computes():
    lookup = make_lookup(random_predictor(SIZES))
    table, x = NumpyTable(lookup), np.random.default_rng(0).normal(size=5).astype(np.float32)
    for phase in (0.0, 1.0, 3.1, 6.28, 2 * math.pi - 0.01):
        np.testing.assert_allclose(
            table(x, phase), evaluate_lookup(lookup, jnp.asarray(x), phase), rtol=FLOAT32, atol=FLOAT32
        )


def test_prepared_rows_are_counted_with_their_mirror_images(tmp_path):
    files = write_synthetic(tmp_path, 5.0)[:1]
    rows = prepare_clips(files)
    assert rows % 2 == 0 and 2 * 200 < rows <= 2 * 300


def test_works_are_timed_in_turn():
    order = []
    seconds = interleave({"a": lambda: order.append("a"), "b": lambda: order.append("b")}, 3)
    assert order == ["a", "b"] * 4  # once to compile, three times measured
    assert {name: value.shape for name, value in seconds.items()} == {"a": (3,), "b": (3,)}


def test_a_figure_is_a_median_with_quartiles_and_an_aim():
    above = figure("section", "name", np.array([1.0, 2.0, 3.0, 4.0, 100.0]), "x", at_least=3.0)
    assert (above.value, above.low, above.high, above.repetitions) == (3.0, 2.0, 4.0, 5)
    assert above.meets_aim and not figure("", "", np.array([3.1]), "s", at_most=3.0).meets_aim
    assert figure("", "", np.array([3.1]), "s").meets_aim is None


def test_the_result_is_json_with_machine_versions_and_figures(result):
    again = json.loads(json.dumps(result))
    assert again["machine"] == machine() and again["machine"]["processor"]
    assert again["versions"] == versions()
    assert len({row["section"] for row in again["figures"]}) == 12
    for row in again["figures"]:
        assert row["value"] > 0 and row["low"] <= row["value"] <= row["high"] and row["repetitions"] >= 1


def test_the_result_is_printed_as_a_table(result):
    console = Console(record=True, width=120)
    print_benchmark(result, console)
    text = console.export_text()
    assert all(row["name"] in text for row in result["figures"])


@pytest.mark.parametrize("name", ["hidden", "repetitions", "frames", "few_shot_epochs"])
def test_sizes_of_nothing_are_refused(name):
    with pytest.raises(ValueError, match=f"BenchmarkConfig.{name} must be at least 1, got 0"):
        dataclasses.replace(TINY, **{name: 0})
