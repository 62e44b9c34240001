"""Released weights of Holden 2017: control points are recovered, golden rows match, every bad file is named."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfnn_jax.inference.rows import predict_file, predict_rows
from pfnn_jax.interop.released.holden2017 import condition_number, import_released_pfnn, recover_control_points
from pfnn_jax.models.layers.full import BlendedLayer
from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.features.layout import pfnn2017
from pfnn_jax.run import load_run
from tests.raising import assert_refused

GOLDEN = 1e-4  # of Ystd: float32 products over 512 terms come within 5e-6, reduced precision (TF32) does not
ROUNDING = 1e-6  # of float32 tables, before the least squares magnify it
LAYOUT = pfnn2017(31)
HIDDEN = 4
SHAPES = {
    "W0": (HIDDEN, 342),
    "W1": (HIDDEN, HIDDEN),
    "W2": (311, HIDDEN),
    "b0": (HIDDEN,),
    "b1": (HIDDEN,),
    "b2": (311,),
}


def spline(points, index):
    """Returns the four-index cubic of Holden 2017, implemented independently of the package's basis."""
    turns = 4 * index / 50
    k, d = int(turns), turns - int(turns)
    a, b, c, e = (points[(k + n - 1) % 4] for n in range(4))
    square, cube = d * d, d * d * d
    return b + d * (c / 2 - a / 2) + square * (a - 2.5 * b + 2 * c - e / 2) + cube * (1.5 * b - 1.5 * c + e / 2 - a / 2)


def write_release(folder, indices, seed=0):
    generator = np.random.default_rng(seed)
    folder.mkdir()
    points = {name: generator.normal(size=(4, *shape)) for name, shape in SHAPES.items()}
    for name, values in points.items():
        for index in indices:
            spline(values, index).astype("<f4").tofile(folder / f"{name}_{index:03d}.bin")
    for side, size in (("X", 342), ("Y", 311)):
        generator.normal(size=size).astype("<f4").tofile(folder / f"{side}mean.bin")
        generator.uniform(0.5, 2, size).astype("<f4").tofile(folder / f"{side}std.bin")
    return points


@settings(deadline=None, max_examples=40)
@given(st.sets(st.integers(0, 49), min_size=4), st.integers(0, 99))
def test_control_points_are_recovered_up_to_rounding(indices, seed):
    indices = sorted(indices)
    points = np.random.default_rng(seed).normal(size=(4, 3, 2))
    tables = np.stack([spline(points, index) for index in indices]).astype(np.float32)
    condition = condition_number(indices)
    if condition < 1e5:
        found, residual = recover_control_points(tables, indices)
        np.testing.assert_allclose(found, points, atol=ROUNDING * condition)
        assert residual < ROUNDING


def test_tables_within_one_segment_are_ill_conditioned_and_tables_over_the_cycle_are_not():
    assert condition_number([11, 12, 13, 14]) > 1e6
    assert condition_number(range(0, 50, 5)) == pytest.approx(1.43, abs=0.01)


def test_release_is_imported_as_a_run(tmp_path):
    points = write_release(tmp_path / "bins", (0, 9, 13, 25, 38))
    run = import_released_pfnn(tmp_path / "bins", tmp_path / "run")
    for layer, number in zip(run.shared.layers, "012", strict=True):
        assert isinstance(layer, BlendedLayer)
        np.testing.assert_allclose(layer.weights, points[f"W{number}"].swapaxes(1, 2), atol=1e-5)
        np.testing.assert_allclose(layer.biases, points[f"b{number}"], atol=1e-5)
    assert run.config.pretrain["tables"] == [0, 9, 13, 25, 38]
    assert run.config.pretrain["condition_number"] == pytest.approx(condition_number([0, 9, 13, 25, 38]))
    assert max(run.config.pretrain["residual"].values()) < ROUNDING
    assert run.skeleton.roles is not None and run.skeleton.names[run.skeleton.roles.head] == "Head"
    assert_refused(lambda: import_released_pfnn(tmp_path / "bins", tmp_path / "run"), file="run", place="output")
    import_released_pfnn(tmp_path / "bins", tmp_path / "run", overwrite=True)


@pytest.mark.parametrize(
    ("damage", "file", "place", "value"),
    [
        (lambda d: (d / "b1_013.bin").unlink(), "b1_013.bin", "file", "No such file or directory"),
        (lambda d: (d / "Xmean.bin").unlink(), "Xmean.bin", "file", "No such file or directory"),
        (lambda d: (d / "W0_009.bin").write_bytes(b"12345678"), "W0_009.bin", "size", "8 bytes"),
        (lambda d: (d / "b0_000.bin").write_bytes(b"123"), "b0_000.bin", "size", "3 bytes"),
        (lambda d: np.full(HIDDEN, np.nan, "<f4").tofile(d / "b1_025.bin"), "b1_025.bin", "value 0", "nan"),
        (lambda d: np.zeros(311, "<f4").tofile(d / "Ystd.bin"), "Ystd.bin", "column 0", "0.0"),
        (lambda d: np.ones(HIDDEN, "<f4").tofile(d / "b0_050.bin"), "bins", "table index", "50"),
        (lambda d: [f.unlink() for i in (0, 9, 13) for f in d.glob(f"*_{i:03d}.bin")], "bins", "tables", "2"),
        (lambda d: np.ones(HIDDEN, "<f4").tofile(d / "b1_025.bin"), "bins", "tables b1", None),
    ],
)
def test_every_bad_file_is_named_and_nothing_is_written(tmp_path, damage, file, place, value):
    write_release(tmp_path / "bins", (0, 9, 13, 25, 38))
    damage(tmp_path / "bins")
    assert_refused(
        lambda: import_released_pfnn(tmp_path / "bins", tmp_path / "run"), file=file, place=place, value=value
    )
    assert not (tmp_path / "run").exists()


def test_tables_of_lower_rank_and_absent_directories_are_refused(tmp_path):
    write_release(tmp_path / "bins", (11, 12, 13, 14))
    bins, absent, out = tmp_path / "bins", tmp_path / "none", tmp_path / "run"
    assert_refused(lambda: import_released_pfnn(bins, out), place="tables", value="11, 12, 13, 14")
    assert_refused(lambda: import_released_pfnn(absent, out), file="none", place="directory", value="absent")


@pytest.fixture(scope="module")
def released(reference, tmp_path_factory):
    path = tmp_path_factory.mktemp("released") / "run"
    return import_released_pfnn(reference / "pfnn", path)


@pytest.mark.parametrize("mode", ["cubic", "constant50", "nearest50"])
def test_golden_rows(released, reference, mode, tmp_path):
    golden = np.load(reference / "pfnn_golden_dev.npz")
    y = predict_rows(released, golden["x"], golden["phase"], mode=mode)
    error = np.abs(y - golden[f"y_{mode}"]) / released.normaliser.outputs.std
    assert error.max() < GOLDEN
    np.savez(tmp_path / "in.npz", x=golden["x"], phase=golden["phase"])
    predict_file(released.path, tmp_path / "in.npz", tmp_path / "out.npz", mode=mode)
    np.testing.assert_array_equal(np.load(tmp_path / "out.npz")["y"], y)


@pytest.mark.parametrize("mode", ["cubic", "constant50"])
def test_frames_of_a_real_clip(released, reference, mode):
    golden = np.load(reference / "pfnn_real_LocomotionFlat04_000.npz")
    y = predict_rows(released, golden["x"], golden["phase"], mode=mode)
    assert (np.abs(y - golden[f"y_{mode}"]) / released.normaliser.outputs.std).max() < GOLDEN


def test_residuals_of_the_release(released):
    """The released tables lie on a spline through four points up to the rounding of float32 (FORMATS 2.4)."""
    assert released.config.pretrain["condition_number"] == pytest.approx(1.43, abs=0.01)
    assert max(released.config.pretrain["residual"].values()) < 2e-7
    assert load_run(released.path, "pfnn2017").fingerprint == released.fingerprint


def test_skeleton_matches_the_clips(released, mocap):
    clip = read_bvh(mocap / "pfnn" / "LocomotionFlat04_000.bvh")
    assert released.skeleton.names == clip.skeleton.names
    assert released.skeleton.roles == clip.skeleton.roles
    np.testing.assert_array_equal(released.skeleton.parents, clip.skeleton.parents)
    np.testing.assert_array_equal(released.skeleton.mirror, clip.skeleton.mirror)
    # 0.017 m: rest directions are recovered from the network's poses, to 4 degrees of bones of up to 0.4 m
    np.testing.assert_allclose(released.skeleton.offsets[1:], clip.skeleton.offsets[1:], atol=0.017)
