"""Every experiment runs at tiny sizes."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from experiments import few_shot_dropout, table1_adapters, table1_transfer
from pfnn_jax.benchmarks.runtime import random_predictor
from pfnn_jax.benchmarks.transfer import TransferSizes
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from tests.raising import assert_refused

ROOT = Path(__file__).resolve().parents[1]
PAPERS_DIGITS = 0.03  # the paper gives two or three digits, and rounds up once
MEGABYTE = 2**20 / 10**6  # the paper's megabytes are 2^20 bytes, but those of CP 10^6


@pytest.mark.parametrize(
    ("kind", "control_points", "slices"),
    [("full", 4.01, 50.1), ("diagonal", 0.016, 0.20), ("cp", 0.126 / MEGABYTE, 0.131 / MEGABYTE)],
)
def test_adapters_take_the_memory_of_table_1(kind, control_points, slices):
    adapter = random_predictor(NetworkConfig(234, 400), AdapterConfig(kind, 30)).style
    np.testing.assert_allclose(table1_adapters.memory(adapter), control_points, rtol=PAPERS_DIGITS)
    np.testing.assert_allclose(table1_adapters.memory(adapter, 50), slices, rtol=PAPERS_DIGITS)


@pytest.mark.slow
def test_table1_adapters(tmp_path):
    config = table1_adapters.Config(
        tmp_path, num_joints=4, hidden=8, rank=2, frames=20, epochs=1, timed_frames=2, crowd=2, slices=4, repetitions=1
    )
    result = table1_adapters.main(config)
    assert json.loads((tmp_path / "table1_adapters.json").read_text())["rows"] == result["rows"]
    assert set(result["rows"]) == {
        "full adapter",
        "diagonal adapter",
        "cp adapter",
        "network, no adapter",
        "CP network, no adapter",
    }
    assert all(row["exact, ms"] > 0 for row in result["rows"].values())
    table = (tmp_path / "table1_adapters.md").read_text().splitlines()
    assert len(table) == 2 + 5 + 3 and all(line.count("|") == 8 for line in table)


@pytest.mark.slow
def test_table1_transfer(tmp_path):
    sizes = TransferSizes((60,), filters=4, hidden=4, width=5, iterations=2, constraint_iterations=2)
    result = table1_transfer.main(table1_transfer.Config(tmp_path, sizes, repetitions=2))
    assert {"fast network", "optimisation"} < set(result["rows"])
    assert all(row["median"] > 0 for by_frames in result["rows"].values() for row in by_frames.values())
    table = (tmp_path / "table1_transfer.md").read_text().splitlines()
    assert len(table) == 2 + 5 and all(line.count("|") == 8 for line in table)


@pytest.mark.slow
def test_few_shot_dropout(tmp_path):
    config = few_shot_dropout.Config(
        tmp_path,
        adapter_dropouts=(0.1, 0.9),
        main_dropouts=(0.0, 0.3),
        seeds=1,
        hidden=8,
        steps=2,
        batch_size=16,
        epochs=1,
        seconds_per_style=5.0,
        test_seconds=2.0,
    )
    result = few_shot_dropout.main(config)
    assert {(row["main"], row["adapter"]) for row in result["rows"]} == {(0.0, 0.1), (0.0, 0.9), (0.3, 0.1), (0.3, 0.9)}
    assert all(np.isfinite([row["straight"], row["turning"]]).all() for row in result["rows"])
    assert json.loads((tmp_path / "few_shot_dropout.json").read_text())["summary"] == result["summary"]
    assert (tmp_path / "few_shot_dropout.png").stat().st_size > 1000
    assert len((tmp_path / "few_shot_dropout.md").read_text().splitlines()) == 2 + 1 + 4


def test_dataset_without_a_clip_is_refused(tmp_path):
    make = partial(few_shot_dropout.Config, tmp_path, dataset=tmp_path)
    assert_refused(make, place="dataset", value=tmp_path, rule_mentions="--clip")


def test_every_experiment_is_in_the_table_of_commands():
    table = (ROOT / "docs" / "results_appendix.md").read_text().partition("\n\nAll numbers")[0]
    files = [file for file in (ROOT / "experiments").rglob("[!_]*.py") if "common" not in file.parts]
    assert len(files) > 30
    for file in files:
        module = ".".join(file.relative_to(ROOT).with_suffix("").parts)
        assert f"python -m {module} " in table or f"`{file.stem}`" in table, f"{module} is not in the table"
        assert f"python -m {module} " in file.read_text(), f"{module} does not say how to run it"
