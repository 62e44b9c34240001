"""Mixtures of a run's styles: every way of evaluating a mixture gives the same outputs."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.inference.lookup import evaluate_lookup, make_lookup
from pfnn_jax.inference.mixture import in_parts, load_bank, load_choice, stack_styles
from pfnn_jax.inference.predictor import evaluate, make_predictor
from pfnn_jax.inference.rows import RowStyles, predict_rows
from pfnn_jax.inference.style_choice import parse_style
from pfnn_jax.models.config import AdapterConfig, AdapterKind, NetworkConfig
from pfnn_jax.models.layers import style_kinds
from pfnn_jax.models.network import Network, forward, init_network
from pfnn_jax.models.style import Style, init_style
from pfnn_jax.motion.features.layout import mason2018
from pfnn_jax.motion.features.normaliser import Normaliser, Statistics
from pfnn_jax.motion.skeleton import Skeleton, skeleton_to_json
from pfnn_jax.run import Run, create_run, load_run, load_style, save_shared, save_style
from pfnn_jax.run_config import RunConfig
from tests.raising import assert_refused

FLOAT32 = 2e-5  # a few ulp over sums of some tens of terms, in another order
LAYOUT = mason2018(2)
STYLES = ("angry", "old", "proud")
CHOICE = {"angry": 0.5, "proud": 0.7, "old": -0.2}
WEIGHTS = jnp.asarray([0.5, -0.2, 0.7])  # in the order of STYLES


NETWORK = NetworkConfig(LAYOUT.input_size, LAYOUT.output_size, hidden=8)


def random_style(kind: AdapterKind, seed: int) -> Style:
    leaves, tree = jax.tree.flatten(init_style(AdapterConfig(kind, rank=2), NETWORK, key=jax.random.key(1)))
    rng = np.random.default_rng(seed)
    return jax.tree.unflatten(tree, [rng.normal(size=leaf.shape).astype(np.float32) for leaf in leaves])


def make_run(path, kind: AdapterKind) -> Run:
    network, form = NETWORK, AdapterConfig(kind, rank=2)
    skeleton = Skeleton(("A", "B"), np.array([-1, 0]), np.zeros((2, 3)), (), np.arange(2))
    config = RunConfig(network, form, LAYOUT.name, 2, STYLES, skeleton_to_json(skeleton))
    sizes = LAYOUT.input_size, LAYOUT.output_size
    create_run(path, config, Normaliser(*(Statistics(np.zeros(n, np.float32), np.ones(n, np.float32)) for n in sizes)))
    save_shared(path, init_network(network, key=jax.random.key(0)))
    for index, style in enumerate(STYLES):
        save_style(path, style, random_style(kind, 10 + index), {})
    return load_run(path)


@pytest.mark.parametrize("kind", style_kinds())
def test_mixture_is_the_same_in_controllers_rows_and_tables(tmp_path, kind: AdapterKind):
    run = make_run(tmp_path / kind, kind)
    generator = np.random.default_rng(0)
    x, phase = generator.normal(size=(3, LAYOUT.input_size)).astype(np.float32), np.array([0.2, 2.0, 5.1], np.float32)
    bank = jax.tree.map(jnp.asarray, load_bank(run, STYLES))
    dynamic = replace(make_predictor(run), style=bank.mix_dynamic(WEIGHTS))
    with jax.default_matmul_precision("highest"):
        expected = np.asarray(jax.jit(jax.vmap(evaluate, (None, 0, 0)))(dynamic, jnp.asarray(x), jnp.asarray(phase)))
    scale = np.abs(expected).max()
    np.testing.assert_allclose(predict_rows(run, x, phase, CHOICE), expected, atol=FLOAT32 * scale)
    each = RowStyles(np.tile(np.arange(3), (3, 1)), np.tile(np.asarray(WEIGHTS), (3, 1)))
    np.testing.assert_allclose(predict_rows(run, x, phase, each), expected, atol=FLOAT32 * scale)
    table = make_lookup(make_predictor(run, CHOICE))
    at = 2 * np.pi * 10 / 50
    found, wanted = evaluate_lookup(table, x[0], at), jax.jit(evaluate)(dynamic, jnp.asarray(x[0]), jnp.asarray(at))
    np.testing.assert_allclose(found, wanted, atol=FLOAT32 * scale)


def test_a_mixture_at_a_vertex_is_that_style(tmp_path):
    run = make_run(tmp_path / "run", "cp")
    one, mixed = load_choice(run, "old"), load_choice(run, {"old": 1.0})
    assert jax.tree.map(np.shape, one) == jax.tree.map(np.shape, mixed)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(mixed), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-7)


def output(network: Network, style: Style | None) -> np.ndarray:
    x, c = jnp.linspace(-1.0, 1.0, LAYOUT.input_size), jnp.asarray([0.1, -0.2, 0.5, 0.6])
    with jax.default_matmul_precision("highest"):
        return np.asarray(jax.jit(forward)(network, style, c, x))


@pytest.mark.parametrize("kind", ["cp_output", "one_hot", "full"])
def test_styles_of_several_kinds_in_one_bank_are_each_itself(tmp_path, kind: AdapterKind):
    run = make_run(tmp_path / "run", "cp")
    save_style(run.path, "reaching", random_style(kind, 20), {})
    names = ("reaching", *STYLES)
    bank = jax.tree.map(jnp.asarray, load_bank(run, names))
    for index, name in enumerate(names):
        wanted = output(run.shared, load_style(run, name))
        for mixture in (
            bank.mix(jnp.eye(4)[index]),
            bank.mix_dynamic(jnp.eye(4)[index]),
            load_choice(run, {name: 1.0}),
        ):
            np.testing.assert_allclose(output(run.shared, mixture), wanted, atol=FLOAT32 * np.abs(wanted).max())


def test_mixtures_of_several_kinds_are_the_same_in_tables_and_both_forms(tmp_path):
    run = make_run(tmp_path / "run", "cp")
    save_style(run.path, "reaching", random_style("cp_output", 20), {})
    bank = jax.tree.map(jnp.asarray, load_bank(run, ("reaching", "old")))
    weights, x, at = jnp.asarray([0.4, 0.6]), jnp.linspace(-1.0, 1.0, LAYOUT.input_size), 2 * np.pi * 10 / 50
    with jax.default_matmul_precision("highest"):
        wanted = evaluate(replace(make_predictor(run), style=bank.mix_dynamic(weights)), x, jnp.asarray(at))
        table = make_lookup(make_predictor(run, {"reaching": 0.4, "old": 0.6}))
        np.testing.assert_allclose(evaluate_lookup(table, x, at), wanted, atol=FLOAT32 * np.abs(wanted).max())


def test_a_bank_has_room_for_kinds_that_come_later(tmp_path):
    run = make_run(tmp_path / "run", "cp")
    later = random_style("cp_output", 20)
    bank = stack_styles({"old": load_style(run, "old")}, "run", also=(later,))
    rows = jax.tree.map(lambda leaf: leaf[0], bank)
    assert jax.tree.structure(in_parts(later, rows)) == jax.tree.structure(rows)
    wanted = output(run.shared, later)
    np.testing.assert_allclose(output(run.shared, in_parts(later, rows)), wanted, atol=FLOAT32 * np.abs(wanted).max())


def test_film_styles_and_adapters_do_not_share_a_bank():
    styles = {"old": random_style("film", 1), "proud": random_style("cp", 2)}
    assert_refused(lambda: stack_styles(styles, "run"), file="run", place="style", value="proud")


def test_style_choices_are_parsed():
    assert parse_style("angry:0.25+old:0.75", STYLES, "run") == {"angry": 0.25, "old": 0.75}
    assert parse_style("a:b", ("a:b",), "run") == "a:b"
    call = partial(parse_style, "angry:0.5+old:0.6", STYLES, "run")
    assert_refused(call, place="style weights", value="0.5 + 0.6 = 1.1")
