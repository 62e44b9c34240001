"""The page in a real browser: input acts on the tab's own character only."""

from __future__ import annotations

import re
import socket
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.gltf.write import glb_bytes
from pfnn_jax.viewer.body import grow_body
from pfnn_jax.workflows.samples import sample_clips

# A tab can close while its picture is being sent; `play` ignores the warning, but each test has its own filters.
pytestmark = pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection:UserWarning")

AT_HOME = 0.05  # metres from the middle that count as not having moved: the character shifts its weight at the start
NEAR = 0.2  # metres: a step that is completed
CORNER = 0.9  # weight of a style near whose corner the point was put
STALLED = 0.2  # share of the time for which a browser on a loaded machine may send nothing
LEARNING = 240e3  # milliseconds to wait for a style on a loaded machine


def files_of(run: Path) -> dict[str, bytes]:
    """Returns the content of every file in a run's folder."""
    return {str(path.relative_to(run)): path.read_bytes() for path in run.rglob("*") if path.is_file()}


def home(visitor) -> None:
    """Resets the character."""
    visitor.press("Reset")
    visitor.wait(lambda: np.linalg.norm(visitor.root()) < AT_HOME, "reset returns to the middle")


def test_keys_move_the_root_and_releasing_them_stops_it(visitor):
    assert np.linalg.norm(visitor.root()) < AT_HOME
    visitor.walk(0.7)
    assert visitor.root()[1] > 0.5, "W walks along +Z, the initial facing direction"
    visitor.wait(lambda: "of 0.00 wanted" in visitor.read("speed"), "no speed is commanded after keys are released")
    assert not visitor.errors


def test_shift_runs_and_keys_combine(visitor):
    visitor.page.keyboard.down("Shift")
    visitor.page.keyboard.down("w")
    visitor.wait(lambda: wanted(visitor) > 0.0, "W asks for a speed")
    running = wanted(visitor)
    visitor.page.keyboard.up("Shift")
    visitor.wait(lambda: 0.0 < wanted(visitor) < 0.75 * running, "walking is slower than running")
    yaw = heading(visitor)
    visitor.page.keyboard.down("q")
    visitor.wait(lambda: turned(heading(visitor), yaw) > 0.3, "Q turns while W is held")
    assert wanted(visitor) > 0.0
    visitor.page.keyboard.up("q")
    visitor.page.keyboard.up("w")
    visitor.wait(lambda: wanted(visitor) == 0.0, "the character stands again")


def test_the_on_screen_stick_moves_the_root(visitor):
    home(visitor)
    stick = visitor.page.locator("[data-stick]")
    stick.scroll_into_view_if_needed()
    box = stick.bounding_box()
    middle = box["x"] + box["width"] / 2
    visitor.page.mouse.move(middle, box["y"] + box["height"] / 2)
    visitor.page.mouse.down()
    visitor.page.mouse.move(middle, box["y"] + 10)
    visitor.wait(lambda: visitor.root()[1] > 0.3, "the stick moves the root")
    visitor.page.mouse.up()
    visitor.wait(lambda: wanted(visitor) == 0.0, "the stick springs back")


def test_fingers_are_independent(visitor):
    """The stick stays held while a second finger presses a key and taps Shift; only its own finger releases it."""
    home(visitor)
    for key in ("shift", "q"):
        visitor.page.locator(f".pfnn-key[data-drive={key}]").scroll_into_view_if_needed()
    x, y = middle(visitor, "[data-stick]")
    thumb, q, shift = (x, y - 40), middle(visitor, ".pfnn-key[data-drive=q]"), middle(visitor, "[data-drive=shift]")
    visitor.touch(a=thumb)
    visitor.wait(lambda: wanted(visitor) > 0.0, "the stick asks for a speed")
    walking, yaw = wanted(visitor), heading(visitor)
    visitor.touch(b=q)
    visitor.wait(lambda: turned(heading(visitor), yaw) > 0.3, "Q turns while the stick is held")
    visitor.lift("b")
    visitor.touch(b=shift)
    visitor.lift("b")
    visitor.wait(lambda: wanted(visitor) > 1.3 * walking, "Shift, tapped, makes the stick's walk a run")
    visitor.touch(b=shift)
    visitor.lift("b")
    visitor.wait(lambda: 0.0 < wanted(visitor) < 1.3 * walking, "tapped again, it is a walk")
    visitor.touch(b=q)
    visitor.lift("a")
    visitor.wait(lambda: wanted(visitor) == 0.0, "the stick springs back while Q is held")
    visitor.page.keyboard.down("w")
    yaw = heading(visitor)
    visitor.wait(lambda: turned(heading(visitor), yaw) > 0.2, "which still turns a character that walks by key")
    visitor.lift("b")
    visitor.page.keyboard.up("w")
    visitor.wait(lambda: wanted(visitor) == 0.0, "the character stands again")


def test_reset_returns_to_the_middle(visitor):
    visitor.walk(0.3)
    home(visitor)


def test_a_click_between_messages_of_driving_arrives(visitor):
    """Viser keeps the last message only of those within 50 ms."""
    visitor.walk(0.3)
    visitor.page.evaluate("""() => {
      const drive = () => document.dispatchEvent(new Event("visibilitychange"));
      const reset = [...document.querySelectorAll("button")].find((button) => button.textContent === "Reset");
      drive();
      reset.click();
      drive();
    }""")
    visitor.wait(lambda: np.linalg.norm(visitor.root()) < AT_HOME, "reset returns to the middle")


def test_the_list_changes_the_style(visitor):
    for style in ("proud", "neutral"):
        visitor.choose("Style", style)
        visitor.wait(lambda style=style: visitor.read("style") == style, f"the character is in {style}")


def test_the_triangle_mixes_three_styles(visitor):
    triangle = visitor.page.locator("[data-triangle]")
    triangle.scroll_into_view_if_needed()
    visitor.page.wait_for_timeout(300)  # the panel scrolls smoothly; no assertion depends on it
    x, y, width, height = (triangle.bounding_box()[key] for key in ("x", "y", "width", "height"))
    visitor.page.mouse.move(x + 0.5 * width, y + 0.6 * height)
    visitor.page.mouse.down()
    visitor.page.mouse.move(x + 0.5 * width, y + 0.55 * height, steps=3)
    visitor.page.mouse.up()
    visitor.wait(lambda: visitor.read("style").count("%") == 3, "all three styles have a share")
    visitor.page.mouse.move(x + 0.3 * width, y + 0.7 * height)
    visitor.page.mouse.down()
    visitor.page.mouse.move(x + 0.02 * width, y + 0.98 * height, steps=3)
    visitor.page.mouse.up()
    corner = visitor.field("Left").input_value()
    visitor.wait(lambda: share(visitor, corner) > CORNER, f"the point at the left corner is {corner}")
    visitor.page.get_by_text("Corners and shares", exact=True).first.click()
    visitor.field("Shares").fill("0 0 100")
    corner = visitor.field("Right").input_value()
    visitor.wait(lambda: share(visitor, corner) > CORNER, f"numbers work as well: {corner}")


DRAG = """() => {
  const triangle = document.querySelector("[data-triangle]"), box = triangle.getBoundingClientRect();
  // The server draws the triangle again when its point rests.
  const on = (type) => (type === "pointerdown" ? triangle : document);
  const point = (type, x, y) => on(type).dispatchEvent(new PointerEvent(type, { pointerId: 77, bubbles: true, button: 0,
    buttons: 1, clientX: box.x + x * box.width, clientY: box.y + y * box.height }));
  let count = 0;
  point("pointerdown", 0.5, 0.6);
  const timer = setInterval(() => {
    count += 1;
    if (count < 180) {
      point("pointermove", 0.5 + 0.1 * Math.sin(count), 0.6);
    } else {
      point("pointermove", 0.02, 0.98);
      point("pointerup", 0.02, 0.98);
      clearInterval(timer);
      window.dragged = true;
    }
  }, 16);
}"""
"""Drags the point of the triangle for three seconds or longer, sixty moves a second, and into the left corner."""


def test_a_held_key_walks_on_while_the_triangle_is_dragged_and_its_last_point_counts(visitor):
    home(visitor)
    visitor.page.keyboard.down("w")
    visitor.wait(lambda: wanted(visitor) > 0.0, "W asks for a speed")
    visitor.page.evaluate(DRAG)
    speeds = []
    while not visitor.page.evaluate("window.dragged === true"):
        speeds.append(wanted(visitor))
        visitor.page.wait_for_timeout(50)
    assert np.mean(np.array(speeds) == 0.0) < STALLED, "the key counts as released"
    corner = visitor.field("Left").input_value()
    visitor.wait(lambda: share(visitor, corner) > CORNER, f"the point at the left corner is {corner}")
    visitor.page.keyboard.up("w")
    visitor.wait(lambda: wanted(visitor) == 0.0, "the character stands again")


def test_a_recording_is_downloaded_as_bvh(visitor, tmp_path):
    visitor.press("Record")
    visitor.wait(lambda: visitor.page.get_by_role("button", name="Stop and download").count(), "it records")
    visitor.walk(0.4)
    with visitor.page.expect_download() as waited:
        visitor.press("Stop and download")
    path = tmp_path / "motion.bvh"
    waited.value.save_as(path)
    clip = read_bvh(path)
    assert waited.value.suggested_filename.endswith(".bvh")
    assert clip.num_frames > 20 and np.isfinite(clip.root_positions).all()
    moved = np.linalg.norm(clip.root_positions[-1, [0, 2]] - clip.root_positions[0, [0, 2]])
    assert moved > 0.3


def test_a_bad_clip_is_refused_and_changes_nothing(visitor, served, played_run, tmp_path):
    before, styles, style = files_of(played_run), visitor.options("Style"), visitor.field("Style").input_value()
    bad = tmp_path / "walk.bvh"
    bad.write_text("HIERARCHY\nROOT Hips\n{\n OFFSET 0 0 nought\n}\n")
    visitor.upload("Upload a clip", bad)
    message = visitor.page.locator("[data-message=bad]")
    message.wait_for()
    assert "walk.bvh" in message.inner_text()
    assert files_of(played_run) == before
    assert visitor.options("Style") == styles and visitor.field("Style").input_value() == style
    visitor.walk(0.2)


def test_a_good_clip_becomes_a_style_that_moves(visitor, played_run, zombie_bvh):
    visitor.upload("Upload a clip", zombie_bvh)
    visitor.page.locator("[data-message=good], [data-message=warning]").wait_for(timeout=LEARNING)
    assert "zombie walk" in visitor.options("Style")
    visitor.wait(lambda: visitor.read("style") == "zombie walk", "the character is in the new style")
    assert (played_run / "styles" / "zombie walk" / "style.json").is_file()
    visitor.walk(0.3)


def test_a_sample_clip_is_learned_as_an_upload_is(visitor, played_run):
    visitor.press("soldier")
    message = visitor.page.locator("[data-message=good], [data-message=warning]").filter(has_text="soldier")
    message.wait_for(timeout=LEARNING)
    assert message.inner_text().count("Note: ") == 1 and "retargeted from 21 to 21 joints" in message.inner_text()
    visitor.wait(lambda: visitor.read("style") == "soldier", "the character is in the new style")
    assert (played_run / "uploads" / "soldier.bvh").read_bytes() == sample_clips()["soldier"].read_bytes()


def test_the_run_can_be_changed(visitor):
    home(visitor)
    styles, root = visitor.options("Style"), visitor.root()
    visitor.choose("Run", "two")
    visitor.wait(lambda: visitor.read("style") == "neutral", "the other run starts in its first style")
    assert "neutral" in visitor.options("Style") and "depressed" not in visitor.options("Style")
    assert np.linalg.norm(visitor.root() - root) < NEAR
    visitor.walk(0.3)
    visitor.choose("Run", "run")
    visitor.wait(lambda: visitor.read("style") == styles[0], "and back")
    assert visitor.options("Style") == styles
    visitor.walk(0.3)
    assert not visitor.errors


def test_a_camera_that_does_not_turn_along_sets_the_heading(visitor):
    home(visitor)
    visitor.page.get_by_text("Camera", exact=True).first.click()
    box = visitor.field("Turn along")
    box.uncheck()  # unlike a click, fails where a folder that still opens lets it miss the box
    visitor.page.keyboard.down("w")
    visitor.wait(lambda: turned(heading(visitor), 0.0) > 0.1, "W walks where the camera looks, a little to the side")
    before = heading(visitor)
    size = visitor.page.viewport_size
    x, y = 0.5 * size["width"], 0.85 * size["height"]
    visitor.page.mouse.move(x, y)
    visitor.page.mouse.down()
    visitor.page.mouse.move(x - 80, y, steps=4)
    visitor.page.mouse.up()
    visitor.wait(lambda: turned(heading(visitor), before) > 0.2, "the heading follows the camera")
    visitor.page.keyboard.up("w")
    box.check()
    visitor.press("Behind the character")
    home(visitor)


def test_tabs_have_their_own_characters_and_end_their_threads(visitor, another_visitor, served):
    home(visitor)
    second = another_visitor()
    visitor.wait(lambda: len(served.tabs) == 2, "two tabs are served")
    threads = {tab for tab in served.tabs}
    second.walk(0.5)
    assert np.linalg.norm(visitor.root()) < AT_HOME
    second.choose("Style", "proud")
    second.wait(lambda: second.read("style") == "proud", "the second is proud")
    assert visitor.read("style") != "proud"
    second.close()
    visitor.wait(lambda: len(served.tabs) == 1, "a closed tab is removed")
    visitor.wait(lambda: sum(tab.alive for tab in threads) == 1, "its thread has ended")
    visitor.walk(0.3)
    assert not visitor.errors and not second.errors


def test_only_this_machine_can_connect(served):
    """A server at all addresses would answer at 127.0.0.2 as well."""
    with socket.create_connection(("127.0.0.1", served.port), timeout=10.0):
        pass
    with pytest.raises(OSError), socket.create_connection(("127.0.0.2", served.port), timeout=2.0):
        pass


def handshake(port: int, *headers: str) -> str:
    """Returns the first line of the server's answer to a request for a websocket."""
    key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="
    lines = ("GET / HTTP/1.1", "Connection: Upgrade", "Upgrade: websocket", key, "Sec-WebSocket-Version: 13", *headers)
    with socket.create_connection(("127.0.0.1", port), timeout=10.0) as connection:
        connection.sendall("\r\n".join((*lines, "", "")).encode())
        answer = connection.recv(4096)  # the first frames, which are not text, may be in the same packet
    return answer.split(b"\r\n")[0].decode("ascii")


def test_requests_of_other_sites_are_refused(served, visitor):
    host = f"127.0.0.1:{served.port}"
    assert " 101 " in handshake(served.port, f"Host: {host}", f"Origin: http://{host}")
    for headers in (
        (f"Host: {host}", "Origin: https://evil.example"),
        (f"Host: {host}", "Origin: null"),
        (f"Host: {host}", f"Origin: http://{host}", "Origin: https://evil.example"),
        (f"Host: evil.example:{served.port}", f"Origin: http://evil.example:{served.port}"),
    ):
        assert " 403 " in handshake(served.port, *headers), headers
    answer = visitor.page.evaluate(
        """(url) => new Promise((done) => {  // another name of this machine counts as another site
            const socket = new WebSocket(url, "viser-v");
            socket.onopen = () => done("open");
            socket.onerror = () => done("refused");
        })""",
        f"ws://localhost:{served.port}",
    )
    assert answer == "refused"


def test_a_page_reconnects_after_an_interruption(visitor, served):
    before = served.tabs
    served._server._websock_server.disconnect_all_clients()
    visitor.wait(lambda: served.tabs and not set(served.tabs) & set(before), "the page reconnects")
    visitor.wait(lambda: not any(tab.alive for tab in before), "the old threads have ended")
    visitor.wait(lambda: np.linalg.norm(visitor.root()) < AT_HOME, "a new character stands in the middle")
    visitor.walk(0.3)
    wire = visitor.page.get_by_text("Stick and keys", exact=True)
    assert wire.count() == 1 and not wire.is_visible()
    assert not visitor.errors


def middle(visitor, what: str) -> tuple[float, float]:
    """Returns the centre of an element in pixels of the window."""
    box = visitor.page.locator(what).first.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def wanted(visitor) -> float:
    found = re.search(r"of ([0-9.]+) wanted", visitor.read("speed"))
    assert found is not None
    return float(found[1])


def heading(visitor) -> float:
    return np.deg2rad(visitor.numbers()[2])


def turned(yaw: float, before: float) -> float:
    """Returns the angle between two headings in radians."""
    return abs(np.angle(np.exp(1j * (yaw - before))))


def share(visitor, style: str) -> float:
    """Returns a style's weight according to the readout."""
    for part in visitor.read("style").split(", "):
        if part == style:
            return 1.0
        if part.startswith(style + " ") and part.endswith("%"):
            return float(part.split()[-1].strip("%")) / 100.0
    return 0.0


def test_a_character_is_worn_driven_and_taken_off(visitor, zombie_bvh, tmp_path):
    clip = read_bvh(zombie_bvh)
    path = tmp_path / "my rig.glb"
    path.write_bytes(glb_bytes(clip.skeleton, grow_body(clip.skeleton), {}))
    visitor.upload("Wear a character", path)
    visitor.wait(lambda: visitor.page.get_by_text("my rig (").count(), "the character is worn")
    visitor.walk(0.3)
    visitor.press("Own body")
    visitor.wait(lambda: not visitor.page.get_by_text("my rig (").count(), "it is taken off")
    visitor.walk(0.3)
    assert not visitor.errors


def test_a_file_that_holds_a_body_and_no_clip_is_offered_to_wear(visitor, zombie_bvh, tmp_path):
    clip = read_bvh(zombie_bvh)
    path = tmp_path / "statue.glb"
    path.write_bytes(glb_bytes(clip.skeleton, grow_body(clip.skeleton), {}))
    visitor.upload("Upload a clip", path)
    visitor.press("Wear it")
    visitor.wait(lambda: visitor.page.get_by_text("statue (").count(), "the character is worn")
    visitor.press("Own body")
    assert not visitor.errors
