"""The FiLM generator and the models of Mason 2022 Table 2: exact sizes, the formula in loops, and batching."""

from __future__ import annotations

import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.models.config import GeneratorConfig
from pfnn_jax.models.film_generator import FiLMGenerator
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.models.network import num_parameters
from pfnn_jax.models.presets import LAYOUT_OF, TABLE2, Backbone, counts, network_config, paper_count
from tests.models.helpers import normal, randomise, shapes

FLOAT64 = 1e-10  # sums of a hundred terms of size ten in double precision

KEY = jax.random.key(31)
TINY = GeneratorConfig(features=3, clip_frames=12, filters=4, width=5, hidden=6, film_hidden=2)


def tiny() -> FiLMGenerator:
    """Returns a generator whose biases are not zero."""
    return randomise(jax.eval_shape(lambda: FiLMGenerator.init(TINY, key=KEY)), 1)


def clip(seed: int = 2, *batch: int) -> jax.Array:
    return normal(seed, *batch, TINY.clip_frames, TINY.features)


def slow_convolution(value: np.ndarray, kernel: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Computes each frame from the `width` frames around it, with zeros beyond the ends."""
    half = kernel.shape[0] // 2
    padded = np.pad(value, ((half, half), (0, 0)))
    return np.stack([np.einsum("wi,wio->o", padded[t : t + len(kernel)], kernel) + bias for t in range(len(value))])


def test_generator_equals_its_formula(float64: None):
    """Computes twice convolution, ReLU and max-pooling, then two dense layers (Mason 2022 §4.3), with loops."""
    generator = jax.tree.map(np.asarray, tiny())
    value = np.asarray(clip())
    for layer in (generator.conv1, generator.conv2):
        value = np.maximum(slow_convolution(value, layer.kernel, layer.bias), 0)
        value = value.reshape(-1, 2, TINY.filters).max(axis=1)
    hidden = np.maximum(value.reshape(-1) @ generator.dense1.kernel + generator.dense1.bias, 0)
    expected = FiLMStyle.from_vector(hidden @ generator.dense2.kernel + generator.dense2.bias)
    film = tiny()(clip())
    np.testing.assert_allclose(film.scale, expected.scale, atol=FLOAT64)
    np.testing.assert_allclose(film.shift, expected.shift, atol=FLOAT64)


def test_size_of_the_papers_generator():
    """The paper's own count omits the inputs of the convolutions."""
    config = GeneratorConfig(features=300)
    generator = jax.eval_shape(lambda: FiLMGenerator.init(config, key=KEY))
    assert shapes(generator) == {
        ".conv1.kernel": ((25, 300, 256), "float32"),
        ".conv1.bias": ((256,), "float32"),
        ".conv2.kernel": ((25, 256, 256), "float32"),
        ".conv2.bias": ((256,), "float32"),
        ".dense1.kernel": ((15360, 2048), "float32"),
        ".dense1.bias": ((2048,), "float32"),
        ".dense2.kernel": ((2048, 2048), "float32"),
        ".dense2.bias": ((2048,), "float32"),
    }
    assert num_parameters(generator) == 39_214_592
    assert paper_count(config) == 35_668_530


def test_dropout_acts_after_the_first_dense_layer_only():
    """If everything is dropped, only the last bias remains."""
    generator = tiny()
    film = generator(clip(), dropout=jnp.asarray(1.0), key=KEY)
    left = FiLMStyle.from_vector(generator.dense2.bias)
    np.testing.assert_array_equal(film.scale, left.scale)
    np.testing.assert_array_equal(film.shift, left.shift)
    kept = generator(clip(), dropout=jnp.asarray(0.0), key=KEY)
    np.testing.assert_array_equal(kept.scale, generator(clip()).scale)


def test_dropout_keeps_or_drops_each_hidden_number(float64: None):
    """The output is linear in the dropped numbers: at rate 1/2 it is one of the 2^6 doubled partial sums."""
    fresh = tiny()
    last = replace(fresh.dense2, bias=jnp.zeros_like(fresh.dense2.bias))
    generator = replace(fresh, dense2=last)
    kernels = [last.kernel * jnp.eye(6)[:, i : i + 1] for i in range(6)]
    without = [replace(generator, dense2=replace(last, kernel=kernel))(clip()).scale[0, 0] for kernel in kernels]
    dropped = generator(clip(), dropout=jnp.asarray(0.5), key=KEY).scale[0, 0]
    choices = (np.arange(64)[:, None] >> np.arange(6)) & 1
    assert np.abs(choices @ (2 * np.asarray(without)) - float(dropped)).min() < FLOAT64


def test_dropout_needs_a_key():
    with pytest.raises(ValueError, match="`key` is needed where `dropout` is given, got None"):
        tiny()(clip(), dropout=jnp.asarray(0.3))


def test_gradients(float64: None):
    check_grads(jax.jit(lambda generator, clip: generator(clip)), (tiny(), clip()), order=1, modes=("fwd", "rev"))


def test_a_batch_is_its_clips_one_by_one(float64: None):
    clips = clip(3, 4)
    batched = jax.vmap(tiny())(clips)
    for index in range(4):
        one = tiny()(clips[index])
        np.testing.assert_allclose(batched.scale[index], one.scale, atol=FLOAT64)


def test_a_batch_is_one_convolution_in_each_layer():
    """Two forward; backward, three more: for the weights of both layers and the input of the second."""

    def batched(generator: FiLMGenerator, clips: jax.Array) -> FiLMStyle:
        return jax.vmap(generator)(clips)

    def loss(generator, clips):
        film = batched(generator, clips)
        return (film.scale**2).mean() + (film.shift**2).mean()

    clips = clip(3, 7)
    forward_text = jax.jit(batched).lower(tiny(), clips).as_text()
    backward_text = jax.jit(jax.grad(loss)).lower(tiny(), clips).as_text()
    assert len(re.findall(r"stablehlo\.convolution\(", forward_text)) == 2
    assert len(re.findall(r"stablehlo\.convolution\(", backward_text)) == 5
    for text in (forward_text, backward_text):
        assert "feature_group_count = 1" in text and "feature_group_count = 7" not in text
        assert "stablehlo.while" not in text


def test_number_of_frames_follows_from_the_parameters():
    assert tiny().clip_frames == TINY.clip_frames


def test_initial_weights_are_uniform_with_zero_biases_and_follow_the_key():
    config = GeneratorConfig(features=24, clip_frames=16, filters=32, width=5, hidden=64, film_hidden=16)
    one, again, other = (FiLMGenerator.init(config, key=jax.random.key(seed)) for seed in (0, 0, 1))
    for name, fan in (("conv1", 5 * (24 + 32)), ("conv2", 5 * 64), ("dense1", 4 * 32 + 64), ("dense2", 64 + 64)):
        bound, layer = np.sqrt(6 / fan), getattr(one, name)
        assert 0.9 * bound < np.abs(layer.kernel).max() <= bound * (1 + 1e-6)
        assert (layer.bias == 0).all()
        assert (layer.kernel == getattr(again, name).kernel).all()
        assert (layer.kernel != getattr(other, name).kernel).any()


def test_a_clip_of_another_length_is_refused():
    with pytest.raises(AssertionError):
        tiny()(clip()[:-4])


def test_messages_of_the_config():
    with pytest.raises(ValueError, match=r"GeneratorConfig.width must be at least 1, got 0\."):
        GeneratorConfig(features=300, width=0)
    with pytest.raises(ValueError, match=r"GeneratorConfig.clip_frames must be a multiple of 4, got 242\."):
        GeneratorConfig(features=300, clip_frames=242)


@pytest.mark.parametrize(
    ("name", "synthesis", "modulation", "per_style", "published"),
    [
        ("pfnn_one_hot", 2_436_380, 194_560, 2_048, 194_560),
        ("lpn_one_hot", 4_935_928, 389_120, 4_096, 389_120),
        ("pfnn_resad", 2_436_380, 2_978_440, 31_352, 2_978_440),
        ("lpn_resad", 4_935_928, 24_952_320, 262_656, 24_952_320),
        ("pfnn_film", 2_436_380, 39_214_592, 2_048, 35_668_530),
        ("mann_film", 4_870_392, 39_214_592, 2_048, 35_668_530),
        ("lpn_film", 4_935_928, 39_214_592, 2_048, 35_668_530),
    ],
)
def test_counts_of_table_2(name: str, synthesis: int, modulation: int, per_style: int, published: int):
    """Mason 2022 Table 2, and the true count of the generator next to the printed one."""
    count = counts(name)
    assert (count.synthesis, count.modulation, count.per_style) == (synthesis, modulation, per_style)
    assert count.modulation_published == published


def test_table_2_has_seven_models_each_with_a_layout():
    assert len(TABLE2) == 7
    assert {preset.backbone for preset in TABLE2.values()} == set(LAYOUT_OF)


@pytest.mark.parametrize(
    ("backbone", "outputs", "phases", "experts"), [("pfnn", 327, 0, 4), ("mann", 326, 12, 8), ("lpn", 342, 8, 8)]
)
def test_sizes_of_the_backbones(backbone: Backbone, outputs: int, phases: int, experts: int):
    config = network_config(backbone)
    assert (config.input_size, config.output_size) == (348, outputs)
    assert (config.phase_size, config.num_control_points, config.hidden) == (phases, experts, 512)
    assert network_config(backbone, num_joints=21, hidden=16).input_size == 48 + 12 * 21


def test_unknown_names_are_refused():
    with pytest.raises(ValueError, match="`name` must be one of pfnn_one_hot, .*, got 'gpt'"):
        counts("gpt")
