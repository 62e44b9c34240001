"""Laws of lookup tables: an entry equals the network at its phase, for every kind of layer and style."""

import math
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.inference.lookup import evaluate_lookup, make_lookup, table_phase
from pfnn_jax.inference.modes import LookupMode
from pfnn_jax.inference.predictor import Predictor, evaluate
from pfnn_jax.interop.export.bins import network_at
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.layers import style_kinds
from pfnn_jax.models.layers.cp import CPLayer
from pfnn_jax.models.network import init_network, num_parameters
from pfnn_jax.models.spline import catmull_rom_basis
from pfnn_jax.models.style import StyleSum, init_style

FLOAT32 = 2e-5  # a few ulp over sums of some tens of terms, blended before or after the product
INPUTS, OUTPUTS, HIDDEN = 10, 7, 12
STEP = 2 * math.pi / 50
exact = jax.jit(evaluate)
STYLES = [None, *style_kinds()]
SUM = "cp, cp_output and bias"


@cache
def make_predictor(kind, rank=None):
    rng = np.random.default_rng(5)
    sizes = NetworkConfig(INPUTS, OUTPUTS, HIDDEN, rank=rank)
    network = init_network(sizes, key=jax.random.key(5))
    adapter = None if kind is None else make_style(kind, sizes)
    filled = [
        jax.tree.map(
            lambda a: jnp.asarray(a + 0.3 * rng.normal(size=a.shape), jnp.float32), jax.tree.map(np.array, tree)
        )
        for tree in (network, adapter)
    ]  # biases must not vanish
    statistics = [jnp.asarray(rng.uniform(0.5, 1.5, n), jnp.float32) for n in (INPUTS, INPUTS, OUTPUTS, OUTPUTS)]
    return Predictor(*filled, *statistics)


@cache
def lookup_of(kind, rank=None, mode: LookupMode = "nearest50"):
    return make_lookup(make_predictor(kind, rank), mode=mode)


def normal(*shape):
    return jnp.asarray(np.random.default_rng(7).normal(size=shape), jnp.float32)


def make_style(kind, sizes):
    if kind == SUM:
        return StyleSum(tuple(make_style(part, sizes) for part in ("cp", "cp_output", "bias")))
    return init_style(AdapterConfig(kind, 3), sizes, key=jax.random.key(6))


@pytest.mark.parametrize(("kind", "rank"), [*((kind, None) for kind in (*STYLES, SUM)), (None, 5), ("full", 5)])
def test_entry_equals_network_at_its_phase(kind, rank):
    predictor, lookup, x = make_predictor(kind, rank), lookup_of(kind, rank), normal(INPUTS)
    for index in (0, 13, 49):
        phase = jnp.float32(index * STEP)
        expected = exact(predictor, x, phase)
        np.testing.assert_allclose(evaluate_lookup(lookup, x, index * STEP + 0.01), expected, atol=FLOAT32)


@pytest.mark.parametrize("kind", [kind for kind in (*STYLES, SUM) if kind != "film"])
def test_entry_equals_the_exported_tables(kind):
    predictor = make_predictor(kind)
    entry, c = lookup_of(kind).slices[13], np.asarray(catmull_rom_basis(jnp.float32(13 * STEP)))
    terms = {} if entry.style is None else entry.style.affine_terms(jnp.ones(1))
    exported = network_at(predictor.network, predictor.style, c.astype(np.float64))
    for index, (layer, (weights, biases)) in enumerate(zip(entry.network.layers, exported, strict=True)):
        found, offset = (np.asarray(part) for part in layer.affine(jnp.ones(1)))
        more, shift = terms.get(index, (jnp.zeros(()), jnp.zeros(())))
        np.testing.assert_allclose(found + np.asarray(more), weights, atol=FLOAT32)
        np.testing.assert_allclose(offset + np.asarray(shift), biases, atol=FLOAT32)


@pytest.mark.parametrize(
    ("mode", "turns", "index"),
    [
        ("nearest50", 0.49, 0), ("nearest50", 0.51, 1), ("nearest50", 49.6, 0), ("nearest50", -0.6, 49),
        ("constant50", 0.99, 0), ("constant50", 1.01, 1), ("constant50", 49.9, 49), ("constant50", 50.1, 0),
    ],
)  # fmt: skip
def test_entry_of_a_phase(mode, turns, index):
    predictor = make_predictor(None)
    x = jnp.ones(INPUTS)
    served = evaluate_lookup(lookup_of(None, mode=mode), x, turns * STEP)
    np.testing.assert_allclose(served, exact(predictor, x, jnp.float32(index * STEP)), atol=FLOAT32)
    np.testing.assert_allclose(table_phase(jnp.float32(turns * STEP), mode), index * STEP, atol=FLOAT32)


@pytest.mark.parametrize(("kind", "mode"), [(None, "nearest50"), ("cp", "constant50"), ("diagonal", "nearest50")])
def test_traced_batched_and_on_the_host_agree(kind, mode):
    lookup, x = lookup_of(kind, mode=mode), normal(6, INPUTS)
    phase = jnp.array([0.03, 1.0, 2.5, 3.9, 5.1, 6.25])
    singles = np.stack([evaluate_lookup(lookup, *row) for row in zip(np.asarray(x), np.asarray(phase), strict=True)])
    batch = jax.jit(jax.vmap(evaluate_lookup, (None, 0, 0)))(lookup, x, phase)
    scanned = jax.lax.scan(lambda _, row: (0, evaluate_lookup(lookup, *row)), 0, (x, phase))[1]
    compiled = jax.jit(evaluate_lookup)(lookup, x[1], phase[1])
    np.testing.assert_allclose(batch, singles, atol=FLOAT32)
    np.testing.assert_allclose(scanned, singles, atol=FLOAT32)
    np.testing.assert_allclose(compiled, singles[1], atol=FLOAT32)


def test_finer_tables_approach_the_spline():
    predictor, x = make_predictor("cp"), normal(INPUTS)
    truth = exact(predictor, x, jnp.float32(2.02))
    errors = [
        float(jnp.abs(evaluate_lookup(make_lookup(predictor, num_slices=n), x, 2.02) - truth).max()) for n in (4, 200)
    ]
    assert errors[1] < 0.1 * errors[0]


def test_affine_adapters_are_added_into_the_table():
    plain = num_parameters(lookup_of(None).slices[0])
    assert all(num_parameters(lookup_of(kind).slices[0]) == plain for kind in ("full", "diagonal", "bias", "dense"))
    assert num_parameters(lookup_of("cp").slices[0]) == plain + 3 * (2 * HIDDEN + 1) + HIDDEN


def test_entries_share_the_factors_of_cp_layers():
    first, second = lookup_of("cp", 5).slices[:2]
    for one, two in zip((first.style, *first.network.layers), (second.style, *second.network.layers), strict=True):
        assert isinstance(one, CPLayer) and isinstance(two, CPLayer)
        assert one.a is two.a and one.b is two.b


def test_bad_modes_and_sizes_are_refused():
    with pytest.raises(ValueError, match="`mode`"):
        make_lookup(make_predictor(None), mode="linear")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="`num_slices`"):
        make_lookup(make_predictor(None), num_slices=0)
