"""Pretraining in memory: it learns, repeats itself when resumed, stops when it turns non-finite."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest

from pfnn_jax.errors import TrainingError
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.layers.cp import CPLayer
from pfnn_jax.models.presets import LAYOUT_OF, TABLE2
from pfnn_jax.models.style import init_style
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.data import Rows
from pfnn_jax.training.loop import Progress, TrainState, chunks
from pfnn_jax.training.losses import Objective
from pfnn_jax.training.order import order_of
from pfnn_jax.training.pretraining import init_state, pretrain, styles_of, total_steps
from tests.training.toy import HIDDEN, LAYOUT, STYLES, assert_bitwise, body_rows, on_host, toy_rows

LEARNED = 0.05  # share of the first error left after 400 steps of a problem that the network can solve

SMALL = PretrainConfig(
    adapter=AdapterConfig(rank=3), hidden=HIDDEN, batch_size=8, steps=25, steps_per_dispatch=10, learning_rate=1e-3
)


def with_(config: PretrainConfig, **changes) -> PretrainConfig:
    return PretrainConfig(**{**vars(config), **changes})


def fresh(config: PretrainConfig = SMALL) -> TrainState:
    return init_state(config, LAYOUT, len(STYLES))


def run(config: PretrainConfig = SMALL, data: Rows | None = None, state: TrainState | None = None):
    """(last state, progress of every dispatch, states of every dispatch), all on the host."""
    progress, states = [], []

    def keep(state: TrainState, report: Progress) -> None:
        progress.append(report)
        states.append(on_host(state))

    last = pretrain(data or toy_rows(), config, state=state, state_callback=keep)
    return on_host(last), progress, states


@pytest.fixture(scope="module")
def whole():
    """The uninterrupted run that others are compared with."""
    return run()


def resumed(state: TrainState) -> TrainState:
    """What comes back from disk: the same numbers in new buffers."""
    return jax.tree.map(jax.numpy.asarray, state)


def test_training_reports_every_dispatch(whole):
    last, progress, _ = whole
    assert [report.step for report in progress] == [10, 20, 25]
    assert all(report.steps == 25 and report.loss > 0 and report.frames_per_second > 0 for report in progress)
    assert last.step == 25


def test_training_learns():
    config = with_(SMALL, steps=400, dropout=0.0, steps_per_dispatch=50, learning_rate=5e-3)
    _, progress, _ = run(config)
    assert progress[-1].loss < LEARNED * progress[0].loss


@pytest.mark.parametrize("stop", [0, 1])
def test_a_resumed_run_repeats_the_uninterrupted_one(whole, stop):
    last, progress, states = whole
    again, rest, _ = run(state=resumed(states[stop]))
    assert_bitwise(again, last)
    assert [report.loss for report in rest] == [report.loss for report in progress[stop + 1 :]]


def test_a_run_of_fewer_steps_is_the_beginning_of_a_longer_one(whole):
    _, _, states = whole
    shorter, _, _ = run(with_(SMALL, steps=20))
    assert_bitwise(shorter, states[1])


def test_the_size_of_dispatches_changes_nothing(whole):
    last, _, _ = whole
    one_by_one, _, _ = run(with_(SMALL, steps_per_dispatch=4))
    assert_bitwise(one_by_one, last)


def test_data_in_host_memory_trains_as_data_on_the_device(whole):
    last, _, _ = whole
    from_host, _, _ = run(with_(SMALL, device_bytes=0))
    assert_bitwise(from_host, last)


def test_the_state_depends_on_the_configuration_alone():
    assert_bitwise(fresh(), fresh())
    other = fresh(with_(SMALL, seed=1))
    assert not np.array_equal(jax.tree.leaves(other.params.shared)[0], jax.tree.leaves(fresh().params.shared)[0])
    assert jax.tree.leaves(other.params.modulation)[0].shape[0] == len(STYLES)


def test_every_style_starts_from_an_adapter_of_its_own():
    bank = fresh().params.modulation
    assert isinstance(bank, CPLayer)
    assert bank.a.shape == (3, HIDDEN, 3)
    assert not np.array_equal(bank.a[0], bank.a[1])


def test_the_length_of_training():
    order = order_of(toy_rows((24, 40, 31)), 8, seed=0)
    assert total_steps(with_(SMALL, steps=None, epochs=4), order) == 4 * 3 * 3
    assert total_steps(SMALL, order) == 25


def test_dispatches_end_at_multiples_of_their_size():
    assert chunks(0, 25, 10) == [(0, 10), (10, 10), (20, 5)]
    assert chunks(13, 25, 10) == [(13, 7), (20, 5)]
    assert chunks(25, 25, 10) == []


def test_epochs_end_within_a_dispatch():
    config = with_(SMALL, steps=None, epochs=3)  # 9 steps an epoch in dispatches of 10
    last, progress, _ = run(config)
    assert [report.step for report in progress] == [10, 20, 27]
    assert last.step == 27


@pytest.mark.parametrize("device_bytes", [0, 2**32])
def test_training_that_turns_non_finite_names_the_step_and_the_style(device_bytes):
    data = toy_rows()
    data.parts[0].x[24:48] = np.nan  # of style "old", whose first turn is step 1
    kept = []
    with pytest.raises(TrainingError) as raised:
        pretrain(data, with_(SMALL, device_bytes=device_bytes), state_callback=lambda *seen: kept.append(seen))
    assert (raised.value.step, raised.value.style) == (1, "old")
    assert "step 1" in str(raised.value) and "old" in str(raised.value)
    assert not kept  # no callback saw, and so none saved, that state


def test_a_style_shorter_than_a_batch_is_refused():
    with pytest.raises(ValueError, match="at most the 5 rows"):
        run(data=toy_rows((24, 5, 24)))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("epochs", 0),
        ("steps", 0),
        ("batch_size", 0),
        ("steps_per_dispatch", 0),
        ("save_every", 0),
        ("dropout", 1.0),
        ("dropout", -0.1),
        ("learning_rate", 0.0),
        ("clips_per_batch", 0),
        ("l1", -0.1),
        ("bone_length", -1.0),
        ("seed", -1),
    ],
)
def test_a_configuration_out_of_range_is_refused(name, value):
    with pytest.raises(ValueError, match=f"PretrainConfig.{name} must .*got {value}"):
        with_(SMALL, **{name: value})


def test_clips_must_divide_the_batch():
    with pytest.raises(ValueError, match="clips_per_batch must divide batch_size 8, got 3"):
        with_(SMALL, adapter=AdapterConfig("film"), clips_per_batch=3)


def test_the_weights_of_the_loss_are_those_of_the_layouts_paper():
    assert Objective.for_layout(LAYOUT) == Objective(l1=0.01, bone_length=0.0)
    new = body_rows().layout
    assert Objective.for_layout(new) == Objective(l1=0.0, bone_length=1.0)
    assert Objective.for_layout(new, l1=0.5, bone_length=0.0) == Objective(l1=0.5, bone_length=0.0)


def test_a_bone_length_loss_needs_the_bones():
    with pytest.raises(ValueError, match="`rows` must have `parents` and a `normaliser`"):
        pretrain(toy_rows(), with_(SMALL, bone_length=1.0))


def small_model(name: str) -> tuple[PretrainConfig, Rows]:
    """A model of the papers in small, and rows of its layout."""
    preset = TABLE2[name]
    config = with_(
        SMALL,
        adapter=dataclasses.replace(preset.adapter, rank=3),
        steps=6,
        steps_per_dispatch=3,
        clips_per_batch=2,
        generator_filters=4,
        generator_width=5,
        generator_hidden=8,
    )
    return config, body_rows(LAYOUT_OF[preset.backbone])


@pytest.mark.parametrize("name", TABLE2)
def test_every_model_of_the_papers_trains(name):
    config, data = small_model(name)
    losses = []
    start = init_state(config, data.layout, 3)
    before = on_host(start)
    state = pretrain(data, config, state=start, progress_callback=lambda report: losses.append(report.loss))
    assert len(losses) == 2 and np.isfinite(losses).all()
    for part, old in ((state.params.shared, before.params.shared), (state.params.modulation, before.params.modulation)):
        pairs = zip(jax.tree.leaves(part), jax.tree.leaves(old), strict=True)
        assert all(not np.array_equal(new, first) for new, first in pairs)
    one = init_style(config.adapter, config.network(data.layout), key=jax.random.key(0))
    bank = styles_of(state, data)
    assert [leaf.shape for leaf in jax.tree.leaves(bank)] == [(3, *leaf.shape) for leaf in jax.tree.leaves(one)]


@pytest.mark.parametrize("name", ["lpn_resad", "pfnn_film"])
def test_models_resume_bit_for_bit_and_from_rows_in_host_memory(name):
    config, data = small_model(name)
    states = []
    last = pretrain(data, config, state_callback=lambda state, _: states.append(on_host(state)))
    elsewhere = with_(config, steps_per_dispatch=2, device_bytes=0)
    assert_bitwise(pretrain(data, elsewhere, state=resumed(states[0])), last)
