"""The times of the page are measured from the command to a walk, and from a sent clip to its style."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("viser", reason="viser is not installed")

from experiments import page_times  # noqa: E402

PREPARING = 2.0  # seconds: this test needs nothing to be prepared


@pytest.mark.slow
def test_page_times(tmp_path, monkeypatch):
    monkeypatch.setattr(page_times, "PREPARING", PREPARING)
    config = page_times.Config(tmp_path / "out", delays=(0.0,), repeats=1, browser=False)
    result = page_times.main(config)
    assert set(result["measured"]) == {
        "walks, cold",
        "walks, warm",
        "learned, sent after 0 s, cold",
        "learned, sent after 0 s, warm",
    }
    assert all(one["seconds"] > 0 and one["processor"] > 0 for found in result["measured"].values() for one in found)
    assert json.loads((config.out / "results.json").read_text())["measured"] == result["measured"]
    table = (config.out / "table.md").read_text().splitlines()
    assert len(table) == 2 + 4 and all(line.count("|") == 5 for line in table)
