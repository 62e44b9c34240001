"""Learning one style: what stays frozen, and that grids and banks equal their members trained one by one."""

from __future__ import annotations

import dataclasses
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.models.config import NetworkConfig
from pfnn_jax.models.layers import style_class, style_kinds
from pfnn_jax.models.network import Network, config_of, init_network, num_parameters
from pfnn_jax.motion.features.layout import mason2018
from pfnn_jax.motion.features.normaliser import Normaliser, Statistics
from pfnn_jax.training import few_shot_learning
from pfnn_jax.training.config import METHODS, FewShotConfig
from pfnn_jax.training.data import Batch, Rows
from pfnn_jax.training.few_shot_learning import (
    Candidate,
    Choice,
    Setting,
    assemble,
    choose,
    decayed,
    few_shot,
    few_shot_step,
    fit_style,
    init_few_shot_state,
    initial_parameters,
    padded_permutation,
    refit,
    settings_grid,
    sorts_of,
    train_bank,
    train_grid,
)
from pfnn_jax.training.losses import Objective, l1_penalty, squared_error
from pfnn_jax.training.restyling import StyleDifferences, restyle
from pfnn_jax.training.steps import predict_batch
from tests.models.helpers import randomise
from tests.training.toy import HIDDEN, assert_bitwise, body_rows, on_host, toy_data, toy_network, toy_rows, toy_style

# A batched product sums in another order than a single one: a few ulp of parameters below one, over a dozen steps.
BATCHED = 1e-6
# Share of the error left after 180 steps on 24 frames; half of it is left by the weakest, a blended bias, which can
# fit the posture but not how the output follows the input.
LEARNED = {
    "cp": 0.5,
    "full": 0.2,
    "diagonal": 0.6,
    "bias": 0.7,
    "dense": 0.7,
    "one_hot": 0.9,
    "film": 0.9,
    "fine_tune": 0.01,
    "scratch": 0.01,
}
ADAPTERS = style_kinds()
SMALL = FewShotConfig(
    rank=3,
    learning_rates=(1e-3, 5e-3),
    main_dropouts=(0.0, 0.3),
    adapter_dropouts=(0.3,),
    eval_epochs=(2, 4),
    batch_size=8,
)
SINGLE = dataclasses.replace(SMALL, learning_rates=(1e-3,), main_dropouts=(0.3,))


def held_out() -> Batch:
    return toy_style(num_frames=12, seed=0)


def grid(config: FewShotConfig = SMALL) -> list[Candidate]:
    return train_grid(toy_network(), toy_style(), held_out(), config)


def error_of(trained, shared: Network, data: Batch) -> float:
    return float(squared_error(predict_batch(*assemble(trained, shared), data, None, None), data.y))


def assert_close(first, second) -> None:
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_allclose(one, other, atol=BATCHED, rtol=BATCHED)


def by_setting(candidates: list[Candidate]) -> dict[tuple, Candidate]:
    return {candidate.choice[:4]: candidate for candidate in candidates}


@pytest.mark.parametrize("method", METHODS)
def test_the_shared_network_is_bitwise_unchanged(method):
    shared = toy_network()
    before = on_host(shared)
    config = dataclasses.replace(SINGLE, method=method)
    candidate = train_grid(shared, toy_style(), held_out(), config)[0]
    assert_bitwise(shared, before)
    refit(shared, toy_style(), candidate.choice, config)
    assert_bitwise(shared, before)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_trains_its_own_kind_of_parameters(method):
    shared = toy_network()
    trained = initial_parameters(dataclasses.replace(SMALL, method=method), shared, key=jax.random.key(0))
    if method in ADAPTERS:
        assert type(trained) is style_class(method)
        assert assemble(trained, shared) == (shared, trained)
    else:
        assert isinstance(trained, Network)
        assert assemble(trained, shared) == (trained, None)


def test_fine_tuning_starts_from_the_pretrained_network_and_scratch_does_not():
    shared = toy_network()
    fine_tune, scratch = (
        initial_parameters(dataclasses.replace(SMALL, method=method), shared, key=jax.random.key(5))
        for method in ("fine_tune", "scratch")
    )
    assert_bitwise(fine_tune, shared)
    assert num_parameters(scratch) == num_parameters(shared)
    assert not np.array_equal(jax.tree.leaves(scratch)[0], jax.tree.leaves(shared)[0])


@pytest.mark.parametrize("rank", [None, 3])
def test_a_network_tells_the_sizes_it_was_made_with(rank):
    config = NetworkConfig(5, 4, HIDDEN, num_control_points=5, rank=rank)
    assert config_of(init_network(config, key=jax.random.key(0))) == config


def test_by_default_a_style_is_learned_as_in_the_paper():
    """Mason 2018 §7.2 and the authors' code: 100 epochs at 1e-4, variable dropout of the adapter alone."""
    grid, config = settings_grid(FewShotConfig()), FewShotConfig()
    assert (config.method, config.rank, config.eval_epochs, config.batch_size) == ("cp", 30, (100,), 32)
    np.testing.assert_allclose(grid.adapter_dropout, [0.3, 0.5, 0.7])
    np.testing.assert_allclose(grid.learning_rate, 1e-4)
    np.testing.assert_allclose(grid.main_dropout, 0.3)


def test_the_grid_holds_every_combination_once():
    config = FewShotConfig(learning_rates=(1e-4, 1e-3), main_dropouts=(0.0, 0.3), adapter_dropouts=(0.1, 0.5, 0.9))
    rows = np.stack(jax.tree.leaves(settings_grid(config)), axis=1)
    assert rows.shape == (12, 3)
    assert len(np.unique(rows, axis=0)) == 12


def test_there_is_one_candidate_for_each_setting_and_stop_and_the_best_is_first():
    candidates = grid()
    assert len(candidates) == len(by_setting(candidates)) == 2 * 2 * 1 * 2
    errors = [candidate.choice.held_out_error for candidate in candidates]
    assert errors == sorted(errors)
    assert {candidate.choice.epochs for candidate in candidates} == {2, 4}


def test_choices_name_the_rates_as_they_were_configured():
    assert {candidate.choice[:3] for candidate in grid(SINGLE)} == {(1e-3, 0.3, 0.3)}


def test_the_error_of_a_candidate_is_that_of_its_parameters_without_dropout():
    for candidate in grid():
        error = error_of(candidate.trained, toy_network(), held_out())
        np.testing.assert_allclose(candidate.choice.held_out_error, error, rtol=BATCHED)


@pytest.mark.parametrize("method", ["cp", "fine_tune"])
def test_a_grid_equals_its_settings_trained_one_by_one(method):
    config = dataclasses.replace(SMALL, method=method)
    together = by_setting(grid(config))
    for rate in config.learning_rates:
        for main in config.main_dropouts:
            alone = dataclasses.replace(config, learning_rates=(rate,), main_dropouts=(main,))
            for setting, candidate in by_setting(grid(alone)).items():
                assert_close(together[setting].trained, candidate.trained)


def test_looking_at_a_stop_does_not_disturb_training():
    watched, unwatched = grid(), grid(dataclasses.replace(SMALL, eval_epochs=(4,)))
    for setting, candidate in by_setting(unwatched).items():
        assert_bitwise(by_setting(watched)[setting].trained, candidate.trained)


def test_a_bank_equals_its_styles_trained_one_by_one():
    shared, data = toy_network(), toy_data()
    choice = Choice(1e-3, 0.3, 0.5, epochs=3, held_out_error=0.0)
    bank = train_bank(shared, data, choice, SINGLE)
    for style in range(3):
        alone = refit(shared, jax.tree.map(lambda leaf, s=style: leaf[s], data), choice, SINGLE)
        assert_close(jax.tree.map(lambda leaf, s=style: leaf[s], bank), alone)


@pytest.mark.parametrize("count", [1, 100, 2000])
def test_a_padded_order_is_the_one_without_padding(count):
    """What is compiled for more frames than there are shuffles them as if it knew their number."""
    key, size = jax.random.key(count), 2048
    order = padded_permutation(size, jnp.int32(count), sorts_of(count), key=key)
    np.testing.assert_array_equal(order[:count], jax.random.permutation(key, count))
    assert sorted(order.tolist()) == list(range(size))


def test_progress_is_reported_until_the_last_epoch():
    reported = []
    train_grid(
        toy_network(),
        toy_style(),
        held_out(),
        dataclasses.replace(SINGLE, eval_epochs=(2, 9)),
        progress_callback=reported.append,
    )
    assert reported == [2, 5, 9]


def test_a_refit_on_the_same_frames_repeats_the_grid():
    candidate = grid(SINGLE)[0]
    assert_close(refit(toy_network(), toy_style(), candidate.choice, SINGLE), candidate.trained)


def test_training_depends_on_the_seed_alone():
    assert_bitwise(grid(SINGLE)[0].trained, grid(SINGLE)[0].trained)
    other = grid(dataclasses.replace(SINGLE, seed=1))
    assert not np.array_equal(other[0].trained.a, grid(SINGLE)[0].trained.a)


@pytest.mark.parametrize("method", METHODS)
def test_learning_a_style_lowers_its_error(method):
    shared, data = toy_network(), toy_style()
    config = dataclasses.replace(
        SINGLE, method=method, learning_rates=(5e-3,), main_dropouts=(0.0,), adapter_dropouts=(0.0,), eval_epochs=(60,)
    )
    untrained = error_of(initial_parameters(config, shared, key=jax.random.split(jax.random.key(0))[0]), shared, data)
    trained = train_grid(shared, data, data, config)[0]
    assert trained.choice.held_out_error < LEARNED.get(method, 0.9) * untrained


def test_a_setting_that_turns_non_finite_ranks_last():
    candidates = grid(dataclasses.replace(SMALL, learning_rates=(1e-3, 1e30)))
    errors = [candidate.choice.held_out_error for candidate in candidates]
    assert np.isfinite(errors[:4]).all() and np.isinf(errors[4:]).all()


def test_the_best_stable_candidate_is_chosen_and_the_best_of_all_where_none_is():
    candidates = grid()
    assert choose(candidates, 0.0) is candidates[0]
    assert choose(candidates, 0.0, lambda trained: trained is candidates[2].trained) is candidates[2]
    assert choose(candidates, 0.0, lambda trained: False) is candidates[0]


def test_the_chosen_setting_removes_at_least_half_of_the_error_that_the_best_removes():
    errors = (0.20, 0.24, 0.26, 0.29)  # best first, ever more conservative
    base = grid()[0]
    candidates = [
        base._replace(choice=base.choice._replace(held_out_error=error, epochs=40 - 10 * rank))
        for rank, error in enumerate(errors)
    ]
    assert choose(candidates, 0.5) is candidates[3]
    assert choose(candidates, 0.5, without=1.0) is candidates[3]
    assert choose(candidates, 0.5, without=0.30) is candidates[1]
    assert choose(candidates, 0.5, without=0.10) is candidates[0]


def test_fewer_frames_than_a_minibatch_are_refused():
    with pytest.raises(ValueError, match="`data` must have at least 8 frames, got 7"):
        train_grid(toy_network(), toy_style(num_frames=7), held_out(), SMALL)


@pytest.mark.parametrize("method", ADAPTERS)
def test_gradient_of_the_few_shot_loss(method):
    with jax.enable_x64(True):
        shared = randomise(init_network(NetworkConfig(3, 2, hidden=4), key=jax.random.key(0)), 1)
        config = FewShotConfig(method=method, rank=2)
        trained = randomise(initial_parameters(config, shared, key=jax.random.key(1)), 2)
        x, y = jax.random.normal(jax.random.key(3), (5, 3)), jax.random.normal(jax.random.key(4), (5, 2))
        batch = Batch(x, y, jnp.linspace(0.3, 6.0, 5))  # between the knots 0, π/2, π, 3π/2

        @jax.jit
        def loss(trained):
            prediction = predict_batch(*assemble(trained, shared), batch, None, None)
            return squared_error(prediction, batch.y) + 0.01 * l1_penalty(trained)

        check_grads(loss, (trained,), order=1, modes=("fwd", "rev"))


def test_a_step_of_rate_zero_changes_the_optimiser_alone():
    shared = toy_network()
    state = init_few_shot_state(initial_parameters(SMALL, shared, key=jax.random.key(0)))
    still = Setting(jnp.float32(0), jnp.float32(0.3), jnp.float32(0.3))
    after = few_shot_step(state, still, shared, toy_style(), Objective(0.01), key=jax.random.key(1))
    assert_bitwise(after.params, state.params)
    assert not np.array_equal(after.opt_state[0].mu.a, state.opt_state[0].mu.a)


def test_film_starts_from_the_given_style():
    shared, config = (
        toy_network(),
        dataclasses.replace(SINGLE, method="film", learning_rates=(1e-12,), eval_epochs=(1,)),
    )
    start = randomise(initial_parameters(config, shared, key=jax.random.key(0)), 4)
    found = train_grid(shared, toy_style(), held_out(), config, start=start)[0].trained
    assert_close(found, start)
    assert not np.allclose(train_grid(shared, toy_style(), held_out(), config)[0].trained.scale, start.scale)


def test_film_is_not_regularised():
    film = initial_parameters(dataclasses.replace(SMALL, method="film"), toy_network(), key=jax.random.key(0))
    prediction, target = jnp.ones((2, 3)), jnp.zeros((2, 3))
    loss, error = Objective(l1=10.0).loss(prediction, target, (film,))
    assert loss == error == 1.0


def test_a_bone_length_loss_lowers_the_error_of_bones():
    rows = body_rows(num_frames=(40,))
    shared = init_network(NetworkConfig(84, 78, HIDDEN, 8, phase_size=8), key=jax.random.key(0))
    data = rows.parts[0]
    config = dataclasses.replace(SINGLE, method="film", eval_epochs=(40,), learning_rates=(1e-2,), main_dropouts=(0.0,))

    def bone_error(bones):
        trained = train_grid(shared, data, data, config, bones=bones)[0].trained
        return float(rows.bones().length_error(predict_batch(shared, trained, data, None, None), data.y))

    assert bone_error(rows.bones()) < bone_error(None)


def test_skeletons_and_clips_of_other_lengths_share_one_compilation():
    """Bones and numbers of frames are data: a second clip on a second skeleton compiles nothing."""
    rows = [body_rows(num_frames=(frames,), seed=seed) for seed, frames in enumerate((40, 52))]
    # A width that no other test uses, so that nothing is compiled before.
    shared = init_network(NetworkConfig(84, 78, HIDDEN + 1, 8, phase_size=8), key=jax.random.key(0))
    config = dataclasses.replace(SINGLE, method="film", eval_epochs=(1,))
    before = cast(Any, few_shot_learning._train_many)._cache_size()
    for clip in rows:
        data = clip.parts[0]
        train_grid(shared, data, data, config, bones=clip.bones())
    assert cast(Any, few_shot_learning._train_many)._cache_size() == before + 1


def test_few_shot_returns_the_style_that_its_choice_trains():
    rows = toy_rows((24,))
    config = dataclasses.replace(SINGLE, held_out=0.25)
    found = fit_style(toy_network(), rows, config, key=jax.random.key(3))
    assert_bitwise(few_shot(toy_network(), rows, config, key=jax.random.key(3)), found.style)
    again = refit(toy_network(), rows.parts[0], found.choice, config, key=jax.random.key(3))
    assert_bitwise(again, found.style)
    assert found.choice in found.ranking and found.stable_on_turns is None
    without = error_of(toy_network(), toy_network(), rows.hold_out(0.25)[1])
    np.testing.assert_allclose(found.error_without_style, without, rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("method", "none"),
        ("l1", -1.0),
        ("bone_length", -1.0),
        ("eval_epochs", ()),
        ("eval_epochs", (10, 5)),
        ("eval_epochs", (0, 5)),
        ("held_out", 0.0),
        ("held_out", 1.0),
        ("main_dropouts", ()),
        ("adapter_dropouts", (1.0,)),
        ("learning_rates", (0.0,)),
        ("learning_rates", ()),
    ],
)
def test_a_configuration_out_of_range_is_refused(name, value):
    with pytest.raises(ValueError, match=f"FewShotConfig.{name} must"):
        dataclasses.replace(SMALL, **{name: value})


def test_a_decaying_rate_begins_whole_and_ends_at_nothing():
    setting = Setting(*(jnp.float32(value) for value in (0.1, 0.3, 0.5)))
    rates = [float(decayed(setting, jnp.float32(done)).learning_rate) for done in (0.0, 0.5, 1.0)]
    np.testing.assert_allclose(rates, [0.1, 0.05, 0.0], atol=1e-8)
    assert decayed(setting, jnp.float32(0.5)).main_dropout == setting.main_dropout


def test_rates_decay_to_one_number_of_epochs():
    with pytest.raises(ValueError, match="eval_epochs"):
        FewShotConfig(decay=True, eval_epochs=(5, 10))


def test_a_decaying_training_moves_less_in_its_last_epoch_than_in_its_first():
    config = dataclasses.replace(SINGLE, eval_epochs=(8,), decay=True, l1=0.0)
    settings, data = settings_grid(config), toy_style()
    trainer = few_shot_learning.EpochTrainer(toy_network(), data, config, key=jax.random.key(0))
    states, moved = few_shot_learning._stack(initial_parameters(config, toy_network(), key=jax.random.key(1)), 1), []
    for epoch in range(8):
        before = on_host(states.params)
        states = trainer.train(states, settings, (epoch, epoch + 1))
        steps = jax.tree.map(lambda new, old: np.abs(np.asarray(new) - old).max(), states.params, before)
        moved.append(max(jax.tree.leaves(steps)))
    assert moved[-1] < 0.1 * moved[0]


def walk_rows() -> tuple[Rows, StyleDifferences]:
    """Returns random rows of a clip in `mason2018`, and random differences."""
    layout, rng = mason2018(1), np.random.default_rng(0)
    x, y = (rng.normal(size=(40, n)).astype(np.float32) for n in (layout.input_size, layout.output_size))
    one = [Statistics(np.zeros(n, np.float32), np.ones(n, np.float32)) for n in (x.shape[1], y.shape[1])]
    rows = Rows(("old",), (Batch(x, y, rng.uniform(0, 6, 40).astype(np.float32)),), np.array([0, 40]), layout)
    differences = StyleDifferences(x[:24] / 2, y[:24] / 2, rng.uniform(0, 6, 24).astype(np.float32))
    return dataclasses.replace(rows, normaliser=Normaliser(*one)), differences


def test_a_style_is_learned_from_the_clip_and_the_restyled_rows_alike():
    rows, differences = walk_rows()
    config = dataclasses.replace(SINGLE, eval_epochs=(3,), restyled=True, tolerance=0.0)
    sizes = NetworkConfig(rows.layout.input_size, rows.layout.output_size, hidden=8)
    network, clip = init_network(sizes, key=jax.random.key(0)), rows.parts[0]
    found = fit_style(network, rows, config, differences=differences)
    assert rows.normaliser is not None
    restyled = restyle(differences, clip, rows.layout, rows.normaliser)
    both = jax.tree.map(lambda *leaves: np.concatenate(leaves), clip, restyled)
    assert_bitwise(found.style, refit(network, both, found.choice, config))


def test_restyled_rows_need_differences():
    rows, _ = walk_rows()
    sizes = NetworkConfig(rows.layout.input_size, rows.layout.output_size, hidden=8)
    with pytest.raises(ValueError, match="differences"):
        fit_style(init_network(sizes, key=jax.random.key(0)), rows, dataclasses.replace(SINGLE, restyled=True))
