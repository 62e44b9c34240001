"""What a browser draws of a player: the body of the clip, where the camera sees it, without anything from outside."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip, annotate
from pfnn_jax.viewer.draw.scene import make_scene
from pfnn_jax.viewer.player.player import player_page
from tests.viewer.pages import captions

CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium")
pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")]
TIMEOUT_MS = 60_000  # milliseconds, for a browser that draws in software on a loaded machine
PIXEL = 2.0  # the outline is drawn on whole pixels, and weights and positions are rounded
SILHOUETTE = """canvas => {  // left, top, right and bottom of the opaque pixels: the body; the ground is translucent
    const { width, height } = canvas, data = canvas.getContext("2d").getImageData(0, 0, width, height).data;
    const box = [width, height, -1, -1];
    for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) {
        if (data[4 * (y * width + x) + 3] < 250) continue;
        if (x > width - 40 && y < 70 || x > width - 110 && y > height - 24) continue;  // the phase's dial, a note
        box[0] = Math.min(box[0], x); box[1] = Math.min(box[1], y);
        box[2] = Math.max(box[2], x); box[3] = Math.max(box[3], y);
    }
    return { box, width, height };
}"""
WITHOUT = """const make = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
        return /webgl/.test(kind) ? null : make.call(this, kind, ...rest);
    };"""
KEEP = """window.drawn = [];  // the contexts of WebGL that a page makes
    const make = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
        const context = make.call(this, kind, ...rest);
        if (context && kind.startsWith("webgl")) window.drawn.push(context);
        return context;
    };"""
GO = "(slider, share) => { slider.value = 1000 * share; slider.dispatchEvent(new Event('input')); }"


@dataclass
class Opened:
    """A page in a browser without a network, with what went wrong in it."""

    page: Any
    clips: list[AnnotatedClip]
    complaints: list[str]
    requests: list[str]
    path: Path

    def go(self, second: float) -> None:
        """Shows a moment."""
        longest = max((clip.clip.num_frames - 1) / clip.clip.fps for clip in self.clips)
        self.page.locator("input[type=range]").evaluate(GO, second / longest)

    def silhouette(self, number: int) -> dict:
        """Returns the `box` of a scene's body, and the scene's size."""
        return self.page.locator("canvas.scene").nth(number).evaluate(SILHOUETTE)


def outline(annotated: AnnotatedClip, second: float, width: int, height: int) -> np.ndarray:
    """Returns left, top, right and bottom of a body in the picture of the scene's own camera."""
    scene = make_scene(annotated.clip, annotated.mesh)
    positions, rotations, focus = scene.pose_at(second)
    pixels, _, _ = scene.camera(focus, width, height).project(scene.mesh.pose(positions, rotations))
    x, y = pixels[:, 0], height - pixels[:, 1]
    return np.array([x.min(), y.min(), x.max(), y.max()])


@pytest.fixture(scope="module")
def opened(tmp_path_factory) -> Iterator[Opened]:
    """A page of two clips of different rates and lengths, from the disk."""
    from playwright.sync_api import sync_playwright

    walks = [("zombie", 120, 0.8), ("neutral", 180, 1.3)]
    clips = [annotate(synthesise(s, np.full(n, 0.4), np.full(n, v))[0], s) for s, n, v in walks]
    path: Path = tmp_path_factory.mktemp("player") / "walks.html"
    path.write_text(player_page(clips, title="walks"), encoding="utf-8")
    with sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        context = chromium.new_context(viewport={"width": 760, "height": 420}, offline=True, reduced_motion="reduce")
        page, complaints, requests = context.new_page(), [], []
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda message: complaints.extend([message.text] if message.type == "error" else []))
        page.on("request", lambda request: requests.append(request.url))
        page.add_init_script(KEEP)
        page.goto(path.as_uri())
        page.wait_for_selector(".motion-player[data-started=yes]", timeout=TIMEOUT_MS)
        yield Opened(page, clips, complaints, requests, path)
        chromium.close()


@pytest.mark.parametrize("second", [0.0, 0.75, 1.9])
def test_bodies_are_drawn_where_the_camera_sees_them_in_step(opened, second):
    """Also the soles: the lower edge of the body is that of the lowest vertex, which stands on the ground."""
    opened.go(second)
    for number, annotated in enumerate(opened.clips):
        seen = opened.silhouette(number)
        expected = outline(annotated, second, seen["width"], seen["height"])
        np.testing.assert_allclose(np.array(seen["box"]) + [0, 0, 1, 1], expected, atol=PIXEL)


def test_a_clip_that_has_ended_turns_pale_while_the_longer_one_plays(opened):
    opened.go(2.5)
    ended, playing = (opened.silhouette(number)["box"] for number in (0, 1))
    assert ended[2] == -1 and playing[2] > 0  # nothing is opaque in the picture of the ended one


def test_dragging_turns_all_views_and_reset_returns(opened):
    opened.go(1.0)
    before = [opened.silhouette(number)["box"] for number in (0, 1)]
    box = opened.page.locator("canvas.scene").first.bounding_box()
    opened.page.mouse.move(box["x"] + 100, box["y"] + 100)
    opened.page.mouse.down()
    opened.page.mouse.move(box["x"] + 260, box["y"] + 110, steps=3)
    opened.page.mouse.up()
    turned = [opened.silhouette(number)["box"] for number in (0, 1)]
    opened.page.get_by_role("button", name="Reset view").click()
    assert turned[0] != before[0] and turned[1] != before[1]
    assert [opened.silhouette(number)["box"] for number in (0, 1)] == before


def test_scenes_share_one_graphics_context_and_a_lost_one_is_replaced(opened):
    """Browsers allow a page about sixteen, and take away the oldest."""
    opened.go(1.0)
    before = opened.silhouette(0)["box"]
    assert opened.page.evaluate("drawn.length") == 1
    opened.page.evaluate("drawn[0].getExtension('WEBGL_lose_context').loseContext()")
    opened.go(1.1)
    opened.go(1.0)
    assert opened.silhouette(0)["box"] == before and opened.page.evaluate("drawn.length") == 2


def test_nothing_is_loaded_and_nothing_complains(opened):
    assert [url for url in opened.requests if not url.startswith(("file:", "blob:", "data:"))] == []
    assert len(opened.requests) == 1 and opened.complaints == []


def test_a_browser_without_webgl_is_told_so(opened):
    page, complaints = opened.page.context.new_page(), []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.add_init_script(WITHOUT)
    page.goto(opened.path.as_uri())
    page.locator("p.failure").last.wait_for(timeout=TIMEOUT_MS)
    assert page.locator("p.failure").all_inner_texts() == [
        "This browser cannot draw the motion: Error creating WebGL context."
    ] * len(opened.clips)
    assert complaints == [] and captions(page.content()) == [clip.name for clip in opened.clips]
    page.close()
