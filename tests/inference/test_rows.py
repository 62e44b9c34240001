"""Rows from arrays and files; faults of a file are reported by array, row and column."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.inference import rows
from pfnn_jax.inference.lookup import evaluate_lookup, make_lookup
from pfnn_jax.inference.predictor import evaluate, make_predictor
from pfnn_jax.inference.rows import predict_file, predict_rows
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.network import init_network
from pfnn_jax.models.style import init_style
from pfnn_jax.motion.features.layout import mason2018
from pfnn_jax.motion.features.normaliser import Normaliser, Statistics
from pfnn_jax.motion.skeleton import Skeleton, skeleton_to_json
from pfnn_jax.run import create_run, load_run, save_shared, save_style
from pfnn_jax.run_config import RunConfig
from tests.raising import assert_refused

FLOAT32 = 2e-5  # a few ulp over sums of some tens of terms, in another order
LAYOUT = mason2018(2)
WIDTH = LAYOUT.input_size


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("rows") / "run"
    network = NetworkConfig(WIDTH, LAYOUT.output_size, hidden=8)
    skeleton = Skeleton(("A", "B"), np.array([-1, 0]), np.zeros((2, 3)), (), np.arange(2))
    config = RunConfig(network, AdapterConfig(rank=2), "mason2018", 2, ("angry",), skeleton_to_json(skeleton))
    statistics = (Statistics(np.ones(n, np.float32), np.full(n, 2, np.float32)) for n in (WIDTH, LAYOUT.output_size))
    create_run(path, config, Normaliser(*statistics))
    save_shared(path, init_network(network, key=jax.random.key(0)))
    save_style(path, "angry", init_style(config.adapter, network, key=jax.random.key(1)), {})
    return load_run(path)


def make_rows(count=5):
    generator = np.random.default_rng(0)
    return generator.normal(size=(count, WIDTH)), generator.uniform(-7, 14, count)


@pytest.mark.parametrize("style", [None, "angry"])
def test_rows_equal_single_frames(run, style, monkeypatch):
    monkeypatch.setattr(rows, "CHUNK", 3)
    x, phase = make_rows()
    predictor = make_predictor(run, style)
    singles = [evaluate(predictor, jnp.float32(x[i]), jnp.float32(phase[i])) for i in range(5)]
    y = predict_rows(run, x, phase, style)
    assert y.dtype == np.float32
    np.testing.assert_allclose(y, np.stack(singles), atol=FLOAT32)


@pytest.mark.parametrize("mode", ["nearest50", "constant50"])
def test_lookup_modes_equal_the_tables(run, mode):
    x, phase = make_rows()
    lookup = make_lookup(make_predictor(run), mode=mode)
    singles = [evaluate_lookup(lookup, jnp.float32(x[i]), phase[i]) for i in range(5)]
    np.testing.assert_allclose(predict_rows(run, x, phase, mode=mode), np.stack(singles), atol=FLOAT32)


def test_predict_file_writes_the_outputs_of_predict_rows(run, tmp_path):
    x, phase = make_rows()
    np.savez(tmp_path / "in.npz", x=x, phase=phase)
    y = predict_file(run.path, tmp_path / "in.npz", tmp_path / "out.npz", style="angry")
    np.testing.assert_array_equal(np.load(tmp_path / "out.npz")["y"], y)
    np.testing.assert_array_equal(y, predict_rows(run, x, phase, "angry"))
    call = partial(predict_file, run.path, tmp_path / "in.npz", tmp_path / "out.npz")
    assert_refused(call, file="out.npz", place="output", value="exists")
    predict_file(run.path, tmp_path / "in.npz", tmp_path / "out.npz", overwrite=True)


def with_value(array, index, value):
    array = array.copy()
    array[index] = value
    return array


X, PHASE = make_rows()


@pytest.mark.parametrize(
    ("arrays", "place", "value"),
    [
        ({"x": X}, "array phase", "absent"),
        ({"phase": PHASE}, "array x", "absent"),
        ({"x": X[:, :-1], "phase": PHASE}, "array x", f"shape (5, {WIDTH - 1})"),
        ({"x": X[:0], "phase": PHASE[:0]}, "array x", f"shape (0, {WIDTH})"),
        ({"x": X, "phase": PHASE[:4]}, "array phase", "shape (4,)"),
        ({"x": X, "phase": PHASE[:, None]}, "array phase", "shape (5, 1)"),
        ({"x": with_value(X, (3, 7), np.nan), "phase": PHASE}, "array x, row 3, column 7", "nan"),
        ({"x": with_value(X, (1, 0), 1e39), "phase": PHASE}, "array x, row 1, column 0", 1e39),
        ({"x": X, "phase": with_value(PHASE, 2, np.inf)}, "array phase, row 2", "inf"),
        ({"x": X.astype(complex), "phase": PHASE}, "array x", "complex128"),
        ({"x": X.astype(object), "phase": PHASE}, "file", None),
    ],
)
def test_faulty_arrays_are_refused_by_place(run, tmp_path, arrays, place, value):
    np.savez(tmp_path / "in.npz", **arrays)
    call = partial(predict_file, run.path, tmp_path / "in.npz", tmp_path / "out.npz")
    assert_refused(call, file="in.npz", place=place, value=value)
    assert not (tmp_path / "out.npz").exists()


def test_other_files_than_npz_are_refused(run, tmp_path):
    np.save(tmp_path / "one.npy", X)
    (tmp_path / "text.npz").write_text("hello")
    (tmp_path / "empty.npz").write_bytes(b"")
    np.savez(tmp_path / "in.npz", x=X, phase=PHASE)
    (tmp_path / "cut.npz").write_bytes((tmp_path / "in.npz").read_bytes()[:-40])
    found = {
        "one.npy": "a single array",
        "text.npz": "not a NumPy file",  # NumPy itself says that it holds pickled data, and how to load it
        "empty.npz": "No data left in file",
        "cut.npz": "File is not a zip file",
        "absent.npz": "No such file or directory",
    }
    for name, what in found.items():
        call = partial(predict_file, run.path, tmp_path / name, tmp_path / "out.npz")
        assert what in str(assert_refused(call, file=name, place="file", rule_mentions=".npz").value)


def test_an_unknown_style_or_mode_is_refused(run, tmp_path):
    np.savez(tmp_path / "in.npz", x=X, phase=PHASE)
    call = partial(predict_file, run.path, tmp_path / "in.npz", tmp_path / "out.npz", style="proud")
    assert_refused(call, place="style", value="proud", rule_mentions="angry")
    with pytest.raises(ValueError, match="`mode`"):
        predict_rows(run, X, PHASE, mode="linear")  # pyright: ignore[reportArgumentType]
