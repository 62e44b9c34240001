"""Restyling a clip in a real browser, while the character goes on walking."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.transfer.config import OptimisationConfig
from pfnn_jax.viewer.page.restyle_panel import CONTENT, STYLE
from pfnn_jax.workflows import transfer as workflow
from tests.transfer_runs import make_transfer_run, make_walk
from tests.viewer.pages import captions

pytestmark = pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection:UserWarning")

RESTYLING = 240e3  # milliseconds to wait for a result on a loaded machine


@pytest.fixture
def walk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A walk to restyle, with a small run in place of the package's, and few iterations."""
    monkeypatch.setattr(workflow, "BASE_AUTOENCODER", make_transfer_run(tmp_path).path)
    quick = OptimisationConfig(iterations=3, constraint_iterations=2)
    monkeypatch.setattr(workflow, "OptimisationConfig", lambda: quick)
    return make_walk(tmp_path / "my walk.bvh")


def test_a_clip_is_restyled_shown_and_downloaded(visitor, walk, zombie_bvh, tmp_path):
    visitor.page.get_by_text("Restyle a clip", exact=True).first.click()
    visitor.upload(CONTENT, walk)
    visitor.page.locator("[data-message=plain]").filter(has_text="my walk").wait_for()
    visitor.upload(STYLE, zombie_bvh)
    visitor.page.locator("[data-message=plain]").filter(has_text="zombie walk").wait_for()
    visitor.page.get_by_role("button", name="Restyle", exact=True).click()
    player = visitor.page.locator("iframe[title=motion]")
    player.wait_for(timeout=RESTYLING)
    inside = player.content_frame
    assert inside.locator("figcaption").all_inner_texts()[2].startswith("result")
    assert inside.locator("canvas.scene").count() == 3
    inside.get_by_role("button", name=re.compile("Play|Pause")).wait_for()
    visitor.page.get_by_role("button", name="Close", exact=True).click()
    player.wait_for(state="detached")
    for label, name in (("Download the result", "bvh"), ("Download the comparison", "html")):
        with visitor.page.expect_download() as waited:
            visitor.press(label)
        assert waited.value.suggested_filename == f"my walk_zombie walk.{name}"
        waited.value.save_as(tmp_path / f"result.{name}")
    clip = read_bvh(tmp_path / "result.bvh")
    assert clip.num_frames == read_bvh(walk).num_frames and np.isfinite(clip.rotations).all()
    assert captions((tmp_path / "result.html").read_text())[:2] == ["my walk", "zombie walk"]
    visitor.page.get_by_role("button", name="Show the result", exact=True).click()
    player.wait_for()
    visitor.page.get_by_role("button", name="Close", exact=True).click()
    visitor.walk(0.3)
    assert not visitor.errors


def test_a_clip_as_its_own_style_is_refused(visitor, walk):
    visitor.upload(STYLE, walk)
    visitor.upload(CONTENT, walk)
    visitor.page.locator("[data-message=plain]").filter(has_text="choose a style").wait_for()
    visitor.page.get_by_role("button", name="Restyle", exact=True).click()
    refusal = visitor.page.locator("[data-message=bad]").filter(has_text="same motion")
    refusal.wait_for(timeout=RESTYLING)
    assert str(walk.parent) not in refusal.inner_text()
