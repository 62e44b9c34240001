"""Calibrations of styles: they come with the package, are kept privately, and serve only what they were found for."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest

from pfnn_jax.control import kept_calibration
from pfnn_jax.control.controller import Controller, make_controller
from pfnn_jax.control.kept_calibration import SHIPPED, calibrate, style_digests
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.run import load_run
from pfnn_jax.workflows.base import BASE_NETWORK
from pfnn_jax.workflows.learn import default_config

SAME_WALK = 0.02
"""Metres, metres per second and unit vectors: the walks of two compilers drift apart by millimetres in 3.5 seconds."""

STYLE = "neutral"


@pytest.fixture(scope="module")
def controller() -> Controller:
    return make_controller(load_run(BASE_NETWORK))


@pytest.fixture
def private(monkeypatch, tmp_path):
    """A folder in which calibrations are kept, and a package that holds none."""
    monkeypatch.setattr(kept_calibration, "folder_in_use", lambda: tmp_path)
    monkeypatch.setattr(kept_calibration, "_shipped", dict)
    return tmp_path


def test_the_package_holds_the_calibration_of_every_style_of_the_base_network(controller, monkeypatch):
    monkeypatch.setattr(kept_calibration, "calibrate", None)  # nothing may walk
    found = kept_calibration.kept_calibration(controller.setup, controller.params, range(len(controller.styles)))
    assert np.isfinite(found.speeds).all() and (found.gains > 0).all()
    for leaf in jax.tree.leaves(found):
        assert len(leaf) == len(controller.styles) and np.isfinite(leaf).all()


def test_what_the_package_holds_is_what_walks_show_now(controller):
    """If this fails, the controller walks differently: run `ship_calibrations` of `experiments/base_network.py`."""
    rows = [controller.styles.index(STYLE)]
    shipped = kept_calibration.kept_calibration(controller.setup, controller.params, rows)
    fresh = calibrate(controller.setup, controller.params, rows)
    assert jax.tree.structure(shipped) == jax.tree.structure(fresh)
    np.testing.assert_allclose(shipped.gains, fresh.gains, rtol=1e-6)
    for name in ("rotations", "height", "hips", "feet"):
        np.testing.assert_allclose(getattr(shipped.stances, name), getattr(fresh.stances, name), atol=SAME_WALK)


def test_a_calibration_is_kept_and_found_again(controller, private, monkeypatch):
    walked = []

    def one(setup, params, rows):
        walked.append(list(rows))
        return kept_calibration.Calibration(*known(controller, rows))

    monkeypatch.setattr(kept_calibration, "calibrate", one)
    first = kept_calibration.kept_calibration(controller.setup, controller.params, [0, 1])
    again = kept_calibration.kept_calibration(controller.setup, controller.params, [1, 0, 2])
    assert walked == [[0, 1], [2]]
    for kept, leaf in zip(jax.tree.leaves(again), jax.tree.leaves(first), strict=True):
        np.testing.assert_array_equal(kept[:2], np.asarray(leaf, np.float32)[::-1])
    for file in private.iterdir():
        file.write_bytes(file.read_bytes()[:100])
    kept_calibration.kept_calibration(controller.setup, controller.params, [0])
    assert walked[-1] == [0], "a damaged file is ignored"


def test_what_another_version_has_found_is_not_used(controller, private, monkeypatch):
    digest = style_digests(controller.setup, controller.params, [0])[0]
    found = kept_calibration.Calibration(*known(controller, [0]))
    kept_calibration._keep(digest, jax.tree.map(lambda leaf: leaf[0], found))
    assert kept_calibration._kept(digest) is not None
    monkeypatch.setattr(kept_calibration, "_source_digest", lambda: "another version")
    assert kept_calibration._kept(digest) is None


def test_a_digest_names_all_that_a_calibration_follows_from(controller):
    setup, params = controller.setup, controller.params

    def digest(setup=setup, **changed):
        return style_digests(setup, replace(params, **changed), [0])[0]

    same = digest()
    assert digest() == same and style_digests(setup, params, [1])[0] != same
    others = jax.tree.map(lambda leaf: np.concatenate([np.asarray(leaf)[:1], 2 * np.asarray(leaf)[1:]]), params.bank)
    assert digest(bank=others, speed_gains=2 * params.speed_gains) == same, "another style matters"
    assert digest(replace(setup, loop=replace(setup.loop, command_gain=0.123))) != same
    assert digest(bank=jax.tree.map(lambda leaf: 2 * leaf, params.bank)) != same
    assert digest(speeds=1.1 * params.speeds) != same
    network = jax.tree.map(lambda leaf: leaf + 1e-3, params.predictor.network)
    assert digest(predictor=replace(params.predictor, network=network)) != same


def test_nothing_is_kept_unless_the_process_keeps_compiled_code(controller):
    digest = style_digests(controller.setup, controller.params, [0])[0]
    assert kept_calibration._file(digest) is None and SHIPPED.is_file()


def known(controller: Controller, rows):
    """Returns the shipped speeds, gains, stances and waiting frames of styles."""
    params, chosen = controller.params, np.asarray(rows)
    arrays = (params.speeds, params.speed_gains, params.stances, params.waiting)
    return [jax.tree.map(lambda leaf: np.asarray(leaf)[chosen], array) for array in arrays]


def test_spare_rows_and_room_for_another_kind_of_style_change_no_digest(controller):
    run = load_run(BASE_NETWORK)
    few_shot = default_config(run)
    later = AdapterConfig(few_shot.method, few_shot.rank)
    padded = make_controller(run, capacity=24, later=later)
    assert padded.capacity > controller.capacity
    assert jax.tree.structure(padded.params.bank) != jax.tree.structure(controller.params.bank)
    rows = range(len(controller.styles))
    expected = style_digests(controller.setup, controller.params, rows)
    assert style_digests(padded.setup, padded.params, rows) == expected
    assert len(set(expected)) == len(rows)
