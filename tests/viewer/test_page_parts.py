"""Parts of the page that need no browser: widgets, messages, and the addresses of a server."""

from __future__ import annotations

import html
import json
import re
import socket
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from pfnn_jax.viewer.page import background, widgets
from pfnn_jax.viewer.page.drive_input import parse_message
from pfnn_jax.viewer.page.frame_scheduler import (
    ACTIVE_SECONDS,
    FRAME,
    IDLE_INTERVAL,
    STANDING_INTERVAL,
    FramePlan,
    FrameScheduler,
)
from pfnn_jax.viewer.page.framing import frame_character
from pfnn_jax.viewer.page.guard import names_of, objection
from pfnn_jax.viewer.page.play import check_address
from pfnn_jax.viewer.page.scene import CAMERA_FIELD, CAMERA_POSITION, CAMERA_TARGET, camera_yaw
from pfnn_jax.viewer.page.skinned_body import BODY, MOST_COLOURS
from pfnn_jax.viewer.page.view import Dial
from tests.raising import assert_refused

EXACT = 1e-9  # float64 over a few products


@pytest.mark.parametrize(
    "text",
    [
        *("", "1", "1 0 0 0 0 60", "1 2 0 0 0 60 1", "1 nan 0 0 0 60 1", "1 0 0 0 0 inf 1", "1 0 0 0 0 -1 1"),
        *("1 0 0 0 0 6e9 1", "1 0 0 0 0 60 nan", "1 0 0 0 0 60 7"),
        *("x" * 200, "1 __import__('os') 0 0 0 0 1", "1 0 0 0 0 60 1 1"),
    ],
)
def test_malformed_messages_are_ignored(text):
    assert parse_message(text) is None


def test_a_message_of_the_script_is_parsed():
    message = parse_message("17 0.5 -1 1 1 59.9 1")
    assert message is not None and message.stick == (0.5, -1.0, 1.0, True) and message.rate == 59.9
    assert message.visible
    hidden = parse_message("18 0 0 0 0 0 0")
    assert hidden is not None and not hidden.visible


def test_typed_shares_sum_to_one_or_are_ignored():
    assert widgets.shares_of("50, 30 20 %") == pytest.approx((0.5, 0.3, 0.2))
    assert widgets.shares_of("2 0 2") == (0.5, 0.0, 0.5)
    for text in ("", "1 2", "1 2 x", "0 0 0", "-1 1 1", "nan 1 1", "1e400 1 1", "1 2 3 4"):
        assert widgets.shares_of(text) is None, text


def test_triangle_and_field_show_the_same_percents():
    assert widgets.percents((1 / 3, 1 / 3, 1 / 3)) == [34, 33, 33]
    assert widgets.percents((0.005, 0.005, 0.99)) == [0, 0, 100]
    assert widgets.percents((0.0, 1.0, 0.0)) == [0, 100, 0]
    shown = widgets.triangle(["a", "b", "c"], (1 / 3, 1 / 3, 1 / 3), False)
    assert [text in shown for text in ("a 34%", "b 33%", "c 33%")] == [True] * 3


def test_names_are_escaped():
    evil = '</svg><img src=x onerror="alert(1)">'
    for name in (evil, f"&deg;{evil}", "<img>&deg;"):
        shown = widgets.triangle([name, "b", "c"], (0.2, 0.3, 0.5), True)
        shown += (
            widgets.message("bad", name) + widgets.phase_dial([Dial(name, 0.0)] * 2) + widgets.legend({name: "#000000"})
        )
        assert "<img" not in shown and "&lt;" in shown


def test_the_script_knows_every_node_of_the_body():
    """Viser's page ends when one that it does not know goes with the connection."""
    code = html.unescape(widgets.script())
    found = re.search(r"for \(const name of (\[.*?\])\)", code)
    assert found is not None and "BODY_NODES" not in code
    assert json.loads(found[1]) == [f"{BODY}/{number}" for number in range(MOST_COLOURS)]


def test_every_kind_of_phase_has_dials():
    assert "velocities" in widgets.phase_dial(())
    assert "90°" in widgets.phase_dial((Dial("gait", np.pi / 2),))
    local = widgets.phase_dial(
        tuple(Dial(name, 0.0, 0.5) for name in ("left hand", "right hand", "left toe", "right toe"))
    )
    assert local.count("<line") == 4 and "right toe" in local


def test_the_contact_chart_shows_the_last_seconds():
    chart = SimpleNamespace(data=None)
    gui = SimpleNamespace(add_uplot=lambda data, **_: setattr(chart, "data", data) or chart)
    timeline = widgets.Timeline(gui)  # type: ignore[arg-type]
    for step in range(1200):
        timeline.add(step / 60.0, np.array([1.0, 0.0, 0.6, 0.4]))
    timeline.show(1200 / 60.0)
    assert chart.data is not None
    times, *lanes = chart.data
    heights = [float(np.mean(lanes[2 * i + 1] - lanes[2 * i])) for i in range(4)]
    assert len(times) == widgets.CONTACT_SAMPLES and heights[0] == heights[2] == 0.0
    assert heights[3] == pytest.approx(heights[1], abs=EXACT) and heights[1] > 0.0, "bars of one height"


def test_unusable_addresses_are_refused():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert_refused(lambda: check_address("127.0.0.1", port), place="port at 127.0.0.1", value=port)
    for host, port, place in (
        ("127.0.0.1", 70000, "port"),
        ("no.such.host.invalid", 0, "host"),
        ("a" * 70, 0, "host"),  # labels of host names have at most 63 letters
        ("a..b", 0, "host"),
    ):
        assert_refused(partial(check_address, host, port), place=place)
    check_address("127.0.0.1", 0)


@pytest.mark.parametrize(
    ("origin", "host", "fine"),
    [
        ("http://127.0.0.1:8080", "127.0.0.1:8080", True),
        ("http://localhost:8080", "LOCALHOST:8080", True),
        ("http://[::1]:8080", "[::1]:8080", True),
        ("http://192.168.1.7:8080", "192.168.1.7:8080", True),
        (None, "localhost:8080", True),  # not a browser
        ("https://evil.example", "127.0.0.1:8080", False),
        ("http://127.0.0.1:9000", "127.0.0.1:8080", False),  # another server of this machine
        ("http://127.0.0.1", "127.0.0.1:8080", False),
        ("null", "127.0.0.1:8080", False),  # a local file or a sandboxed iframe
        ("", "127.0.0.1:8080", False),
        ("http://evil.example:8080", "evil.example:8080", False),  # DNS rebinding
        ("http://127.0.0.1.evil.example", "127.0.0.1.evil.example", False),
        (None, "2130706433", False),
        (None, "[", False),
        (None, None, False),
    ],
)
def test_only_the_page_itself_is_accepted(origin, host, fine):
    assert (objection(origin, host, names_of("127.0.0.1")) is None) == fine


def test_a_public_server_is_accepted_by_its_names():
    machine = socket.gethostname()
    assert objection(None, f"{machine}:8080", names_of("0.0.0.0")) is None
    assert objection(None, "walks.example", names_of("walks.example")) is None
    assert names_of("127.0.0.1") == {"127.0.0.1"} and names_of("localhost") == {"localhost"}


def test_the_yaw_of_a_camera():
    assert camera_yaw([0.0, 1.0, -4.0], [0.0, 0.0, 0.0]) == 0.0
    assert camera_yaw([-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]) == pytest.approx(np.pi / 2)
    assert camera_yaw([0.0, 3.0, 0.0], [0.0, 0.0, 0.0]) is None


def test_advised_options_are_those_of_the_command_line():
    lines = widgets.message("warning", "Note: pass `--unit` if that is wrong.\nWarning: few steps.")
    assert lines.count("(on the command line)") == 1 and "few steps.<" in lines


def test_no_zero_has_a_sign():
    assert [widgets.plain_number(value, 2) for value in (-0.0, -0.004, 0.004, -0.006)] == ["0.00"] * 3 + ["-0.01"]


def test_a_tab_is_drawn_as_often_as_needed():
    """Fully while the character moves, fewer pictures while it stands, nothing when it rests or is hidden."""
    scheduler, rests = FrameScheduler(), 0.1 + ACTIVE_SECONDS

    def at(now: float, moving: bool = False, touched: bool = False, visible: bool = True) -> FramePlan:
        return scheduler.plan(now, visible=visible, moving=moving, touched=touched)

    assert at(0.0, moving=True) == FramePlan(True, FRAME, 0.0)
    assert at(1.0) == FramePlan(True, FRAME, STANDING_INTERVAL)
    assert not at(rests).steps and at(rests + 0.1).wait == IDLE_INTERVAL
    assert at(rests + 0.9, touched=True).steps and at(rests + 1.9).steps
    assert not at(rests + 2.0, moving=True, visible=False).steps


def test_framing_keeps_the_character_beside_the_panels():
    for width, height in ((1440, 900), (0, 0)):
        position, target = frame_character(width, height)
        assert np.allclose(position, CAMERA_POSITION) and np.allclose(target, CAMERA_TARGET)
    ahead = np.array(CAMERA_TARGET) - np.array(CAMERA_POSITION)
    for width, height in ((390, 844), (844, 390)):
        position, target = frame_character(width, height)
        assert np.allclose(target - position, ahead, atol=EXACT), "the camera looks in the same direction"
        x, y = on_screen(position, target, np.array([0.0, 0.9, 0.0]), width, height)
        if width < height:
            assert abs(x) < 0.1 * width and y < -0.1 * height, "above the middle, because the sheet is below"
        else:
            assert x < -0.1 * width, "left of the middle, because the controls are at the right"


def on_screen(position: np.ndarray, target: np.ndarray, point: np.ndarray, width: int, height: int) -> tuple:
    """Returns where a camera sees a point, in pixels to the right of the middle and below it."""
    ahead = (target - position) / np.linalg.norm(target - position)
    right = np.cross(ahead, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    seen = point - position
    scale = 0.5 * height / np.tan(CAMERA_FIELD / 2.0) / (seen @ ahead)
    return seen @ right * scale, -(seen @ np.cross(right, ahead)) * scale


def test_values_set_by_the_server_are_not_changes():
    values = widgets.FieldChanges()
    assert not values.changed("style", "proud") and values.changed("style", "neutral")
    values.set(style="angry")
    assert not values.changed("style", "angry") and values.changed("style", "neutral")


def test_background_work_returns_or_raises():
    assert background.do(lambda: 7, niceness=1) == 7
    with pytest.raises(ZeroDivisionError):
        background.do(lambda: 1 // 0)
