"""The panel without a browser: what is chosen, learned, recorded and uploaded, on a server that nobody looks at."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.motion.datasets.sources import check_style_name
from pfnn_jax.motion.synthetic.walks import synthesise

viser = pytest.importorskip("viser", reason="viser is not installed")

from viser import _messages as messages  # noqa: E402

from pfnn_jax.viewer.page import panel as panel_module  # noqa: E402
from pfnn_jax.viewer.page import tab as tab_module  # noqa: E402
from pfnn_jax.viewer.page import widgets  # noqa: E402
from pfnn_jax.viewer.page.panel import Panel  # noqa: E402
from pfnn_jax.viewer.page.style_picker import MIXTURE, StylePicker, spread  # noqa: E402
from pfnn_jax.viewer.page.tab import Tab  # noqa: E402
from pfnn_jax.viewer.page.uploads import MOST_GATHERED, drop_large  # noqa: E402

SOON = 20.0  # seconds: a thread's beginning and end, on a machine with other work


@pytest.fixture(scope="module")
def server() -> Iterator[Any]:
    served = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield served
    served.stop()


class LoadedRun:
    """A library of names alone."""

    def __init__(self) -> None:
        self.styles = {"run": ("angry", "neutral", "proud"), "two": ("neutral", "old")}
        self.runs, self.version = tuple(self.styles), 0

    def get(self, run: str) -> SimpleNamespace:
        if run not in self.styles:
            raise InputError("library", "run", run, "must be known")
        return SimpleNamespace(styles=self.styles[run])

    def join(self, run: str, style: str) -> None:
        self.styles[run] += (style,)
        self.version += 1


class Puppet:
    """A character that only notes what it is asked for."""

    def __init__(self) -> None:
        self.run, self.shares = "run", {"angry": 1.0}
        self.clip: Any = None
        self.recording = False

    def choose(self, run: str, style: str) -> None:
        self.run, self.shares = run, {style: 1.0}

    def mix(self, names: tuple[str, ...], weights: tuple[float, ...]) -> None:
        self.shares = dict(zip(names, weights, strict=True))

    def start_recording(self) -> None:
        self.recording = True

    def stop_recording(self) -> Any:
        clip, self.clip = self.clip, None
        return clip

    def set_stick(self, *_: float) -> None:
        pass


class Client:
    """What a tab needs of a browser; downloads and notifications are kept."""

    client_id = 7

    def __init__(self, server: Any) -> None:
        self.gui, self.scene = server.gui, server.scene
        self.told: list[tuple[str, ...]] = []

    def send_file_download(self, name: str, content: bytes, save_immediately: bool) -> None:
        self.told.append((name, content[:9].decode()))

    def add_notification(self, title: str, body: str, **_: Any) -> None:
        self.told.append((title, body))


@pytest.fixture
def client(server) -> Iterator[Client]:
    yield Client(server)
    server.gui.reset()


@pytest.fixture
def panel(client) -> Any:
    return Panel(client, any_of(LoadedRun()), any_of(Puppet()), any_of(SimpleNamespace(yaw=0.0)))


def any_of(stand_in: object) -> Any:
    """A stand-in where the real thing is asked for."""
    return stand_in


def soon(what: Callable[[], Any]) -> Any:
    end = time.monotonic() + SOON
    while not (found := what()):
        assert time.monotonic() < end
        time.sleep(0.01)
    return found


def test_no_style_can_be_called_as_the_mixture_is():
    with pytest.raises(InputError, match="style name"):
        check_style_name(MIXTURE)


def test_a_choice_beside_a_style_that_arrives_is_heard(server):
    library, character = any_of(LoadedRun()), any_of(Puppet())
    picker = StylePicker(server.gui, library, character)
    picker.hear(0.0)
    library.join("run", "zombie")
    picker._style.value = "proud"
    picker.refresh()
    assert picker._style.options == ("angry", "neutral", "proud", "zombie", MIXTURE)
    picker.hear(0.1)
    assert character.shares == {"proud": 1.0}
    library.join("run", "weary")
    picker._corners[0].value = "zombie"
    picker.refresh()
    picker.hear(0.2)
    assert set(character.shares) == {"zombie", "neutral", "proud"} and picker._style.value == MIXTURE
    server.gui.reset()


def test_corners_of_another_run_are_all_different():
    names = ("elderly", "masculine", "normal", "skip")
    assert spread(("elderly", "feminine", "masculine"), names) == ("elderly", "normal", "masculine")
    assert spread(("skip", "skip", "skip"), names) == ("skip", "elderly", "masculine")
    assert spread(("", "", ""), names[:2]) == ("elderly", "masculine", "elderly")


def test_a_run_of_two_styles_leaves_no_corner_behind(server):
    picker = StylePicker(server.gui, any_of(LoadedRun()), any_of(Puppet()))
    for run, corners in (("two", {"neutral", "old"}), ("run", {"angry", "neutral", "proud"})):
        picker._run.value = run
        picker.hear(0.0)
        assert set(picker._corner_names()) == corners
    server.gui.reset()


def seen(**values: Any) -> Any:
    """A moment of a character, as far as a panel shows it."""
    view = {"root": np.zeros(2), "facing": np.array([0.0, 1.0]), "speed": 0.0, "wanted_speed": 0.0, "dials": ()}
    view |= {"style_weights": {"angry": 1.0}, "steps_per_second": 60.0, "step_milliseconds": 1.0}
    return SimpleNamespace(**(view | {"recorded_seconds": None, "recording": False} | values))


def test_a_style_chosen_while_it_stands_says_how_to_see_it(panel):
    def told(**values: Any) -> bool:
        panel.show(seen(**values), 0.0, 60.0)
        return widgets.UNSEEN in panel._readout.content

    assert not told()
    panel._picker.select("run", "proud")
    assert told() and told() and not told(wanted_speed=1.0) and not told()
    panel._picker.select("run", "proud")
    assert not told()
    panel.learned("run", "neutral")
    assert told() and widgets.UNSEEN in panel._message.content and not told(speed=0.5)


def test_a_recording_that_has_ended_waits_for_its_download(panel):
    labels = []
    for seconds, recording in ((None, False), (1.5, True), (1.5, False)):
        panel.show(seen(recorded_seconds=seconds, recording=recording), 0.0, 60.0)
        labels.append(panel._record.label)
    assert labels == ["Record", "Stop and download (1.5 s)", "Download (1.5 s)"]


def test_a_style_learned_does_not_call_back_who_has_gone_on(panel):
    library, character = panel._library, panel._character
    panel.serve(0.0)
    library.join("run", "zombie")
    panel.learned("run", "zombie")
    panel.serve(0.1)
    assert character.shares == {"zombie": 1.0} and "zombie is learned" in panel._message.content
    panel._picker._run.value = "two"
    panel.serve(0.2)
    library.join("run", "weary")
    panel.learned("run", "weary")
    panel.serve(0.3)
    assert (character.run, character.shares) == ("two", {"neutral": 1.0})
    assert "weary" in panel._message.content and "choose that run" in panel._message.content


def test_a_download_is_written_beside_the_character(panel, client, monkeypatch):
    written, free = panel_module.bvh_bytes, threading.Event()
    monkeypatch.setattr(panel_module, "bvh_bytes", lambda clip: free.wait(SOON) and written(clip))
    panel._record_or_stop()
    assert panel._character.recording and not client.told
    panel._character.clip = synthesise("zombie", np.zeros(30), np.ones(30))[0]
    panel._record_or_stop()  # would wait for the writing
    assert not client.told
    free.set()
    assert soon(lambda: client.told) == [("angry_30.bvh", "HIERARCHY")]


def tab_of(client: Any) -> Tab:
    return Tab(client, any_of(LoadedRun()))


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_upload_that_fails_as_nobody_expected_is_told(panel, client, monkeypatch):
    def fail(*_: Any) -> str:
        raise RuntimeError("out of paper")

    monkeypatch.setattr(tab_module, "learn_upload", fail)
    tab, file = tab_of(client), any_of(SimpleNamespace(name="walk.bvh", content=b""))
    with pytest.raises(RuntimeError):
        tab._learn(panel._character, panel, file)
    assert "walk.bvh: RuntimeError: out of paper" in panel._message.content
    assert not panel.upload.disabled


def test_a_second_file_meanwhile_is_not_dropped_without_a_word(panel, client, monkeypatch):
    tab, begun, free = tab_of(client), threading.Event(), threading.Event()

    def learn(*_: Any) -> str:
        begun.set()
        free.wait(SOON)
        return "walk"

    monkeypatch.setattr(tab_module, "learn_upload", learn)
    files = [any_of(SimpleNamespace(name=name, content=b"")) for name in ("walk.bvh", "second.bvh")]
    first = threading.Thread(target=tab._learn, args=(panel._character, panel, files[0]))
    first.start()
    assert begun.wait(SOON)
    tab._learn(panel._character, panel, files[1])
    free.set()
    first.join(SOON)
    assert client.told == [("second.bvh is not learned", "Another file is being learned: upload it again after that.")]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_character_that_stops_says_so(client, monkeypatch):
    def fail(_: Any) -> None:
        raise RuntimeError("no legs")

    monkeypatch.setattr(tab_module, "Character", fail)
    tab = tab_of(client)
    tab.start()
    soon(lambda: not tab.alive)
    assert client.told == [("The character has stopped: load the page anew", "RuntimeError: no legs")]


def send(gui: Any, button: Any, transfer: str, size: int, parts: int, name: str = "walk.bvh") -> None:
    """The beginning of a file, as a browser tells it."""
    start = messages.FileTransferStartUpload(button._impl.uuid, transfer, name, "", parts, size)
    gui._handle_file_transfer_start(7, start)


@pytest.mark.filterwarnings(r"ignore:\[viser\] Dropping upload:UserWarning")
def test_files_too_large_are_not_gathered_but_come_to_their_end(server, monkeypatch):
    """Until a page has been told of all parts of a file it takes no other."""
    gui, told = server.gui, []
    monkeypatch.setattr(gui._websock_interface, "queue_message", told.append)
    button = gui.add_upload_button("Upload")
    send(gui, button, "large", MOST_GATHERED + 3, 2, "large.bvh")
    part = lambda index, content: messages.FileTransferPart(button._impl.uuid, "large", index, content)  # noqa: E731
    gui._handle_file_transfer_part(7, part(0, bytes(MOST_GATHERED)))
    transfers = gui._current_file_upload_states
    assert drop_large(transfers) == ["large.bvh: the file is far larger than 10 MB"]
    assert drop_large(transfers) == [], "each is told of once"
    assert set(transfers["large"]["parts"].values()) == {b""}
    gui._handle_file_transfer_part(7, part(1, b"abc"))
    acks = [message.transferred_bytes for message in told if isinstance(message, messages.FileTransferPartAck)]
    assert acks == [MOST_GATHERED, MOST_GATHERED + 3] and not transfers
    for transfer in "abc":
        send(gui, button, transfer, MOST_GATHERED // 2, 1, f"{transfer}.bvh")
    assert drop_large(transfers) == ["c.bvh: the file comes with too many others"]
    transfers.clear()
