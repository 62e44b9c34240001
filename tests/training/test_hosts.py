"""Two processes that train together train as one; tests/test_cli_hosts.py kills one of them."""

from __future__ import annotations

import json

import jax
import numpy as np
import pytest

from pfnn_jax.training.order import order_of
from tests.training.on_devices import BATCH, FILM, FULL, training
from tests.training.processes import free_port, outputs, start
from tests.training.test_sharding import assert_same
from tests.training.toy import body_rows, toy_rows


@pytest.fixture(scope="module")
def both() -> list[dict]:
    """What `on_hosts.py` prints in each of two processes."""
    address = f"127.0.0.1:{free_port()}"
    processes = [start("-m", "tests.training.on_hosts", address, number, 2) for number in range(2)]
    return [json.loads(output.splitlines()[-1]) for output in outputs(processes)]


def test_two_processes_train_as_one_device(both):
    """Rows that each process reads on its own and a bank that is spread over them; clips of a FiLM generator."""
    one = jax.devices()[:1]
    assert_same(both[0]["full"], training(FULL, toy_rows(), one))
    assert_same(both[0]["film"], training(FILM, body_rows(), one))


def test_all_processes_see_the_same_losses(both):
    for name in ("full", "film"):
        assert both[1][name]["losses"] == both[0][name]["losses"]


def test_each_process_reads_its_share_of_every_minibatch(both):
    shares = np.concatenate([found["rows read"] for found in both], axis=1)
    np.testing.assert_array_equal(shares, order_of(toy_rows(), BATCH, 0).draw(0, 2).rows)


def test_the_first_process_decides(both):
    assert [found["broadcast"] for found in both] == [1.0, 1.0]
    assert both[0]["differing settings"] is None
    assert both[1]["differing settings"].endswith("differ in process 1; must be the same as in process 0")


def test_the_devices_of_all_processes_are_named(both):
    assert both[0]["devices"] == "training on 4 devices of 2 processes"
    assert both[0]["full"]["shares"] == [1 / 4] * 3
