"""Trains by several processes of two host devices each; `test_hosts.py` starts them.

Arguments: the coordinator, the number of this process, the number of all. Prints one line of JSON: what each training
gave in this process, by name.
"""

from __future__ import annotations

import json
import os
import sys
from typing import Any

os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=2"

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.training import hosts
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.order import order_of
from pfnn_jax.training.sharding import data_mesh, describe_devices, process_share
from tests.training.on_devices import BATCH, FILM, FULL, spread_training, training
from tests.training.toy import body_rows, toy_rows

STREAMED = PretrainConfig(**{**vars(FULL), "device_bytes": 0})


def main(coordinator: str, process_id: int, processes: int) -> None:
    hosts.initialise(coordinator, process_id, processes)
    rows = toy_rows()
    found = {
        "devices": describe_devices(BATCH),
        "broadcast": hosts.broadcast(np.float32(process_id + 1)).item(),
        "differing settings": refused(process_id),
        "rows read": process_share(order_of(rows, BATCH, 0).draw(0, 2), mesh()).rows.tolist(),
        "full": spread_training(STREAMED, rows, None),
        "film": training(FILM, body_rows(), None),
    }
    sys.stdout.write(json.dumps(found) + "\n")
    sys.stdout.flush()
    hosts.wait_for_all("end")


def mesh() -> Any:
    return data_mesh(BATCH)


def refused(process_id: int) -> str | None:
    """Returns what is said of a setting in which the processes differ; process 0 is right."""
    try:
        hosts.check_same("settings", process_id)
    except InputError as error:
        return str(error)
    return None


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
