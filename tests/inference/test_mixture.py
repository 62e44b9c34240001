"""Mixtures of a run's styles: every way of evaluating a mixture gives the same outputs."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.inference.lookup import evaluate_lookup, make_lookup
from pfnn_jax.inference.mixture import load_bank, load_choice
from pfnn_jax.inference.predictor import evaluate, make_predictor
from pfnn_jax.inference.rows import RowStyles, predict_rows
from pfnn_jax.inference.style_choice import parse_style
from pfnn_jax.models.config import AdapterConfig, AdapterKind, NetworkConfig
from pfnn_jax.models.layers import style_kinds
from pfnn_jax.models.network import init_network
from pfnn_jax.models.style import init_style
from pfnn_jax.motion.features.layout import mason2018
from pfnn_jax.motion.features.normaliser import Normaliser, Statistics
from pfnn_jax.motion.skeleton import Skeleton, skeleton_to_json
from pfnn_jax.run import Run, create_run, load_run, save_shared, save_style
from pfnn_jax.run_config import RunConfig
from tests.raising import assert_refused

FLOAT32 = 2e-5  # a few ulp over sums of some tens of terms, in another order
LAYOUT = mason2018(2)
STYLES = ("angry", "old", "proud")
CHOICE = {"angry": 0.5, "proud": 0.7, "old": -0.2}
WEIGHTS = jnp.asarray([0.5, -0.2, 0.7])  # in the order of STYLES


def make_run(path, kind: AdapterKind) -> Run:
    network, form = NetworkConfig(LAYOUT.input_size, LAYOUT.output_size, hidden=8), AdapterConfig(kind, rank=2)
    skeleton = Skeleton(("A", "B"), np.array([-1, 0]), np.zeros((2, 3)), (), np.arange(2))
    config = RunConfig(network, form, LAYOUT.name, 2, STYLES, skeleton_to_json(skeleton))
    sizes = LAYOUT.input_size, LAYOUT.output_size
    create_run(path, config, Normaliser(*(Statistics(np.zeros(n, np.float32), np.ones(n, np.float32)) for n in sizes)))
    save_shared(path, init_network(network, key=jax.random.key(0)))
    for index, style in enumerate(STYLES):
        leaves, tree = jax.tree.flatten(init_style(form, network, key=jax.random.key(1)))
        keys = jax.random.split(jax.random.key(10 + index), len(leaves))
        noise = [jax.random.normal(key, leaf.shape) for key, leaf in zip(keys, leaves, strict=True)]
        save_style(path, style, jax.tree.unflatten(tree, noise), {})
    return load_run(path)


@pytest.mark.parametrize("kind", style_kinds())
def test_mixture_is_the_same_in_controllers_rows_and_tables(tmp_path, kind: AdapterKind):
    run = make_run(tmp_path / kind, kind)
    generator = np.random.default_rng(0)
    x, phase = generator.normal(size=(3, LAYOUT.input_size)).astype(np.float32), np.array([0.2, 2.0, 5.1], np.float32)
    bank = jax.tree.map(jnp.asarray, load_bank(run, STYLES))
    dynamic = replace(make_predictor(run), style=bank.mix_dynamic(WEIGHTS))
    with jax.default_matmul_precision("highest"):
        expected = np.asarray(jax.vmap(evaluate, (None, 0, 0))(dynamic, jnp.asarray(x), jnp.asarray(phase)))
    scale = np.abs(expected).max()
    np.testing.assert_allclose(predict_rows(run, x, phase, CHOICE), expected, atol=FLOAT32 * scale)
    each = RowStyles(np.tile(np.arange(3), (3, 1)), np.tile(np.asarray(WEIGHTS), (3, 1)))
    np.testing.assert_allclose(predict_rows(run, x, phase, each), expected, atol=FLOAT32 * scale)
    table = make_lookup(make_predictor(run, CHOICE))
    at = 2 * np.pi * 10 / 50
    found, wanted = evaluate_lookup(table, jnp.asarray(x[0]), at), evaluate(dynamic, jnp.asarray(x[0]), jnp.asarray(at))
    np.testing.assert_allclose(found, wanted, atol=FLOAT32 * scale)


def test_a_mixture_at_a_vertex_is_that_style(tmp_path):
    run = make_run(tmp_path / "run", "cp")
    one, mixed = load_choice(run, "old"), load_choice(run, {"old": 1.0})
    assert jax.tree.map(np.shape, one) == jax.tree.map(np.shape, mixed)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(mixed), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-7)


def test_style_choices_are_parsed():
    assert parse_style("angry:0.25+old:0.75", STYLES, "run") == {"angry": 0.25, "old": 0.75}
    assert parse_style("a:b", ("a:b",), "run") == "a:b"
    call = partial(parse_style, "angry:0.5+old:0.6", STYLES, "run")
    assert_refused(call, place="style weights", value="0.5 + 0.6 = 1.1")
