"""Training on several devices is training on one, up to the order of sums."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from pfnn_jax.training.sharding import data_mesh, describe_devices, num_devices
from tests.raising import assert_refused

ROOT = Path(__file__).resolve().parents[2]
DEVICES = 8
SUMS = 1e-6  # relative, of losses: a few ulp, because devices are summed in another order
PARAMETERS = 1e-5  # of numbers near one: Adam divides by the size of gradients, and rounding decides where that is tiny
OVERHEAD = 1.6  # flops of a device over its share: Adam and the penalty are computed on every device


@pytest.fixture(scope="module")
def found() -> dict:
    """What `on_devices.py` prints with eight host devices."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={DEVICES}"
    program = [sys.executable, "-m", "tests.training.on_devices"]
    environment = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(program, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def assert_same(first: dict, second: dict) -> None:
    np.testing.assert_allclose(first["losses"], second["losses"], rtol=SUMS)
    np.testing.assert_allclose(first["state"], second["state"], atol=PARAMETERS)


@pytest.mark.parametrize(
    ("several", "single"),
    [("all", "one"), ("film on all", "film on one"), ("tuned on all", "tuned on one"), ("full spread", "full on one")],
)
def test_several_devices_train_as_one(found, several, single):
    assert_same(found[several], found[single])


def test_a_device_holds_its_share_of_a_large_bank_and_of_its_moments(found):
    spread = found["full spread"]
    assert spread["large arrays"] == 3  # the weights of the styles, and two moments of each
    assert spread["shares"] == [1 / DEVICES] * 3


def test_by_default_all_devices_are_used(found):
    assert found["devices"] == DEVICES
    assert found["default"] == found["all"]


def test_rows_read_batch_by_batch_are_split_likewise(found):
    assert found["streamed"] == found["all"]


def test_a_training_continues_on_another_number_of_devices(found):
    resumed, whole = found["resumed"], found["all"]
    assert_same(resumed, {"losses": whole["losses"][1:], "state": whole["state"]})


def test_a_single_device_that_is_chosen_trains(found):
    assert found["chosen devices"] == [1]
    assert_same(found["chosen"], found["one"])


def test_every_device_computes_its_share(found):
    flops = found["flops"]
    assert flops["1"] / 2 <= flops["2"] < flops["1"] / 2 * OVERHEAD
    assert flops["8"] < flops["2"]


def test_random_numbers_do_not_depend_on_devices():
    assert jax.config.jax_threefry_partitionable  # pyright: ignore[reportAttributeAccessIssue]


def test_the_number_of_devices_divides_the_batch():
    assert [num_devices(32, count) for count in range(1, 9)] == [1, 2, 2, 4, 4, 4, 4, 8]
    assert num_devices(7, 4) == 1


@pytest.mark.parametrize(
    ("available", "said"),
    [
        (1, None),
        (4, "training on 4 devices"),
        (6, "training on 4 of 6 devices: their number must divide batch_size 32"),
        (3, "training on 2 of 3 devices: their number must divide batch_size 32"),
    ],
)
def test_the_devices_of_a_training_are_named(monkeypatch, available, said):
    monkeypatch.setattr(jax, "device_count", lambda: available)
    assert describe_devices(32) == said


def test_one_device_needs_no_mesh():
    assert data_mesh(3, jax.devices()[:1]) is None


def test_processes_have_equally_many_devices():
    assert [num_devices(32, count, 2) for count in (2, 4, 6, 8)] == [2, 4, 4, 8]
    assert num_devices(30, 8, 2) == 6
    assert_refused(lambda: num_devices(32, 6, 3), place="batch_size", value=32)


def test_devices_that_do_not_divide_the_batch_are_refused():
    for count in (0, 2):
        with pytest.raises(ValueError, match=f"must be a multiple of the {count} devices, got 3"):
            data_mesh(3, jax.devices()[:1] * count)
