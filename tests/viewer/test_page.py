"""The page in a real browser: what a person presses happens, to that person's character and to nothing else."""

from __future__ import annotations

import re
import socket
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.motion.bvh import read_bvh

# A tab may close while its picture is being sent; a served page ignores it, but each test has filters of its own.
pytestmark = pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection:UserWarning")

AT_HOME = 0.05  # metres from the middle that still count as not having moved: the start shifts its weight
NEAR = 0.2  # metres: of a step that ends and one that does not begin
CORNER = 0.9  # share of a style near whose corner the point was put


def files_of(run: Path) -> dict[str, bytes]:
    """Everything in a run's folder."""
    return {str(path.relative_to(run)): path.read_bytes() for path in run.rglob("*") if path.is_file()}


def home(visitor) -> None:
    """Back to the middle."""
    visitor.press("Reset")
    visitor.wait(lambda: np.linalg.norm(visitor.root()) < AT_HOME, "reset returns to the middle")


def test_keys_move_the_root_and_letting_go_stops_it(visitor):
    assert np.linalg.norm(visitor.root()) < AT_HOME
    visitor.walk(0.7)
    assert visitor.root()[1] > 0.5, "W leads along +Z, where the character faces at first"
    visitor.wait(lambda: "of 0.00 wanted" in visitor.read("speed"), "nothing is wanted after keys are let go")
    assert not visitor.errors


def test_shift_runs_and_keys_work_together(visitor):
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
    visitor.wait(lambda: wanted(visitor) == 0.0, "it stands again")


def test_stick_on_the_screen(visitor):
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


def test_every_finger_holds_what_it_is_on(visitor):
    """The stick stays held while a second finger presses a key, taps Shift, and leaves; it is let go with its own."""
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
    visitor.wait(lambda: turned(heading(visitor), yaw) > 0.2, "which goes on turning who walks by key")
    visitor.lift("b")
    visitor.page.keyboard.up("w")
    visitor.wait(lambda: wanted(visitor) == 0.0, "it stands again")


def test_reset(visitor):
    visitor.walk(0.3)
    home(visitor)


def test_style_is_changed_by_the_list(visitor):
    for style in ("proud", "neutral"):
        visitor.choose("Style", style)
        visitor.wait(lambda style=style: visitor.read("style") == style, f"the character is in {style}")


def test_three_styles_are_mixed_by_a_point_in_a_triangle(visitor):
    triangle = visitor.page.locator("[data-triangle]")
    triangle.scroll_into_view_if_needed()
    visitor.page.wait_for_timeout(300)  # a panel scrolls smoothly; no assertion rests on it
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


def test_recording_is_downloaded_as_bvh(visitor, tmp_path):
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


def test_a_bad_clip_says_what_is_wrong_and_changes_nothing(visitor, served, played_run, tmp_path):
    before, styles, style = files_of(played_run), visitor.options("Style"), visitor.read("style")
    bad = tmp_path / "walk.bvh"
    bad.write_text("HIERARCHY\nROOT Hips\n{\n OFFSET 0 0 nought\n}\n")
    visitor.page.locator("input[type=file]").set_input_files(bad)
    message = visitor.page.locator("[data-message=bad]")
    message.wait_for()
    assert "walk.bvh" in message.inner_text()
    assert files_of(played_run) == before
    assert visitor.options("Style") == styles and visitor.read("style") == style
    visitor.walk(0.2)


def test_a_good_clip_becomes_a_style_that_moves(visitor, played_run, zombie_bvh):
    visitor.page.locator("input[type=file]").set_input_files(zombie_bvh)
    visitor.page.locator("[data-message=good]").wait_for()
    assert "zombie walk" in visitor.options("Style")
    visitor.wait(lambda: visitor.read("style") == "zombie walk", "the character is in the new style")
    assert (played_run / "styles" / "zombie walk" / "style.json").is_file()
    visitor.walk(0.3)


def test_another_run_takes_the_character_over(visitor):
    home(visitor)
    styles, root = visitor.options("Style"), visitor.root()
    visitor.choose("Run", "two")
    visitor.wait(lambda: visitor.read("style") == "neutral", "the other run begins in its first style")
    assert "neutral" in visitor.options("Style") and "depressed" not in visitor.options("Style")
    assert np.linalg.norm(visitor.root() - root) < NEAR
    visitor.walk(0.3)
    visitor.choose("Run", "run")
    visitor.wait(lambda: visitor.read("style") == styles[0], "and back")
    assert visitor.options("Style") == styles
    visitor.walk(0.3)
    assert not visitor.errors


def test_a_camera_that_does_not_turn_along_leads(visitor):
    home(visitor)
    visitor.page.get_by_text("Camera", exact=True).first.click()
    box = visitor.field("Turn along")
    box.click()
    visitor.page.keyboard.down("w")
    visitor.wait(lambda: turned(heading(visitor), 0.0) > 0.1, "W leads where the camera looks, a little aside")
    before = heading(visitor)
    size = visitor.page.viewport_size
    x, y = 0.5 * size["width"], 0.85 * size["height"]
    visitor.page.mouse.move(x, y)
    visitor.page.mouse.down()
    visitor.page.mouse.move(x - 80, y, steps=4)
    visitor.page.mouse.up()
    visitor.wait(lambda: turned(heading(visitor), before) > 0.2, "the heading goes where the camera looks")
    visitor.page.keyboard.up("w")
    box.click()
    visitor.press("Behind the character")
    home(visitor)


def test_tabs_have_characters_of_their_own_and_leave_nothing_behind(visitor, another_visitor, served):
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
    visitor.wait(lambda: len(served.tabs) == 1, "a closed tab is forgotten")
    visitor.wait(lambda: sum(tab.alive for tab in threads) == 1, "its thread has ended")
    visitor.walk(0.3)
    assert not visitor.errors and not second.errors


def test_only_this_machine_can_connect(served):
    """A server at all addresses would answer at 127.0.0.2 too."""
    with socket.create_connection(("127.0.0.1", served.port), timeout=10.0):
        pass
    with pytest.raises(OSError), socket.create_connection(("127.0.0.2", served.port), timeout=2.0):
        pass


def handshake(port: int, *headers: str) -> str:
    """The first line of what a server answers to one who asks for a websocket."""
    key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="
    lines = ("GET / HTTP/1.1", "Connection: Upgrade", "Upgrade: websocket", key, "Sec-WebSocket-Version: 13", *headers)
    with socket.create_connection(("127.0.0.1", port), timeout=10.0) as connection:
        connection.sendall("\r\n".join((*lines, "", "")).encode())
        answer = connection.recv(4096)  # the first frames may come in the same packet: those are no text
    return answer.split(b"\r\n")[0].decode("ascii")


def test_pages_of_other_sites_are_refused(served, visitor):
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
        """(url) => new Promise((done) => {  // another name of this machine is another site
            const socket = new WebSocket(url, "viser-v");
            socket.onopen = () => done("open");
            socket.onerror = () => done("refused");
        })""",
        f"ws://localhost:{served.port}",
    )
    assert answer == "refused"


def test_a_page_that_was_cut_off_comes_back_whole(visitor, served):
    before = served.tabs
    served._server._websock_server.disconnect_all_clients()
    visitor.wait(lambda: served.tabs and not set(served.tabs) & set(before), "the page connects anew")
    visitor.wait(lambda: not any(tab.alive for tab in before), "nothing is left of what there was")
    visitor.wait(lambda: np.linalg.norm(visitor.root()) < AT_HOME, "a new character stands in the middle")
    visitor.walk(0.3)
    wire = visitor.page.get_by_text("Stick and keys", exact=True)
    assert wire.count() == 1 and not wire.is_visible()
    assert not visitor.errors


def middle(visitor, what: str) -> tuple[float, float]:
    """Of an element, in pixels of the window."""
    box = visitor.page.locator(what).first.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def wanted(visitor) -> float:
    found = re.search(r"of ([0-9.]+) wanted", visitor.read("speed"))
    assert found is not None
    return float(found[1])


def heading(visitor) -> float:
    return np.deg2rad(float(visitor.read("heading").strip("°")))


def turned(yaw: float, before: float) -> float:
    """Radians between two headings."""
    return abs(np.angle(np.exp(1j * (yaw - before))))


def share(visitor, style: str) -> float:
    """Of a style, by the readout."""
    for part in visitor.read("style").split(", "):
        if part == style:
            return 1.0
        if part.startswith(style + " ") and part.endswith("%"):
            return float(part.split()[-1].strip("%")) / 100.0
    return 0.0
