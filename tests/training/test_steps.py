"""The pretraining step: what it changes, what it leaves alone, and that compiled runs repeat it."""

from __future__ import annotations

import dataclasses
from typing import cast

import chex
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from jax.test_util import check_grads

from pfnn_jax.models.config import AdapterConfig, AdapterKind, NetworkConfig
from pfnn_jax.models.dropout import Dropout
from pfnn_jax.models.layers import style_kinds
from pfnn_jax.models.network import config_of, init_network
from pfnn_jax.models.style import init_style
from pfnn_jax.motion.features.layout import mason2018
from pfnn_jax.training.data import Batch, Draw
from pfnn_jax.training.loop import TrainState, scan_steps
from pfnn_jax.training.losses import Objective
from pfnn_jax.training.order import order_of
from pfnn_jax.training.steps import (
    Frozen,
    PretrainParams,
    Step,
    disturb_poses,
    init_train_state,
    make_pretrain_step,
    predict_batch,
    pretrain_loss,
    with_pose_noise,
)
from tests.models.helpers import predict, randomise
from tests.training.toy import assert_bitwise, on_host, take, toy_data, toy_network, toy_rows, toy_style

FLOAT32 = 1e-5  # a few ulp over sums of 16 products
ADAM_EPSILON = 0.05  # Adam's first step is the rate over 1 + 1e-8/|gradient|; gradients here are above 1e-6
RATE = 1e-3
DROPOUT = Dropout(main=jnp.float32(0.3), adapter=jnp.float32(0.5))
KEY = jax.random.key(7)
FROZEN = Frozen(KEY)
KINDS = style_kinds()
SIZES = config_of(toy_network())


def make_step(dropout: Dropout = DROPOUT):
    return make_pretrain_step(optax.adam(RATE), Objective(0.01), dropout)


def make_state(kind: AdapterKind = "cp", num_styles: int = 3) -> TrainState:
    config = AdapterConfig(kind, rank=3)
    keys = jax.random.split(jax.random.key(1), num_styles)
    bank = jax.vmap(lambda key: init_style(config, SIZES, key=key))(keys)
    return init_train_state(toy_network(), bank, optax.adam(RATE))


def style_of(tree, style: int):
    return jax.tree.map(lambda leaf: leaf[style], tree)


def some_changed(first, second) -> bool:
    pairs = zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True)
    return any(not np.array_equal(one, other) for one, other in pairs)


def draw_of(num_steps: int, batch_size: int = 4) -> Draw:
    return order_of(toy_rows(), batch_size, seed=0).draw(0, num_steps)


def all_rows() -> Batch:
    """The frames of three styles one after another, on the device."""
    return toy_rows().on_device()


def streamed(_, batch: Batch) -> Batch:
    """Reads a minibatch that was gathered on the host."""
    return batch


def one_of(draw, number: int | slice):
    return jax.tree.map(lambda leaf: leaf[number], draw)


def test_a_batch_is_its_frames_one_by_one():
    network, batch = toy_network(), toy_style()
    adapter = randomise(init_style(AdapterConfig("cp", 3), SIZES, key=KEY), 2)
    together = predict_batch(network, adapter, batch, None, None)
    single = jax.jit(predict)
    singles = [single(network, adapter, x, phase) for x, phase in zip(batch.x, batch.phase, strict=True)]
    np.testing.assert_allclose(together, jnp.stack(singles), rtol=FLOAT32, atol=FLOAT32)


def test_every_frame_of_a_batch_draws_a_mask_of_its_own():
    network, frame = init_network(NetworkConfig(32, 32, hidden=32), key=KEY), np.ones((8, 32), np.float32)
    outputs = predict_batch(network, None, Batch(frame, frame, np.ones(8, np.float32)), DROPOUT, KEY)
    assert len(np.unique(np.asarray(outputs), axis=0)) == 8


@pytest.mark.parametrize("kind", KINDS)
def test_gradient_of_the_loss(kind):
    with jax.enable_x64(True):
        sizes = NetworkConfig(3, 2, hidden=4)
        shared = randomise(init_network(sizes, key=jax.random.key(0)), 1)
        adapter = randomise(init_style(AdapterConfig(kind, rank=2), sizes, key=KEY), 2)
        x, y = jax.random.normal(jax.random.key(3), (5, 3)), jax.random.normal(jax.random.key(4), (5, 2))
        batch = Batch(x, y, jnp.linspace(0.3, 6.0, 5))  # between the knots 0, π/2, π, 3π/2
        dropout = Dropout(main=jnp.float64(0.3), adapter=jnp.float64(0.5))
        # With the key, and so the masks, fixed the loss is differentiable at parameters other than zero.
        check_grads(
            jax.jit(lambda *both: pretrain_loss(PretrainParams(*both), batch, Objective(0.01), None, dropout, KEY)[0]),
            (shared, adapter),
            order=1,  # training takes no second derivative, and each would be compiled again
            modes=("fwd", "rev"),
        )


def test_the_loss_is_the_error_and_the_penalty_of_both_parts():
    shared, batch = toy_network(), toy_style()
    adapter = randomise(init_style(AdapterConfig("cp", 3), SIZES, key=KEY), 2)
    loss, error = pretrain_loss(PretrainParams(shared, adapter), batch, Objective(0.5, "sum"), None, DROPOUT, KEY)
    size = sum(float(jnp.abs(leaf).sum()) for leaf in jax.tree.leaves((shared, adapter)))
    np.testing.assert_allclose(loss - error, 0.5 * size, rtol=FLOAT32)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("number", [0, 1, 5])
def test_a_step_changes_its_own_style_alone(kind, number):
    state, style = dataclasses.replace(make_state(kind), step=jnp.int32(number)), number % 3
    after, error = jax.jit(make_step())(state, toy_style(style), FROZEN)
    for other in {0, 1, 2} - {style}:
        assert_bitwise(style_of(after.params.modulation, other), style_of(state.params.modulation, other))
        assert_bitwise(style_of(after.opt_state.modulation, other), style_of(state.opt_state.modulation, other))
    assert some_changed(style_of(after.params.modulation, style), style_of(state.params.modulation, style))
    assert some_changed(style_of(after.opt_state.modulation, style), style_of(state.opt_state.modulation, style))
    assert some_changed(after.params.shared, state.params.shared)
    assert after.step == number + 1
    assert error > 0


def test_the_first_step_of_every_style_has_the_length_of_adams_rate():
    state, data = make_state(), toy_data()
    step = jax.jit(make_step(Dropout(main=jnp.float32(0), adapter=jnp.float32(0))))
    for style in range(3):  # the shared network has taken steps by then; the adapter's own Adam starts afresh
        before = style_of(state.params.modulation, style)
        state, _ = step(state, style_of(data, style), FROZEN)
        change = jax.tree.map(lambda new, old: jnp.abs(new - old), style_of(state.params.modulation, style), before)
        for leaf in (change.a, change.b, change.d):
            np.testing.assert_allclose(leaf, RATE, rtol=ADAM_EPSILON)


def test_each_step_draws_new_masks_and_a_repeated_step_the_same():
    state, batch, step = make_state(), toy_style(), jax.jit(make_step())
    first, again = step(state, batch, FROZEN)[1], step(state, batch, FROZEN)[1]
    assert first == again
    assert first != step(dataclasses.replace(state, step=jnp.int32(3)), batch, FROZEN)[1]
    assert first != step(state, batch, Frozen(jax.random.key(8)))[1]


def test_a_dispatch_is_the_loop_of_its_steps():
    data, draw = all_rows(), draw_of(9)
    together, errors = scan_steps(make_step(), take)(make_state(), draw, data, FROZEN)
    state, step = make_state(), jax.jit(make_step())
    for number, error in enumerate(errors):
        state, single = step(state, take(data, one_of(draw, number)), FROZEN)
        np.testing.assert_array_equal(error, single)
    assert_bitwise(together, state)


@pytest.mark.parametrize("rolled", [True, False])
def test_one_compiled_loop_and_single_dispatches_are_the_same(rolled):
    data, draw = all_rows(), draw_of(6)
    reference = scan_steps(make_step(), take)(make_state(), draw, data, FROZEN)
    assert_bitwise(scan_steps(make_step(), take, rolled=rolled)(make_state(), draw, data, FROZEN), reference)
    batches = jax.tree.map(np.asarray, take(data, draw))
    assert_bitwise(scan_steps(make_step(), streamed, rolled=rolled)(make_state(), batches, None, FROZEN), reference)


@pytest.mark.parametrize("rolled", [True, False])
def test_runs_donate_their_state(rolled):
    data, draw = all_rows(), draw_of(3)
    state = make_state()
    scan_steps(make_step(), take, rolled=rolled)(state, draw, data, FROZEN)
    assert all(leaf.is_deleted() for leaf in jax.tree.leaves(state.params.shared))
    state = make_state()
    batches = jax.tree.map(np.asarray, take(data, draw))
    scan_steps(make_step(), streamed, rolled=rolled)(state, batches, None, FROZEN)
    assert all(leaf.is_deleted() for leaf in jax.tree.leaves(state.opt_state.modulation))


def test_all_styles_and_dispatches_of_one_length_share_one_compilation():
    chex.clear_trace_counter()
    scan = scan_steps(cast(Step, chex.assert_max_traces(make_step(), n=1)), take)
    data, draw = all_rows(), draw_of(12)
    state = make_state()
    for start in (0, 4, 8):  # dispatches that begin with styles 0, 1 and 2
        state, _ = scan(state, one_of(draw, slice(start, start + 4)), data, FROZEN)
    assert state.step == 12


def test_steps_do_not_touch_the_data():
    data = all_rows()
    before = on_host(data)
    scan_steps(make_step(), take)(make_state(), draw_of(3), data, FROZEN)
    assert_bitwise(data, before)


NOISE = 0.3
JOINTS = np.array([False, True, False, True, True, False])


def disturbed(x: np.ndarray) -> np.ndarray:
    return np.asarray(disturb_poses(x, NOISE, JOINTS, key=KEY), np.float64)


def test_noise_on_poses_leaves_other_columns_alone():
    x = np.random.default_rng(0).normal(size=(40, 6)).astype(np.float32)
    np.testing.assert_array_equal(disturbed(x)[:, ~JOINTS], x[:, ~JOINTS])
    assert np.all(disturbed(x)[:, JOINTS] != x[:, JOINTS])


def test_noise_on_poses_has_mean_zero_and_the_deviation_of_a_uniform_share():
    noise = disturbed(np.zeros((20_000, 6), np.float32))[:, JOINTS]
    expected = NOISE / np.sqrt(3.0)  # the root mean square of a uniform share of it
    assert abs(noise.mean()) < 5 * expected / np.sqrt(noise.size)
    np.testing.assert_allclose(noise.std(), expected, rtol=0.02)  # 20,000 shares: 5 standard errors


def test_the_gradient_passes_noise_on_poses_unchanged():
    x, weights = (jax.random.normal(jax.random.key(seed), (4, 6)) for seed in (1, 2))
    gradient = jax.grad(lambda x: jnp.sum(weights * disturb_poses(x, NOISE, JOINTS, key=KEY)))(x)
    np.testing.assert_array_equal(gradient, weights)


def test_a_step_with_noise_sees_other_poses_and_the_same_targets():
    seen = []

    def record(state, batch, frozen):
        seen.append(batch)
        return state, jnp.zeros(())

    layout = mason2018(1)
    x, y = np.ones((5, layout.input_size), np.float32), np.ones((5, layout.output_size), np.float32)
    batch, state = Batch(x, y, np.zeros(5, np.float32)), make_state()
    for _ in range(2):
        with_pose_noise(cast(Step, record), NOISE, layout)(state, batch, FROZEN)
    joints = np.array([name.startswith("joint_") for name in layout.input_names])
    np.testing.assert_array_equal(seen[0].x[:, ~joints], x[:, ~joints])
    assert np.all(seen[0].x[:, joints] != 1.0)
    np.testing.assert_array_equal(seen[0].y, y)
    np.testing.assert_array_equal(seen[0].x, seen[1].x)  # a step repeats itself
