"""What a visitor finds without looking for it: in a window of usual size, and when the program has ended."""

from __future__ import annotations

import pytest

pytest.importorskip("viser", reason="viser is not installed")

from pfnn_jax.viewer.page import widgets  # noqa: E402
from pfnn_jax.viewer.page.play import Page  # noqa: E402

# A tab may close while its picture is being sent; a served page ignores it, but each test has filters of its own.
pytestmark = pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection:UserWarning")

USUAL = {"width": 1280, "height": 720}
REACHED = """(element) => {  // whether a click in its middle would meet it, without scrolling
    const box = element.getBoundingClientRect();
    const met = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
    return met !== null && element.contains(met);
}"""
COVERED = """([over, under]) => {  // whether two elements overlap
    const [a, b] = [over, under].map((name) => document.querySelector(name).getBoundingClientRect());
    return a.width > 0 && a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
}"""
NOTICES = ".mantine-Notifications-root[data-position=top-left]"


def test_what_is_needed_first_is_in_sight_and_under_no_notice(visitor, served):
    visitor.page.set_viewport_size(USUAL)
    try:
        found = {
            "stick": visitor.page.locator("[data-stick]"),
            "style": visitor.field("Style"),
            "triangle": visitor.page.locator("[data-triangle]"),
            "record": visitor.page.get_by_role("button", name="Record").first,
            "upload": visitor.page.get_by_role("button", name="Upload a BVH file").first,
        }
        visitor.wait(lambda: all(what.evaluate(REACHED) for what in found.values()), f"all of {list(found)} in sight")
        tab = next(iter(served.tabs))
        tab._client.add_notification("A notice", "of some words")
        visitor.page.get_by_text("of some words").wait_for()
        assert not visitor.page.evaluate(COVERED, [NOTICES, "[data-readout=style]"])
        assert not visitor.page.evaluate(COVERED, [NOTICES, "[data-stick]"])
    finally:
        visitor.page.set_viewport_size({"width": 760, "height": 440})


def test_a_style_of_the_list_or_the_triangle_says_how_to_see_it(visitor):
    hint = visitor.page.locator("[data-hint]")
    assert hint.count() == 0
    visitor.choose("Style", "proud")
    hint.wait_for()
    assert widgets.UNSEEN in hint.inner_text()
    visitor.walk(0.2)
    visitor.wait(lambda: hint.count() == 0, "who has walked has seen it")


def test_a_page_says_that_its_program_has_ended_and_comes_back(browser, served):
    """A browser that comes before the runs are ready, sees the program end, and finds it again at its address."""
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
        tab.bring_to_front()  # viser connects anew where somebody looks
        tab.locator(words).wait_for(state="hidden")
        tab.wait_for_selector("[data-readout=root]")
        tab.close()
