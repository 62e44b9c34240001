"""The page as it looks: what is visible in a window of common size, and when the program has ended."""

from __future__ import annotations

import pytest

pytest.importorskip("viser", reason="viser is not installed")

from pfnn_jax.viewer.page import widgets  # noqa: E402
from pfnn_jax.viewer.page.play import Page  # noqa: E402

# A tab can close while its picture is being sent; `play` ignores the warning, but each test has its own filters.
pytestmark = pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection:UserWarning")

COMMON = {"width": 1280, "height": 720}
REACHED = """(element) => {  // whether a click at its centre would reach it without scrolling
    const box = element.getBoundingClientRect();
    const met = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
    return met !== null && element.contains(met);
}"""
COVERED = """([over, under]) => {  // whether two elements overlap
    const [a, b] = [over, under].map((name) => document.querySelector(name).getBoundingClientRect());
    return a.width > 0 && a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
}"""
NOTICES = ".mantine-Notifications-root[data-position=top-left]"


def test_the_main_controls_are_visible_and_not_covered_by_notices(visitor, served):
    visitor.page.set_viewport_size(COMMON)
    try:
        found = {
            "stick": visitor.page.locator("[data-stick]"),
            "style": visitor.field("Style"),
            "triangle": visitor.page.locator("[data-triangle]"),
            "record": visitor.page.get_by_role("button", name="Record").first,
            "upload": visitor.page.get_by_role("button", name="Upload a clip").first,
            "sample": visitor.page.get_by_role("button", name="soldier").first,
        }
        visitor.wait(lambda: all(what.evaluate(REACHED) for what in found.values()), f"{list(found)} are visible")
        tab = next(iter(served.tabs))
        tab._client.add_notification("A notice", "of some words")
        visitor.page.get_by_text("of some words").wait_for()
        assert not visitor.page.evaluate(COVERED, [NOTICES, "[data-readout=style]"])
        assert not visitor.page.evaluate(COVERED, [NOTICES, "[data-stick]"])
    finally:
        visitor.page.set_viewport_size({"width": 760, "height": 440})


def test_a_style_chosen_while_standing_has_a_hint(visitor):
    hint = visitor.page.locator("[data-hint]")
    assert hint.count() == 0
    visitor.choose("Style", "proud")
    hint.wait_for()
    assert widgets.UNSEEN in hint.inner_text()
    visitor.walk(0.2)
    visitor.wait(lambda: hint.count() == 0, "the hint disappears once the character walks")


def test_a_page_shows_that_its_program_has_ended_and_reconnects(browser, served):
    """A browser connects before the runs are loaded, sees the program end, and reconnects to the next one."""
    words = ".pfnn-ended"
    with Page(port=0) as page:
        tab = browser.new_page()
        tab.set_default_timeout(60e3)
        tab.goto(page.url)
        tab.get_by_text("Compiling").wait_for()
        page.begin(served._library)
        tab.wait_for_selector("[data-readout=root]")
        assert tab.get_by_text("Compiling").count() == 0 and not tab.locator(words).is_visible()
        port = page.port
    tab.locator(words).wait_for()
    assert "has ended" in tab.locator(words).inner_text()
    with Page(served._library, port=port):
        tab.bring_to_front()  # viser reconnects in a visible tab only
        tab.locator(words).wait_for(state="hidden")
        tab.wait_for_selector("[data-readout=root]")
        tab.close()
