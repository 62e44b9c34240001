"""The page as it looks: what is visible in a window of common size, and when the program has ended."""

from __future__ import annotations

import pytest

pytest.importorskip("viser", reason="viser is not installed")

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


PHONE, SIDEWAYS = {"width": 390, "height": 844}, {"width": 844, "height": 390}
SMALL = {"width": 760, "height": 440}
LEAST_FREE = 0.6  # share of a phone's height above the collapsed sheet
HIDE = """(hidden) => {  // what a browser does when another tab is chosen
    Object.defineProperty(document, "hidden", { value: hidden, configurable: true });
    document.dispatchEvent(new Event("visibilitychange"));
}"""


def test_on_a_phone_the_controls_are_a_sheet_of_stick_and_style(visitor):
    page, record = visitor.page, visitor.page.get_by_role("button", name="Record").first
    try:
        page.set_viewport_size(PHONE)
        visitor.wait(lambda: page.locator(".pfnn-sheet").count() == 1, "the controls become a sheet")
        visitor.wait(lambda: not record.is_visible(), "it shows neither recording")
        box = page.locator(".pfnn-sheet").bounding_box()
        assert (box["x"], box["width"]) == (0, PHONE["width"]) and box["y"] > LEAST_FREE * PHONE["height"]
        assert page.locator("[data-stick]").evaluate(REACHED) and visitor.field("Style").evaluate(REACHED)
        page.locator("[data-sheet]").click()
        visitor.wait(record.is_visible, "its grip opens the rest")
        page.locator("[data-sheet]").click()
        visitor.wait(lambda: not record.is_visible(), "and closes it again")
        page.set_viewport_size(SIDEWAYS)
        visitor.wait(lambda: page.locator(".pfnn-compact:not(.pfnn-sheet)").count() == 1, "sideways, a small panel")
        assert not page.locator("[data-readout=style]").first.is_visible()
        assert page.locator("[data-stick]").evaluate(REACHED) and visitor.field("Style").evaluate(REACHED)
    finally:
        page.set_viewport_size(SMALL)
    visitor.wait(record.is_visible, "a wide window has everything again")


def test_the_page_has_its_own_name_and_none_of_the_tools_of_viser(visitor, served):
    assert visitor.page.title() == f"pfnn_jax \u2014 {', '.join(served._library.runs)}"
    for text in ("Dev Settings", "Scene tree", "Orbit Origin Tool"):
        assert not any(found.is_visible() for found in visitor.page.get_by_text(text).all()), text
    for icon in ("adjustments", "list-search", "cloud-check"):
        assert not any(found.is_visible() for found in visitor.page.locator(f".tabler-icon-{icon}").all()), icon


def test_a_hidden_tab_takes_no_steps(visitor, served):
    tab = next(iter(served.tabs))
    drawn = tab._drawn
    try:
        visitor.page.evaluate(HIDE, True)
        visitor.page.wait_for_timeout(1500)
        before = list(drawn)
        visitor.page.wait_for_timeout(1500)
        assert list(drawn) == before
    finally:
        visitor.page.evaluate(HIDE, False)
    visitor.wait(lambda: list(drawn) != before, "it goes on when it is seen again")
    visitor.walk(0.2)


def test_a_page_shows_that_its_program_has_ended_and_reconnects(browser, served):
    """A browser connects before the runs are loaded, sees the program end, and reconnects to the next one."""
    words = ".pfnn-ended"
    with Page(port=0) as page:
        tab = browser.new_page()
        tab.set_default_timeout(60e3)
        tab.goto(page.url)
        tab.locator("[data-start]").wait_for()
        page.begin(served._library)
        tab.wait_for_selector("[data-readout=style]")
        assert tab.locator("[data-start]").count() == 0 and not tab.locator(words).is_visible()
        port = page.port
    tab.locator(words).wait_for()
    assert "has ended" in tab.locator(words).inner_text()
    with Page(served._library, port=port):
        tab.bring_to_front()  # viser reconnects in a visible tab only
        tab.locator(words).wait_for(state="hidden")
        tab.wait_for_selector("[data-readout=style]")
        tab.close()
