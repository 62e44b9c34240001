"""`show` returns players that work in a notebook, independent of it and of each other."""

from __future__ import annotations

import html
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.motion.clip import MotionClip, cut, resample
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.viewer.player import player
from pfnn_jax.viewer.player.notebook import show
from tests.raising import assert_refused
from tests.viewer.pages import captions, check_page, make_annotated, payload

CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium")
browser = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
TIMEOUT_MS = 60_000  # milliseconds, for a browser that draws in software on a loaded machine
STRONGEST = """canvas => {  // colour of a scene: 0 for greys and nothing, 255 for a pure one
    const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
    let most = 0;
    for (let i = 0; i < data.length; i += 4) {
        const [r, g, b, alpha] = data.slice(i, i + 4);
        most = Math.max(most, (Math.max(r, g, b) - Math.min(r, g, b)) * alpha / 255);
    }
    return most;
}"""


def walk(style: str = "zombie", frames: int = 180) -> MotionClip:
    return synthesise(style, np.full(frames, 0.4), np.full(frames, 0.8))[0]


def test_a_player_is_a_sandboxed_iframe_that_holds_its_page():
    shown = show(walk(), walk("neutral", 90))
    text = shown._repr_html_()
    check_page(text)  # one element, nothing loaded
    frame = re.fullmatch(r'<iframe srcdoc="([^"]*)" sandbox="allow-scripts" .*></iframe>', text, re.DOTALL)
    assert frame is not None and html.unescape(frame[1]) == shown.html
    assert captions(shown.html) == ["zombie walk", "neutral walk"]
    assert repr(shown) == "Shown(zombie walk, neutral walk; 3.0 s)"


def test_given_phases_and_contacts_replace_those_found():
    clip = walk()
    given = np.full(clip.num_frames, 1.25)
    shown = show(
        clip, clip, names=["a", "b"], phase=[None, given], contacts=[np.zeros((clip.num_frames, 2), bool), None]
    )
    first, second = payload(shown.html)["clips"]
    assert captions(shown.html) == ["a", "b"]
    assert first["contacts"] == [[], []] and second["contacts"][0]
    assert set(second["phases"][0]["angle"]) == {1.25} and len(set(first["phases"][0]["angle"])) > 9


def test_a_given_phase_removes_the_note():
    clip = cut(walk(), 0, 12)  # too short for steps
    assert "no steps: no phase" in show(clip).html
    assert "no steps: no phase" not in show(clip, phase=[np.zeros(12)]).html


def test_mismatched_arguments_are_refused():
    with pytest.raises(ValueError, match="at least one clip"):
        show()
    with pytest.raises(ValueError, match="1 clips and 2 entries of phase"):
        show(walk(), phase=[None, None])
    with pytest.raises(ValueError, match="has 3 frames, its clip 180"):
        show(walk(), contacts=[np.zeros((3, 4), bool)])


def test_clips_too_long_for_a_page_are_refused_when_it_is_made(monkeypatch):
    monkeypatch.setattr(player, "MOST", 1000)
    shown = show(walk())
    for make in (lambda: shown.html, shown._repr_html_):
        assert_refused(make, place="player")


def test_more_rows_make_a_player_higher():
    one, many = show(walk()), show(*[walk(frames=30)] * 5)
    assert 400 < one.height < 600 < many.height


@browser
@pytest.mark.browser
def test_players_in_one_page_are_independent_and_their_clips_in_step(tmp_path: Path):
    """In a real browser, offline: as in a saved notebook or its HTML export."""
    from playwright.sync_api import sync_playwright

    names = ["a caption of two lines, which would take its scene's height " * 2, "short"]
    shows = show(walk(), resample(walk("neutral", 120), 25.0), names=names), show(walk("old", 240))
    page_file = tmp_path / "notebook.html"
    page_file.write_text(f"<body>{''.join(shown._repr_html_() for shown in shows)}</body>", encoding="utf-8")
    with sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        context = chromium.new_context(viewport={"width": 640, "height": 1100}, offline=True)
        page = context.new_page()
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(page_file.as_uri())
        frames = [frame for frame in page.frames if frame != page.main_frame]
        assert len(frames) == 2
        for frame in frames:
            frame.wait_for_function(
                "!document.querySelector('output').textContent.startsWith('0.0')", timeout=TIMEOUT_MS
            )
        first, second = frames
        assert first.locator("canvas.scene").count() == 2 and second.locator("canvas.scene").count() == 1
        first.locator("button.play").click()  # pauses the first alone
        assert first.locator("button.play").inner_text() == "Play"
        assert second.locator("button.play").inner_text() == "Pause"
        second.locator("button.play").click()  # drawing in software takes the time of the rest of the test
        strip = first.locator("canvas.strip").first
        box = strip.bounding_box()
        assert box is not None
        strip.click(position={"x": 62 + (box["width"] - 62) / 2, "y": 10})
        assert first.locator("output").inner_text() == "1.48 / 2.97 s"
        for key, stands in (("ArrowRight", "1.50"), ("ArrowRight", "1.53"), ("ArrowLeft", "1.50")):
            page.keyboard.press(key)
            assert first.locator("output").inner_text() == f"{stands} / 2.97 s"
        seen = {}
        for moment in (1.97, 1.99):  # less and more than half a frame behind the last of the shorter clip
            go = "(s, t) => { s.value = t / 2.967 * 1000; s.dispatchEvent(new Event('input')) }"
            first.locator("input").evaluate(go, moment)
            seen[moment] = [first.locator("canvas.scene").nth(i).evaluate(STRONGEST) for i in (0, 1)]
        (longer, shorter), (still_longer, over) = seen.values()
        assert min(longer, shorter, still_longer) > 130 > 100 > over  # a clip that has ended turns pale
        drawn = "c => c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some(v => v > 0)"
        for frame in frames:
            assert all(frame.locator("canvas").nth(i).evaluate(drawn) for i in range(frame.locator("canvas").count()))
        scenes = [first.locator("canvas.scene").nth(i).bounding_box() for i in (0, 1)]
        assert scenes[0] and scenes[1] and scenes[0]["height"] == scenes[1]["height"] > 200  # bodies can be compared
        page.set_viewport_size({"width": 420, "height": 1300})
        first.wait_for_function("innerWidth < 420")
        buttons = [first.locator(f"button.{name}").bounding_box() for name in ("play", "reset")]
        assert buttons[0] and buttons[1] and buttons[0]["y"] == buttons[1]["y"]  # in one line, even in a narrow page
        assert errors == []
        chromium.close()


def test_local_phases_are_shown_as_four_lines():
    annotated = make_annotated()
    vectors = np.tile([0.3, 0.4], (annotated.clip.num_frames, 4, 1))
    lines = payload(show(annotated.clip, phase=[vectors]).html)["clips"][0]["phases"]
    assert [line["name"] for line in lines] == ["left hand", "right hand", "left toe", "right toe"]
