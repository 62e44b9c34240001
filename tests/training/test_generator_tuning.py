"""Tuning a generator: what stays frozen, what it gives, and that it learns the style."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.training.config import PretrainConfig, TuningConfig
from pfnn_jax.training.film_styles import mean_styles
from pfnn_jax.training.pretraining import init_state
from pfnn_jax.training.steps import predict_batch
from pfnn_jax.training.tuning import tune_generator
from tests.training.toy import HIDDEN, assert_bitwise, body_rows, on_host

PRETRAINED = PretrainConfig(
    adapter=AdapterConfig("film"),
    hidden=HIDDEN,
    batch_size=8,
    generator_filters=4,
    generator_width=5,
    generator_hidden=8,
)
TUNING = TuningConfig(steps=60, batch_size=8, clips_per_batch=2, learning_rate=1e-2, dropout=0.0, bone_length=0.0)
LEARNED = 0.3  # share of the first error left after 60 steps; a single FiLM style would leave none


@pytest.fixture(scope="module")
def pretrained():
    return init_state(PRETRAINED, body_rows().layout, 3)


def style(pretrained):
    """Returns 30 rows of a style that the frozen network can produce: its outputs with some FiLM style."""
    data = body_rows(num_frames=(30,), seed=4)
    film = FiLMStyle(scale=jnp.full((2, HIDDEN), 3.0), shift=jnp.full((2, HIDDEN), 2.0))
    y = predict_batch(pretrained.params.shared, film, data.parts[0], None, None)
    return dataclasses.replace(data, parts=(dataclasses.replace(data.parts[0], y=np.asarray(y)),))


def tune(pretrained, config: TuningConfig = TUNING):
    data = style(pretrained)
    sizes = PRETRAINED.generator(data.layout)
    assert sizes is not None
    return tune_generator(pretrained.params.shared, pretrained.params.modulation, data, config), sizes


def test_only_the_generator_changes_and_it_learns(pretrained):
    before = on_host((pretrained.params.shared, pretrained.params.modulation))
    tuned, sizes = tune(pretrained)
    assert_bitwise((pretrained.params.shared, pretrained.params.modulation), before)
    assert not np.array_equal(jax.tree.leaves(tuned.generator)[0], jax.tree.leaves(before[1])[0])
    assert tuned.losses.shape == (60,)
    assert tuned.losses[-5:].mean() < LEARNED * tuned.losses[:5].mean()
    films = mean_styles(tuned.generator, style(pretrained))
    assert_bitwise(tuned.style, jax.tree.map(lambda leaf: leaf[0], films))


def test_tuning_depends_on_its_settings_alone(pretrained):
    short = dataclasses.replace(TUNING, steps=4, dropout=0.3)
    first, again = tune(pretrained, short)[0], tune(pretrained, dataclasses.replace(short, steps_per_dispatch=3))[0]
    assert_bitwise(first.generator, again.generator)
    other = tune(pretrained, dataclasses.replace(short, seed=1))[0]
    assert not np.array_equal(first.losses, other.losses)


@pytest.mark.parametrize(
    ("name", "value"),
    [("epochs", 0), ("steps", 0), ("clips_per_batch", 3), ("dropout", 1.0), ("learning_rate", 0.0), ("batch_size", 0)],
)
def test_a_configuration_out_of_range_is_refused(name, value):
    with pytest.raises(ValueError, match=f"TuningConfig.{name} must"):
        dataclasses.replace(TUNING, **{name: value})
