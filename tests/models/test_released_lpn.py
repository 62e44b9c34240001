"""The authors' trained local-phase network: every stage of the forward pass against golden values."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.models.gating import Gating, gate
from pfnn_jax.models.layers.dense import DenseLayer
from pfnn_jax.models.layers.film import FiLMStyle, layer_norm_sample
from pfnn_jax.models.layers.full import BlendedLayer
from pfnn_jax.models.network import Network, num_parameters
from pfnn_jax.models.style import mix_styles
from tests.models.helpers import predict

# Golden values are float64; the constant inside the layer norm's root adds 1e-8 to variances above 5.
FLOAT64 = 1e-7
FLOAT32 = 1e-4  # standard deviations of each output: ten times the rounding error in single precision


Tree = TypeVar("Tree")

EXPERTS, STYLES = 8, 100


class Released(NamedTuple):
    network: Network
    films: FiLMStyle  # leaves [100, 2, 512]
    input_statistics: tuple[np.ndarray, np.ndarray]
    phase_statistics: tuple[np.ndarray, np.ndarray]
    output_statistics: tuple[np.ndarray, np.ndarray]


def read(folder: Path, name: str, *shape: int) -> np.ndarray:
    return np.fromfile(folder / f"{name}.bin", "<f4").reshape(shape)


def blended(folder: Path, layer: int, outputs: int, inputs: int) -> BlendedLayer:
    weights = [read(folder, f"cp{layer}_a{e}", outputs, inputs).T for e in range(EXPERTS)]
    biases = [read(folder, f"cp{layer}_b{e}", outputs) for e in range(EXPERTS)]
    return BlendedLayer(weights=jnp.asarray(np.stack(weights)), biases=jnp.asarray(np.stack(biases)))


def dense(folder: Path, layer: int, outputs: int, inputs: int) -> DenseLayer:
    weights = read(folder, f"wc{layer}_w", outputs, inputs).T
    return DenseLayer(weights=jnp.asarray(weights), biases=jnp.asarray(read(folder, f"wc{layer}_b", outputs)))


def vectors(folder: Path, name: str) -> jax.Array:
    """[S, 2, 512]"""
    rows = [[read(folder, f"Style_{s:03d}_{name}{layer}", 512) for layer in (1, 2)] for s in range(STYLES)]
    return jnp.asarray(np.array(rows))


@pytest.fixture(scope="module")
def released(reference: Path) -> Released:
    folder = reference / "lpn"
    layers = (blended(folder, 0, 512, 348), blended(folder, 1, 512, 512), blended(folder, 2, 342, 512))
    gating = Gating(layers=(dense(folder, 0, 32, 8), dense(folder, 1, 32, 32), dense(folder, 2, 8, 32)))
    return Released(
        network=Network(layers=layers, gating=gating),
        films=FiLMStyle(scale=vectors(folder, "scale"), shift=vectors(folder, "shift")),
        input_statistics=(read(folder, "Xmean", 348), read(folder, "Xstd", 348)),
        phase_statistics=(read(folder, "GT_Xmean", 8), read(folder, "GT_Xstd", 8)),
        output_statistics=(read(folder, "Ymean", 342), read(folder, "Ystd", 342)),
    )


def load(path: Path) -> dict[str, np.ndarray]:
    with np.load(path) as file:
        return dict(file)


def normalised(statistics: tuple[np.ndarray, np.ndarray], values: np.ndarray) -> np.ndarray:
    """Normalises in double precision, like the golden values."""
    mean, std = statistics
    return (values - mean.astype(np.float64)) / std


def in_full_precision(tree: Tree) -> Tree:
    """Returns the tree in float64 if it is enabled; the files hold float32."""
    return jax.tree.map(lambda leaf: leaf.astype(float), tree)


def styles_of(released: Released, golden: dict[str, np.ndarray]) -> FiLMStyle:
    return jax.tree.map(lambda leaf: leaf[golden["style"]], in_full_precision(released.films))


def predict_all(released: Released, golden: dict[str, np.ndarray], **options) -> jax.Array:
    """Returns normalised outputs [N, 342] in the enabled precision."""
    network = in_full_precision(released.network)
    x = jnp.asarray(normalised(released.input_statistics, golden["x"]))
    phase = jnp.asarray(normalised(released.phase_statistics, golden["gating_x"]))
    each = jax.vmap(lambda style, x, p: predict(network, style, x, p, **options))
    return jax.jit(each)(styles_of(released, golden), x, phase)


def test_size(released: Released):
    assert num_parameters(released.network) == 4_935_928


def test_every_stage(released: Released, reference: Path, float64: None):
    golden = load(reference / "lpn_golden_dev.npz")
    network, films = in_full_precision(released.network), styles_of(released, golden)
    gating = network.gating
    assert gating is not None
    phase = jnp.asarray(normalised(released.phase_statistics, golden["gating_x"]))
    c = jax.vmap(gate, (None, 0))(gating, phase)
    np.testing.assert_allclose(c, golden["gating_coeffs"], atol=FLOAT64)
    value = jnp.asarray(normalised(released.input_statistics, golden["x"]))
    for index in (0, 1):
        f = jax.vmap(network.layers[index])(c, value)
        np.testing.assert_allclose(f, golden[f"pre{index + 1}"], rtol=FLOAT64, atol=FLOAT64)
        value = jax.nn.elu(jax.vmap(lambda film, row, i=index: film.modulate(i, row))(films, f))
        np.testing.assert_allclose(value, golden[f"hidden{index + 1}"], atol=FLOAT64)
    y = jax.vmap(network.layers[2])(c, value)
    np.testing.assert_allclose(y, golden["y_norm"], atol=FLOAT64)


def test_predict(released: Released, reference: Path, float64: None):
    golden = load(reference / "lpn_golden_dev.npz")
    np.testing.assert_allclose(predict_all(released, golden), golden["y_norm"], atol=FLOAT64)


def test_predict_with_the_statistics_of_training(released: Released, reference: Path, float64: None):
    golden = load(reference / "lpn_golden_dev.npz")
    expected = normalised(released.output_statistics, golden["y_train_ln"])
    actual = predict_all(released, golden, norm=layer_norm_sample)
    np.testing.assert_allclose(actual, expected, atol=FLOAT64)


def test_predict_in_single_precision(released: Released, reference: Path):
    golden = load(reference / "lpn_golden_dev.npz")
    np.testing.assert_allclose(predict_all(released, golden), golden["y_norm"], atol=FLOAT32)


def test_mixtures_of_three_styles(released: Released, reference: Path, float64: None):
    golden = load(reference / "lpn_golden_mix_dev.npz")
    stacked = jax.tree.map(lambda leaf: leaf[golden["styles"]], in_full_precision(released.films))
    network = in_full_precision(released.network)
    x = jnp.asarray(normalised(released.input_statistics, golden["x"]))
    phase = jnp.asarray(normalised(released.phase_statistics, golden["gating_x"]))
    each = jax.vmap(lambda three, weights, x, p: predict(network, mix_styles(three, weights), x, p))
    y = jax.jit(each)(stacked, jnp.asarray(golden["weights"]), x, phase)
    np.testing.assert_allclose(y, normalised(released.output_statistics, golden["y"]), atol=FLOAT64)
