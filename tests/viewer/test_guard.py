"""What the page's socket takes: messages of this page, and nothing else, whatever is sent and however often."""

from __future__ import annotations

import gc
import logging
import threading
import time
from random import Random

import pytest

from pfnn_jax.viewer.page.guard import NOT_A_MESSAGE, guarded, is_message

viser = pytest.importorskip("viser", reason="viser is not installed")
msgspec = pytest.importorskip("msgspec")

SECONDS = 20.0  # on a loaded machine


@pytest.fixture(scope="module")
def server():
    with guarded("127.0.0.1") as started:
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    assert started
    yield server
    server.stop()


def connect(server, **options):
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    address = f"127.0.0.1:{server.get_port()}"
    protocols = [Subprotocol(f"viser-v{viser.__version__}")]
    return connect(
        f"ws://{address}", subprotocols=protocols, **{"origin": f"http://{address}", "open_timeout": SECONDS, **options}
    )


def connections(server) -> dict:
    """Returns what viser holds for each connection; `get_clients` has only those that have sent their camera."""
    return server._websock_server._client_state_from_id


def packed(value) -> bytes:
    return msgspec.msgpack.encode(value)


GARBAGE = [
    b"",
    "text",
    b"\xff" * 100,
    b"\x81\xa4type",
    b"\x91" * 50_000,
    b"\xdd\xff\xff\xff\xff",
    packed([]),
    packed(5),
    packed({}),
    packed({"type": "Nothing"}),
    packed({"type": 5}),
    packed({"type": ["a"]}),
    packed({"type": "GuiUpdateMessage"}),
    packed({"type": "GuiUpdateMessage", "uuid": "a", "updates": {}, "more": 1}),
    packed({"type": "FileTransferPart", "content": b"0" * 1000}),
    *(Random(seed).randbytes(200) for seed in range(20)),
]


def test_connections_that_send_no_messages_are_closed_and_nothing_is_left(server, caplog):
    from websockets.exceptions import ConnectionClosed

    caplog.set_level(logging.WARNING)
    connect(server).close()
    threads = threading.active_count()
    for frame in GARBAGE:
        assert not is_message(frame)
        with connect(server) as connection, pytest.raises(ConnectionClosed) as closed:
            connection.send(frame)
            while True:
                connection.recv(timeout=SECONDS)
        assert closed.value.rcvd is not None and closed.value.rcvd.code == NOT_A_MESSAGE, frame[:40]
    began = time.monotonic()
    while connections(server) and time.monotonic() - began < SECONDS:
        time.sleep(0.05)
    gc.collect()  # tasks that failed would be reported now
    assert not connections(server) and threading.active_count() <= threads
    assert not [record for record in caplog.records if record.levelno >= logging.ERROR]


def test_what_follows_garbage_is_dropped(server, caplog):
    """It has arrived already when the connection is closed, and would reach viser without a check."""
    from websockets.exceptions import ConnectionClosed

    caplog.set_level(logging.ERROR)
    for _ in range(5):
        with connect(server) as connection, pytest.raises(ConnectionClosed):
            for _ in range(20):
                connection.send(packed({"type": "Nothing"}))
            while True:
                connection.recv(timeout=SECONDS)
    began = time.monotonic()
    while connections(server) and time.monotonic() - began < SECONDS:
        time.sleep(0.05)
    gc.collect()
    assert not connections(server) and not caplog.records


CAMERA = {
    **{"type": "ViewerCameraMessage", "wxyz": [1, 0, 0, 0], "position": [0, 0, 1], "look_at": [0, 0, 0]},
    **{"up_direction": [0, 1, 0], "fov": 1, "near": 0.1, "far": 10.0, "image_height": 10, "image_width": 10},
}


@pytest.mark.parametrize(
    ("message", "changes"),
    [
        (CAMERA, {"position": [float("nan"), 0, 0]}),
        (CAMERA, {"look_at": [0, 0]}),
        (CAMERA, {"image_width": -1}),
        ({"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": True}}, {"updates": {"update_cb": []}}),
        ({"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": 0.5}}, {"updates": {"value": [1]}}),
        ({"type": "CommandTriggerMessage", "uuid": "a"}, {"type": "GuiFormDirtyMessage"}),
        ({"type": "CommandTriggerMessage", "uuid": "a"}, {"type": "GuiRemoveMessage"}),
    ],
)
def test_only_the_messages_of_browsers_are_taken(message, changes):
    """Others are viser's too, but of servers, or name attributes of its controls."""
    assert is_message(packed(message)) and not is_message(packed({**message, **changes}))


def test_files_of_any_size_may_begin_so_that_those_too_large_are_refused_by_a_message():
    start = {"type": "FileTransferStartUpload", "source_component_uuid": "a", "transfer_uuid": "b", "filename": "c.bvh"}
    assert is_message(packed({**start, "mime_type": "", "part_count": 6000, "size_bytes": 3 * 10**9}))


def test_messages_of_a_browser_are_still_taken(server):
    message = packed({"type": "GuiUpdateMessage", "uuid": "unknown", "updates": {"value": 1}})
    assert is_message(message)
    with connect(server) as connection:
        connection.recv(timeout=SECONDS)
        for _ in range(20):
            connection.send(message)
        assert connection.ping().wait(SECONDS) and len(connections(server)) == 1


@pytest.mark.parametrize(
    "headers",
    [{"origin": "https://evil.example"}, {"origin": "null"}, {"additional_headers": {"Host": "evil.example"}}],
)
def test_other_sites_are_refused_before_they_can_send(server, headers):
    from websockets.exceptions import InvalidHandshake

    with pytest.raises(InvalidHandshake):
        connect(server, **headers)
