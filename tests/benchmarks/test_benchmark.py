"""The benchmark: both sides of every comparison compute the same function, and it runs at tiny sizes."""

from __future__ import annotations

import dataclasses
import json
import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from rich.console import Console

from pfnn_jax.benchmarks.other_libraries import PACKAGES, check_equal, is_installed, other_frames, torch_lookup
from pfnn_jax.benchmarks.preparation import prepare_clips, write_synthetic
from pfnn_jax.benchmarks.runtime import NumpyTable, frame_inputs, random_predictor
from pfnn_jax.benchmarks.suite import BenchmarkConfig, print_benchmark, run_benchmark
from pfnn_jax.benchmarks.timing import figure, interleave
from pfnn_jax.benchmarks.torch_training import TorchTraining, check_outputs, torch_stepper
from pfnn_jax.benchmarks.training import flops, fresh_state, per_sample_outputs, products, random_frames, stepper
from pfnn_jax.benchmarks.transfer import TransferSizes, fast_works
from pfnn_jax.inference.lookup import evaluate_lookup, make_lookup
from pfnn_jax.inference.predictor import evaluate
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.network import Dropout, init_network
from pfnn_jax.models.style import init_style
from pfnn_jax.training.losses import Objective
from pfnn_jax.training.steps import make_pretrain_step, predict_batch
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
    transfer=TransferSizes(
        frames=(60,), filters=4, hidden=4, width=5, iterations=2, constraint_iterations=2, minutes=0.6
    ),
    rest=0.0,
    repetitions=2,
    mocap=None,
)


@pytest.fixture(scope="module")
def result():
    return run_benchmark(TINY)


def test_per_sample_weights_compute_the_same_as_the_flattened_product():
    network = randomise(init_network(SIZES, key=jax.random.key(0)), 1)
    adapter = randomise(init_style(AdapterConfig("cp", 3), SIZES, key=jax.random.key(1)), 2)
    batch = random_frames((6,), SIZES)
    slow = jax.jit(per_sample_outputs)(network, adapter, batch, STILL, jax.random.key(0))
    fast = predict_batch(network, adapter, batch, None, None)
    np.testing.assert_allclose(slow, fast, rtol=FLOAT32, atol=FLOAT32 * float(jnp.abs(fast).max()))


def test_training_steps_with_per_sample_weights_have_the_same_errors():
    def errors(predict) -> np.ndarray:
        step = make_pretrain_step(optax.adam(1e-4), Objective(0.01), STILL, predict=predict)
        state, data = fresh_state(SIZES, AdapterConfig("cp", 2)), random_frames((8, 16), SIZES)
        work = stepper(step, state, data, 4, num_steps=3)
        return np.concatenate([work(), work()])  # the work keeps the state, which each call donates

    slow, fast = errors(per_sample_outputs), errors(predict_batch)
    assert slow.shape == (6,)
    np.testing.assert_allclose(slow, fast, rtol=1e-4)  # six steps of Adam magnify rounding errors


def test_products_of_a_step_are_three_layers_and_an_adapter_forward_and_backward():
    shapes = products(NetworkConfig(234, 400), rank=30, batch_size=256)
    assert len(shapes) == 5 + 1 + 2 * 4  # forward; backward of the first layer, and twice of every other
    forward = 2 * 256 * (4 * (234 * 512 + 512 * 512 + 512 * 400) + 2 * 30 * 512)
    assert flops(shapes) == 3 * forward - 2 * 256 * 4 * 234 * 512


def test_numpy_table_computes_the_same_as_the_lookup():
    lookup = make_lookup(random_predictor(SIZES))
    table, x = NumpyTable(lookup), np.random.default_rng(0).normal(size=5).astype(np.float32)
    for phase in (0.0, 1.0, 3.1, 6.28, 2 * math.pi - 0.01):
        np.testing.assert_allclose(
            table(x, phase), evaluate_lookup(lookup, jnp.asarray(x), phase), rtol=FLOAT32, atol=FLOAT32
        )


@pytest.mark.parametrize("library", PACKAGES)
@pytest.mark.parametrize("gating", [0, 3])
def test_frames_of_other_libraries_compute_the_same(library, gating):
    if not is_installed(library):
        pytest.skip(f"{library} is not installed")
    sizes = dataclasses.replace(SIZES, phase_size=gating)
    predictor = randomise(random_predictor(sizes, AdapterConfig("film") if gating else None), 3)
    x, phases = frame_inputs(sizes, 4)
    frames = {name: frame for name, frame in other_frames(predictor, phases[0]).items() if library in name}
    assert frames
    for name, frame in frames.items():
        check_equal(name, frame, partial(jax.jit(evaluate), predictor), x, phases)


def test_other_frames_are_compared_before_they_are_timed():
    x, phases = frame_inputs(SIZES, 2)
    with pytest.raises(ValueError, match="PyTorch must compute the same"):
        check_equal("PyTorch", lambda x, phase: x, lambda x, phase: 1.001 * x, x, phases)


def test_lookup_in_pytorch_computes_the_same():
    pytest.importorskip("torch")
    lookup = make_lookup(randomise(random_predictor(SIZES), 4))
    check_equal("PyTorch", torch_lookup(lookup), partial(evaluate_lookup, lookup), *frame_inputs(SIZES, 4))


def test_all_forms_of_the_fast_transfer_compute_the_same():
    for works in fast_works(TransferSizes(frames=(60, 100), filters=6, hidden=5, width=7)).values():
        results = {name: np.asarray(work()) for name, work in works.items()}
        for result in results.values():
            np.testing.assert_allclose(result, results["ours"], rtol=FLOAT32, atol=FLOAT32)


def test_prepared_rows_include_mirror_images(tmp_path):
    files = write_synthetic(tmp_path, 5.0)[:1]
    rows = prepare_clips(files)
    assert rows % 2 == 0 and 2 * 200 < rows <= 2 * 300


def test_timed_works_are_interleaved():
    order = []
    seconds = interleave({"a": lambda: order.append("a"), "b": lambda: order.append("b")}, 3)
    assert order == ["a", "b"] * 4  # once to compile, three times measured
    assert {name: value.shape for name, value in seconds.items()} == {"a": (3,), "b": (3,)}


def test_figure_is_a_median_with_quartiles_and_an_aim():
    above = figure("section", "name", np.array([1.0, 2.0, 3.0, 4.0, 100.0]), "x", at_least=3.0)
    assert (above.value, above.low, above.high, above.repetitions) == (3.0, 2.0, 4.0, 5)
    assert above.meets_aim and not figure("", "", np.array([3.1]), "s", at_most=3.0).meets_aim
    assert figure("", "", np.array([3.1]), "s").meets_aim is None


@pytest.mark.slow
def test_result_survives_json_and_has_positive_figures(result):
    assert json.loads(json.dumps(result)) == result
    for row in result["figures"]:
        assert row["value"] > 0 and row["low"] <= row["value"] <= row["high"] and row["repetitions"] >= 1


@pytest.mark.slow
def test_printed_table_names_every_figure(result):
    console = Console(record=True, width=120)
    print_benchmark(result, console)
    text = console.export_text()
    assert all(row["name"] in text for row in result["figures"])


@pytest.mark.parametrize("name", ["hidden", "repetitions", "frames", "few_shot_epochs"])
def test_sizes_below_one_are_refused_by_field(name):
    with pytest.raises(ValueError, match=f"BenchmarkConfig.{name}"):
        dataclasses.replace(TINY, **{name: 0})


def test_pytorch_computes_the_same_function():
    pytest.importorskip("torch")
    state = fresh_state(SIZES, AdapterConfig("cp", 3), 2)
    state = dataclasses.replace(state, params=randomise(state.params, 1))
    training = TorchTraining(state)
    data = random_frames((2, 8), SIZES)
    check_outputs(training, state, jax.tree.map(lambda leaf: leaf[0], data))
    assert np.isfinite(torch_stepper(training, data, 4, 3)())
