"""Quick compilation, and walks of all lengths by one compilation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control import compiling, generation
from pfnn_jax.control.compiling import jit_quickly
from pfnn_jax.control.controller import Controller, make_controller, step
from pfnn_jax.control.generation import BLOCK, track_paths
from pfnn_jax.control.loop.pursuit import advance_progress, make_timed_path, pursue
from pfnn_jax.motion.paths import circle, straight
from pfnn_jax.run import load_run
from pfnn_jax.workflows.base import BASE_NETWORK

ROUNDING = 2e-3
"""Metres between walks of 1.2 seconds that were compiled alone and side by side, in other orders of sums."""


@pytest.fixture(scope="module")
def controller() -> Controller:
    return make_controller(load_run(BASE_NETWORK), ["neutral", "old"])


def test_a_quickly_compiled_function_is_the_function():
    quick = jit_quickly(lambda x: 2 * x)
    assert quick(jnp.ones(())) == 2.0 and quick(3) == 6


def test_a_compiler_that_does_not_know_the_options_compiles_without_them(monkeypatch):
    monkeypatch.setattr(compiling, "QUICK", {"xla_option_that_is_none": True})
    compiling._quick_options.cache_clear()
    try:
        assert compiling._quick_options() is None
        assert jit_quickly(lambda x: 2 * x)(3) == 6
    finally:
        compiling._quick_options.cache_clear()


def test_a_quickly_compiled_function_can_be_compiled_and_mapped():
    double = jit_quickly(lambda x: 2 * x)
    assert jax.jit(lambda x: double(x) + 1)(3) == 7
    np.testing.assert_array_equal(jax.vmap(double)(np.arange(3)), [0, 2, 4])


def test_walks_of_other_lengths_and_paths_need_no_compilation(controller):
    block: Any = generation._track_block
    weights = [controller.style_weights(0)]
    first = track_paths(controller, weights, [straight(3.0)], [1.0], BLOCK)[0]
    compiled = block.compiled()._cache_size()
    again = track_paths(controller, weights, [straight(3.0)], [1.0], BLOCK + 7)[0]
    track_paths(controller, weights, [circle(1.0)], [0.8], 3)
    assert block.compiled()._cache_size() == compiled
    assert len(again.joints) == BLOCK + 7 and len(first.joints) == BLOCK
    np.testing.assert_array_equal(again.joints[:BLOCK], first.joints)


def test_blocks_are_the_whole_walk(controller, monkeypatch):
    """The frames of several blocks, side by side with another walk, are those of a loop over all frames."""
    monkeypatch.setattr(generation, "BLOCK", 24)
    unjitted: Any = vars(generation)["track_block"]
    monkeypatch.setattr(generation, "_track_block", jit_quickly(unjitted.__wrapped__, static_argnums=0))
    weights, frames = [controller.style_weights(name) for name in ("old", "neutral")], 72
    paths, speeds = [straight(3.0), circle(1.0)], [0.9, 0.8]
    side_by_side = track_paths(controller, weights, paths, speeds, frames, lanes=2)
    path, style = make_timed_path(paths[1], speeds[1]), controller.style_weights("neutral")
    state = controller.start(paths[1].points[0], paths[1].start_yaw, "neutral")

    @jax.jit
    def whole(params, state, path):
        def frame(carry, _):
            state, progress = carry
            progress = advance_progress(path, state.root, progress)
            state = step(controller.setup, params, state, pursue(path, state.motion, progress, controller.setup.loop))
            return (state, progress), state.joints

        return jax.lax.scan(frame, (state, jnp.float32(0.0)), length=frames)[1]

    expected = whole(controller.params, replace(state, style=jnp.asarray(style)), path)
    np.testing.assert_allclose(side_by_side[1].joints, expected, atol=ROUNDING)
