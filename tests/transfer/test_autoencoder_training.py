"""Training of the motion autoencoder: Eq. 3, statistics, reproducibility, and errors."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.errors import TrainingError
from pfnn_jax.training.loop import Progress
from pfnn_jax.transfer.autoencoder import init_autoencoder
from pfnn_jax.transfer.autoencoder_training import autoencoder_loss, fit_statistics, train_autoencoder
from pfnn_jax.transfer.config import AutoencoderConfig, AutoencoderTrainingConfig
from pfnn_jax.transfer.layout import HOLDEN2016, HOLDEN2017
from pfnn_jax.transfer.window_training import draw_order
from tests.raising import assert_refused

FLOAT64 = 1e-12

CHUNKED = 1e-6
"""By which float32 parameters differ when the same steps are compiled in other chunks."""

SMALL = AutoencoderTrainingConfig(AutoencoderConfig(6, 5), steps=30, batch_size=2, steps_per_dispatch=10)


def waves(count: int, seed: int = 0, frames: int = 16, size: int = 3) -> np.ndarray:
    """Returns normalised windows of sine waves, which a small autoencoder can learn."""
    rng = np.random.default_rng(seed)
    time, phase = np.arange(frames)[None, :, None], rng.uniform(0, 2 * np.pi, (count, 1, size))
    return np.sqrt(2) * np.sin(0.4 * time + phase)


def assert_equal(a, b, atol: float = 0.0) -> None:
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=atol, rtol=0), a, b)


def test_training_lowers_the_error_of_motion_that_it_has_not_seen():
    config = replace(SMALL, steps=200, learning_rate=1e-2)
    held_out = jnp.asarray(waves(8, seed=1), jnp.float32)
    before = autoencoder_loss(init_autoencoder(SMALL.autoencoder, 3, key=jax.random.key(0)), held_out, config)[1]
    after = autoencoder_loss(train_autoencoder(waves(32), config), held_out, config)[1]
    assert after < 0.3 * before


def test_equal_seeds_give_equal_autoencoders_whatever_the_chunks():
    first = train_autoencoder(waves(5), SMALL)
    assert_equal(train_autoencoder(waves(5), SMALL), first)
    assert_equal(train_autoencoder(waves(5), replace(SMALL, steps_per_dispatch=7)), first, CHUNKED)
    other = train_autoencoder(waves(5), replace(SMALL, seed=1))
    assert not np.allclose(other.encoder.filters, first.encoder.filters)


def test_progress_reports_every_chunk():
    found: list[Progress] = []
    train_autoencoder(waves(5), SMALL, progress_callback=found.append)
    assert [report.step for report in found] == [10, 20, 30]
    assert all(np.isfinite(report.loss) and report.steps == 30 for report in found)


def test_every_epoch_takes_every_window_once():
    order = draw_order(10, 10, SMALL.batch_size, SMALL.seed).reshape(-1)
    assert sorted(order[:10]) == sorted(order[10:20]) == list(range(10))
    assert list(order[:10]) != list(order[10:20])


@pytest.mark.parametrize("tied", [True, False], ids=("tied", "untied"))
def test_loss_is_squared_error_and_mean_absolute_weight(tied: bool, float64: None):
    config = replace(SMALL, l1=0.3)
    autoencoder = init_autoencoder(replace(config.autoencoder, tied=tied), 3, key=jax.random.key(4))
    x = jnp.asarray(waves(3))
    loss, error = autoencoder_loss(autoencoder, x, config)
    found = np.stack([autoencoder.project(window) for window in x])
    np.testing.assert_allclose(error, np.mean((found - np.asarray(x)) ** 2), atol=FLOAT64)
    layers = [autoencoder.encoder, autoencoder.decoder] if autoencoder.decoder else [autoencoder.encoder]
    penalty = np.mean([np.abs(layer.filters).mean() for layer in layers])
    np.testing.assert_allclose(loss, error + 0.3 * penalty, atol=FLOAT64)


def test_gradients_of_the_loss_are_those_of_finite_differences(float64: None):
    autoencoder = init_autoencoder(AutoencoderConfig(3, 3), 3, key=jax.random.key(4))
    x = jnp.asarray(waves(2, frames=6))
    check_grads(lambda params: autoencoder_loss(params, x, SMALL)[0], (autoencoder,), order=1, modes=("rev",), eps=1e-6)


def test_dropout_hides_numbers_only_in_training():
    config = replace(SMALL, dropout=0.5)
    autoencoder, x = init_autoencoder(SMALL.autoencoder, 3, key=jax.random.key(4)), jnp.asarray(waves(3), jnp.float32)
    assert autoencoder_loss(autoencoder, x, config)[1] == autoencoder_loss(autoencoder, x, SMALL)[1]
    dropped = autoencoder_loss(autoencoder, x, config, jax.random.key(0))[1]
    assert dropped != autoencoder_loss(autoencoder, x, config, jax.random.key(1))[1]


@pytest.mark.parametrize("layout", [HOLDEN2017, HOLDEN2016], ids=lambda layout: layout.name)
def test_statistics_have_one_standard_deviation_for_each_block(layout):
    rows = np.random.default_rng(0).normal(3.0, 1.0, (4, 50, layout.size)) * np.linspace(0.5, 2.0, layout.size)
    statistics = fit_statistics(rows, layout)
    np.testing.assert_allclose(statistics.mean, rows.mean(axis=(0, 1)), rtol=1e-6)
    blocks = [layout.joint_position, layout.root_velocity, layout.root_yaw_rate, layout.foot_contacts]
    normalised = statistics.apply(rows).reshape(-1, layout.size)
    for block in blocks:
        assert len(set(statistics.std[block])) == min(1, statistics.std[block].size)
        if statistics.std[block].size:
            np.testing.assert_allclose(np.mean(normalised[:, block] ** 2), 1.0, rtol=1e-5)


def test_a_block_that_never_changes_keeps_its_scale():
    rows = np.random.default_rng(0).normal(size=(20, HOLDEN2017.size))
    rows[:, HOLDEN2017.root_velocity] = 0.25
    statistics = fit_statistics(rows, HOLDEN2017)
    assert (statistics.std[HOLDEN2017.root_velocity] == 1.0).all()


# Bad input


def test_bad_rows_are_refused():
    rows = np.zeros((3, HOLDEN2017.size))
    assert_refused(lambda: fit_statistics(rows[:0], HOLDEN2017), place="rows", value="shape (0, 66)")
    assert_refused(lambda: fit_statistics(rows, HOLDEN2016), place="rows", value="shape (3, 66)")
    rows[1, 7] = np.nan
    assert_refused(lambda: fit_statistics(rows, HOLDEN2017), place="row 1, column 7", value="nan")


@pytest.mark.parametrize("shape", [(0, 16, 3), (4, 15, 3), (16, 3)])
def test_windows_of_other_shapes_are_refused(shape: tuple[int, ...]):
    with pytest.raises(ValueError, match="`windows` must be"):
        train_autoencoder(np.zeros(shape), SMALL)


def test_a_loss_that_is_not_finite_ends_training():
    windows = waves(4)
    windows[2, 5, 1] = np.nan
    with pytest.raises(TrainingError):
        train_autoencoder(windows, SMALL)


@pytest.mark.parametrize(
    "wrong", [{"steps": 0}, {"batch_size": 0}, {"learning_rate": 0.0}, {"l1": -1.0}, {"dropout": 1.0}, {"seed": -1}]
)
def test_impossible_settings_are_refused(wrong: dict):
    with pytest.raises(ValueError, match=f"AutoencoderTrainingConfig.{next(iter(wrong))} must"):
        AutoencoderTrainingConfig(**wrong)
