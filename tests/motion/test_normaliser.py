"""Normaliser: exact statistics, grouped averages by the authors' rule, round trips, refusals."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pfnn_jax.motion.features.layout import mason2018, mason2022, mason2022_mann, pfnn2017
from pfnn_jax.motion.features.normaliser import (
    ROWS_PER_PASS,
    Statistics,
    fit_normaliser,
    load_normaliser,
    save_normaliser,
)
from tests.raising import assert_refused

FLOAT32 = 1e-6  # relative; one rounding of each statistic to float32
LAYOUT = mason2018(2)


@pytest.fixture
def rows() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    x = rng.normal(3.0, rng.uniform(0.1, 5.0, LAYOUT.input_size), (500, LAYOUT.input_size))
    y = rng.normal(-1.0, rng.uniform(0.1, 5.0, LAYOUT.output_size), (500, LAYOUT.output_size))
    return x.astype(np.float32), y.astype(np.float32)


def test_normalised_rows_have_zero_mean_and_unit_std(rows):
    normaliser = fit_normaliser(rows[0], rows[1], LAYOUT)
    z = normaliser.inputs.apply(rows[0].astype(np.float64))
    np.testing.assert_allclose(z.mean(axis=0), 0.0, atol=1e-5)
    np.testing.assert_allclose(z.std(axis=0), 1.0, rtol=1e-5)
    np.testing.assert_allclose(normaliser.outputs.std, rows[1].astype(np.float64).std(axis=0), rtol=FLOAT32)


def test_invert_undoes_apply_and_constant_columns_stay_finite(rows):
    x, y = rows
    x[:, 6] = 1.0  # as the direction of the present sample
    normaliser = fit_normaliser(x, y, LAYOUT)
    assert normaliser.inputs.std[6] == 1.0
    np.testing.assert_allclose(normaliser.inputs.invert(normaliser.inputs.apply(x)), x, rtol=1e-5, atol=1e-5)


def test_rounding_of_a_constant_column_does_not_count_as_std(rows):
    x, y = rows
    x[:, 6] = 1.0 + 1e-7 * np.sign(x[:, 0])
    assert fit_normaliser(x, y, LAYOUT).inputs.std[6] == 1.0


def test_several_arrays_and_several_chunks_count_as_one(rows):
    x, y = rows
    x, y = np.tile(x, (ROWS_PER_PASS // 250, 1)), np.tile(y, (ROWS_PER_PASS // 250, 1))
    whole = fit_normaliser(x, y, LAYOUT)
    parts = fit_normaliser([x[:300], x[300:]], [y[:300], y[300:]], LAYOUT)
    np.testing.assert_allclose(parts.inputs.mean, whole.inputs.mean, rtol=1e-5)
    np.testing.assert_allclose(parts.outputs.std, whole.outputs.std, rtol=FLOAT32)


def test_grouped_stds_are_block_averages_with_joint_inputs_divided_by_a_tenth(rows):
    plain, grouped = (fit_normaliser(rows[0], rows[1], LAYOUT, grouped=g) for g in (False, True))
    for block, weight in (("trajectory_position_x", 1.0), ("joint_position", 0.1), ("joint_velocity", 0.1)):
        at = LAYOUT.input_slice(block)
        np.testing.assert_allclose(grouped.inputs.std[at], plain.inputs.std[at].mean() / weight, rtol=1e-5)
    for block in ("joint_position", "joint_velocity", "joint_up", "root_velocity"):
        at = LAYOUT.output_slice(block)
        np.testing.assert_allclose(grouped.outputs.std[at], plain.outputs.std[at].mean(), rtol=1e-5)
    both = np.r_[LAYOUT.output_slice("trajectory_position_x"), LAYOUT.output_slice("trajectory_position_z")]
    np.testing.assert_allclose(grouped.outputs.std[both], plain.outputs.std[both].mean(), rtol=1e-5)
    np.testing.assert_array_equal(grouped.inputs.mean, plain.inputs.mean)


def test_grouped_blocks_are_those_of_the_published_statistics(reference):
    """The released PFNN's stds are constant over exactly the blocks averaged here."""
    layout = pfnn2017()
    std = np.fromfile(reference / "pfnn" / "Ystd.bin", "<f4")
    rng = np.random.default_rng(1)
    x = rng.normal(size=(50, layout.input_size)).astype(np.float32)
    y = (rng.normal(size=(50, layout.output_size)) * std).astype(np.float32)
    ours = fit_normaliser(x, y, layout, grouped=True).outputs.std
    for block in layout.output_blocks:
        at = layout.output_slice(block)
        assert len(set(std[at].tolist())) == len(set(ours[at].tolist())) == 1


def test_saving_and_loading_is_exact(rows, tmp_path):
    normaliser = fit_normaliser(rows[0], rows[1], LAYOUT)
    save_normaliser(tmp_path / "n", normaliser)
    loaded = load_normaliser(tmp_path / "n")
    for side in ("inputs", "outputs"):
        for field in dataclasses.fields(Statistics):
            wanted = getattr(getattr(normaliser, side), field.name)
            np.testing.assert_array_equal(getattr(getattr(loaded, side), field.name), wanted)


def test_non_finite_rows_are_refused_by_block(rows):
    x, y = rows
    y[17, LAYOUT.output_slice("joint_up")][2] = np.nan
    assert_refused(lambda: fit_normaliser(x, y, LAYOUT), file="y", place="array row 17, joint_up", value=np.nan)


def test_wrong_width_and_no_rows_are_refused(rows):
    x, y = rows
    assert_refused(lambda: fit_normaliser(x[:, :-1], y, LAYOUT), file="x", place="array", rule_mentions="60")
    assert_refused(lambda: fit_normaliser(x[:0], y[:0], LAYOUT), file="x", place="array", value="0 rows")


def test_damaged_files_are_refused(rows, tmp_path):
    normaliser = fit_normaliser(rows[0], rows[1], LAYOUT)
    save_normaliser(tmp_path, normaliser)
    np.save(tmp_path / "x_std.npy", np.zeros(LAYOUT.input_size, np.float32))
    assert_refused(lambda: load_normaliser(tmp_path), file="x_std.npy", place="array")
    save_normaliser(tmp_path, normaliser)
    (tmp_path / "y_mean.npy").write_bytes(b"no array")
    assert_refused(lambda: load_normaliser(tmp_path), file="y_mean.npy", place="array")


# interleaved layouts and phases


def test_interleaved_blocks_are_averaged_as_blocks(rows):
    layout, rng = mason2022(2), np.random.default_rng(1)
    x, y = (rng.normal(size=(50, size)) * rng.uniform(1, 5, size) for size in (layout.input_size, layout.output_size))
    plain, grouped = (fit_normaliser(x, y, layout, grouped=g) for g in (False, True))
    at = layout.input_slice("joint_velocity")
    np.testing.assert_allclose(grouped.inputs.std[at], plain.inputs.std[at].mean() / 0.1, rtol=1e-5)
    at = np.r_[layout.output_slice("trajectory_position_x"), layout.output_slice("trajectory_position_z")]
    np.testing.assert_allclose(grouped.outputs.std[at], plain.outputs.std[at].mean(), rtol=1e-5)


@pytest.mark.parametrize("layout", [mason2022(2), mason2022_mann(2)], ids=lambda layout: layout.name)
def test_a_gating_input_has_statistics_that_files_keep(layout, tmp_path):
    rng = np.random.default_rng(2)
    x, y = (rng.normal(size=(40, size)).astype(np.float32) for size in (layout.input_size, layout.output_size))
    phase = (rng.normal(size=(40, layout.phase_size)) * 3 + 1).astype(np.float32)
    phase[:, 2:4] = 0.0  # a bone that never moves
    normaliser = fit_normaliser(x, y, layout, phase=phase)
    assert normaliser.phases is not None
    z = normaliser.phases.apply(phase.astype(np.float64))
    np.testing.assert_allclose(z.mean(axis=0), 0.0, atol=1e-5)
    assert (normaliser.phases.std[2:4] == 1.0).all() and (z[:, 2:4] == 0.0).all()
    save_normaliser(tmp_path, normaliser)
    phases = load_normaliser(tmp_path).phases
    assert phases is not None and (phases.mean == normaliser.phases.mean).all()
    assert (phases.std == normaliser.phases.std).all()
    narrow = phase[:, 1:]
    refused = assert_refused(lambda: fit_normaliser(x, y, layout, phase=narrow), file="phase")
    assert str(layout.phase_size) in refused.rule
    assert (normaliser.initial_phase() == normaliser.phases.mean).all()
    (tmp_path / "p_std.npy").unlink()
    assert_refused(lambda: load_normaliser(tmp_path), file="p_std.npy")


def test_a_scalar_phase_has_no_statistics(rows, tmp_path):
    normaliser = fit_normaliser(rows[0], rows[1], LAYOUT, phase=np.zeros(500))
    assert normaliser.phases is None and normaliser.initial_phase().shape == () and normaliser.initial_phase() == 0.0
    (tmp_path / "p_std.npy").touch()
    save_normaliser(tmp_path, normaliser)
    assert load_normaliser(tmp_path).phases is None
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x_mean.npy", "x_std.npy", "y_mean.npy", "y_std.npy"]
