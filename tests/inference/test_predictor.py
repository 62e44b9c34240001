"""Laws of the predictor: the network between normalisation of its inputs and denormalisation of its outputs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.inference.predictor import Predictor, evaluate, make_predictor
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.network import init_network
from pfnn_jax.models.style import init_style
from pfnn_jax.motion.features.layout import mason2018
from pfnn_jax.motion.features.normaliser import Normaliser, Statistics
from pfnn_jax.motion.skeleton import Skeleton, skeleton_to_json
from pfnn_jax.run import create_run, load_run, save_shared, save_style
from pfnn_jax.run_config import RunConfig
from tests.models.helpers import predict
from tests.raising import assert_refused

FLOAT32 = 1e-5  # a few ulp over sums of some tens of terms
LAYOUT = mason2018(2)


def make_statistics(size, seed):
    generator = np.random.default_rng(seed)
    return Statistics(
        generator.normal(size=size).astype(np.float32), generator.uniform(0.5, 2, size).astype(np.float32)
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("predictor") / "run"
    network = NetworkConfig(input_size=LAYOUT.input_size, output_size=LAYOUT.output_size, hidden=8)
    skeleton = Skeleton(("A", "B"), np.array([-1, 0]), np.zeros((2, 3)), (), np.arange(2))
    config = RunConfig(network, AdapterConfig(rank=2), "mason2018", 2, ("angry",), skeleton_to_json(skeleton))
    statistics = Normaliser(make_statistics(LAYOUT.input_size, 0), make_statistics(LAYOUT.output_size, 1))
    create_run(path, config, statistics)
    save_shared(path, init_network(network, key=jax.random.key(0)))
    save_style(path, "angry", init_style(config.adapter, network, key=jax.random.key(1)), {})
    return load_run(path)


@pytest.mark.parametrize("style", [None, "angry"])
def test_predictor_normalises_inputs_and_denormalises_outputs(run, style):
    predictor = make_predictor(run, style)
    assert (predictor.style is None) == (style is None)
    x, phase = jax.random.normal(jax.random.key(2), (LAYOUT.input_size,)), jnp.float32(1.3)
    inner = predict(run.shared, predictor.style, run.normaliser.inputs.apply(x), phase)
    np.testing.assert_allclose(
        evaluate(predictor, x, phase), run.normaliser.outputs.invert(inner), atol=FLOAT32, rtol=FLOAT32
    )


def test_an_unknown_style_is_refused(run):
    assert_refused(lambda: make_predictor(run, "proud"), place="style", value="proud", rule_mentions="angry")


def test_batched_and_compiled_evaluation_equal_single_frames(run):
    predictor = make_predictor(run, "angry")
    x = jax.random.normal(jax.random.key(3), (5, LAYOUT.input_size))
    phase = jnp.linspace(0.0, 6.0, 5)
    batch = jax.jit(jax.vmap(evaluate, (None, 0, 0)))(predictor, x, phase)
    singles = jnp.stack([evaluate(predictor, x[i], phase[i]) for i in range(5)])
    np.testing.assert_allclose(batch, singles, atol=FLOAT32, rtol=FLOAT32)


def test_gradients(run):
    with jax.enable_x64(True):
        predictor: Predictor = jax.tree.map(lambda a: jnp.asarray(a, jnp.float64), make_predictor(run, "angry"))
        x = jnp.asarray(np.random.default_rng(4).normal(size=LAYOUT.input_size))
        phase = jnp.asarray(0.7)  # within a segment: the spline's second derivative jumps at the knots
        check_grads(jax.jit(evaluate), (predictor, x, phase), order=1, modes=("fwd", "rev"))
