"""A few kills at random moments; `experiments/kills.py` makes many, also of `pretrain` and `few-shot`."""

from __future__ import annotations

import os
from random import Random

import pytest

from experiments import kills

KILLS = 2
"""Of each work."""


@pytest.mark.skipif(os.name != "posix", reason="processes are forked")
@pytest.mark.parametrize("name", ["prepare", "save"])
def test_a_kill_at_a_random_moment_loses_no_save_and_changes_no_result(tmp_path, name):
    if name == "prepare":
        kills.in_child(kills.make_clips, tmp_path / "sources")
    usual, random = kills.undisturbed(name, tmp_path), Random(7)
    count = {"kills": 0, "aimed": 0, "finished": 0, "faults": 0}
    for _ in range(20):  # a work may end before it is killed
        if count["kills"] >= KILLS:
            break
        kills.disturbed(name, tmp_path, usual, count, random)
    assert count["kills"] >= KILLS and count["finished"] > 0 and not count["faults"]
