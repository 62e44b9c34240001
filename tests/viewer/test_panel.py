"""The panels without a browser: choices, learning, recordings and uploads."""

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

from pfnn_jax.viewer.page import downloads, wear_panel  # noqa: E402
from pfnn_jax.viewer.page import tab as tab_module  # noqa: E402
from pfnn_jax.viewer.page.frame_scheduler import SILENCE  # noqa: E402
from pfnn_jax.viewer.page.learning import MOST_JOBS, LearningBoard  # noqa: E402
from pfnn_jax.viewer.page.panel import Panel  # noqa: E402
from pfnn_jax.viewer.page.style_picker import MIXTURE, StylePicker, spread  # noqa: E402
from pfnn_jax.viewer.page.tab import Tab  # noqa: E402
from pfnn_jax.viewer.page.uploads import MOST_BUFFERED, LearnedUpload, drop_large  # noqa: E402
from pfnn_jax.viewer.page.wear_panel import NOTHING  # noqa: E402
from pfnn_jax.viewer.page.worn_character import FileContent  # noqa: E402
from tests.raising import assert_refused  # noqa: E402
from tests.viewer.threads import join_threads  # noqa: E402

SOON = 20.0  # seconds for a thread to start or end on a loaded machine


@pytest.fixture(scope="module")
def server() -> Iterator[Any]:
    served = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield served
    served.stop()


class Library:
    """A run library that has names only."""

    def __init__(self) -> None:
        self.styles = {"run": ("angry", "neutral", "proud"), "two": ("neutral", "old")}
        self.runs, self.version, self.learning = tuple(self.styles), 0, LearningBoard()
        self.strafing: dict[str, bool] = {}

    def get(self, run: str) -> SimpleNamespace:
        if run not in self.styles:
            raise InputError("library", "run", run, "must be known")
        names = self.styles[run]
        present = lambda name: name if name in names else names[0]  # noqa: E731
        return SimpleNamespace(styles=names, present_style=present, is_learned=lambda name: name == "zombie")

    def strafes(self, run: str, style: str) -> bool:
        return self.strafing.get(style, True)

    def deleted_style(self, run: str) -> None:
        return None

    def join(self, run: str, style: str) -> None:
        self.styles[run] += (style,)
        self.version += 1


class StubCharacter:
    """A character that only notes its input."""

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
    """The part of a client that a tab needs; downloads and notifications are kept."""

    client_id = 7

    def __init__(self, server: Any) -> None:
        self.gui, self.scene = server.gui, server.scene
        self.camera = SimpleNamespace(image_width=0, image_height=0, update_timestamp=0.0)
        self.received: list[tuple[str, ...]] = []

    def send_file_download(self, name: str, content: bytes, save_immediately: bool) -> None:
        self.received.append((name, content[:9].decode()))

    def add_notification(self, title: str, body: str, **_: Any) -> None:
        self.received.append((title, body))


@pytest.fixture
def client(server) -> Iterator[Client]:
    yield Client(server)
    server.gui.reset()


@pytest.fixture
def panel(client) -> Any:
    return Panel(client, any_of(Library()), any_of(StubCharacter()), any_of(SimpleNamespace(yaw=0.0, worn=None)))


def any_of(stand_in: object) -> Any:
    """Returns a stand-in as any type."""
    return stand_in


def soon(what: Callable[[], Any]) -> Any:
    end = time.monotonic() + SOON
    while not (found := what()):
        assert time.monotonic() < end
        time.sleep(0.01)
    return found


def test_no_style_can_have_the_name_of_the_mixture():
    with pytest.raises(InputError, match="style name"):
        check_style_name(MIXTURE)


def test_a_choice_made_while_a_style_arrives_is_applied(server):
    library, character = any_of(Library()), any_of(StubCharacter())
    picker = StylePicker(server.gui, library, character)
    picker.apply_changes(0.0)
    library.join("run", "zombie")
    picker._style.value = "proud"
    picker.refresh()
    assert picker._style.options == ("angry", "neutral", "proud", "zombie", MIXTURE)
    picker.apply_changes(0.1)
    assert character.shares == {"proud": 1.0}
    library.join("run", "weary")
    picker._corners[0].value = "zombie"
    picker.refresh()
    picker.apply_changes(0.2)
    assert set(character.shares) == {"zombie", "neutral", "proud"} and picker._style.value == MIXTURE
    server.gui.reset()


def test_corners_of_another_run_are_distinct():
    names = ("elderly", "masculine", "normal", "skip")
    assert spread(("elderly", "feminine", "masculine"), names) == ("elderly", "normal", "masculine")
    assert spread(("skip", "skip", "skip"), names) == ("skip", "elderly", "masculine")
    assert spread(("", "", ""), names[:2]) == ("elderly", "masculine", "elderly")


def test_corners_follow_a_change_of_run(server):
    picker = StylePicker(server.gui, any_of(Library()), any_of(StubCharacter()))
    for run, corners in (("two", {"neutral", "old"}), ("run", {"angry", "neutral", "proud"})):
        picker._run.value = run
        picker.apply_changes(0.0)
        assert set(picker._corner_names()) == corners
    server.gui.reset()


def seen(**values: Any) -> Any:
    """Returns the part of a view that a panel shows."""
    view = {"root": np.zeros(2), "facing": np.array([0.0, 1.0]), "speed": 0.0, "wanted_speed": 0.0, "dials": ()}
    view |= {"style_weights": {"angry": 1.0}, "steps_per_second": 60.0, "step_milliseconds": 1.0}
    return SimpleNamespace(**(view | {"recorded_seconds": None, "recording": False} | values))


def learned(panel: Any, style: str, *lines: tuple[str, ...], run: str = "run") -> None:
    """Does what a tab does when a style has been learned for it."""
    upload, board = LearnedUpload(style, *lines), panel._library.learning
    panel.learned(run, upload)
    board.end(board.begin(run, style), upload)
    panel.serve(0.0)


def test_a_run_that_no_list_offers_changes_nothing_while_another_tab_adds_a_style(server):
    """Viser takes any text for a choice, and a tab may follow the styles before it applies what was chosen."""
    library = Library()
    picker = StylePicker(server.gui, any_of(library), any_of(StubCharacter()))
    picker._run.value = "nan"
    library.join("run", "zombie")
    picker.refresh()
    assert picker.run == "run" and "zombie" in picker._style.options
    assert_refused(lambda: picker.apply_changes(0.0), value="nan")
    picker.apply_changes(1.0)
    server.gui.reset()


def test_a_style_learned_with_warnings_is_not_shown_as_a_success(panel, client):
    learned(panel, "neutral")
    assert not client.received
    assert 'data-message="good"' in panel._message.content and "Warning" not in panel._message.content
    learned(panel, "neutral", ("retargeted",), ("it falls", "it is not a walk"))
    assert 'data-message="warning"' in panel._message.content and "is learned" not in panel._message.content
    assert "Warning: it falls.\nWarning: it is not a walk.\nNote: retargeted." in panel._message.content
    assert [title for title, _ in client.received] == ["neutral may look poor"]


def test_notes_are_shown_with_a_success(panel):
    learned(panel, "neutral", ("retargeted from 59 to 22 joints",))
    assert 'data-message="good"' in panel._message.content
    assert panel._message.content.count("\nNote: retargeted from 59 to 22 joints.") == 1


def test_every_tab_shows_what_is_learned_and_its_outcome(client):
    library = any_of(Library())
    library.learning.clock = lambda: 100.0
    job = library.learning.begin("run", "<zombie>")
    opened_later = Panel(client, library, any_of(StubCharacter()), any_of(SimpleNamespace(yaw=0.0, worn=None)))
    opened_later.serve(0.0)
    assert "Learning &lt;zombie&gt; on run" in opened_later._jobs.content
    assert "about 40 s left" in opened_later._jobs.content
    library.learning.clock = lambda: 120.0
    library.learning.report(job, 0.5, False)
    opened_later.serve(0.1)
    assert "about 20 s left" in opened_later._jobs.content
    library.learning.report(job, 0.5, True)
    opened_later.serve(0.2)
    assert "waits for another style" in opened_later._jobs.content
    library.learning.end(job, error="walk.bvh: no feet")
    opened_later.serve(0.3)
    assert opened_later._jobs.content == "" and "no feet" in opened_later._message.content
    assert 'data-message="bad"' in opened_later._message.content


def test_a_tab_opens_in_another_style_if_its_own_was_deleted_meanwhile(client):
    library, character = Library(), StubCharacter()
    library.styles["run"] = ("neutral", "proud")
    opened = Panel(client, any_of(library), any_of(character), any_of(SimpleNamespace(yaw=0.0, worn=None)))
    assert opened._picker._style.value == "neutral"


def test_no_more_clips_wait_to_be_learned_than_fit_into_memory():
    board = LearningBoard()
    jobs = [board.begin("run", str(number)) for number in range(MOST_JOBS)]
    assert_refused(lambda: board.begin("run", "one more"), place="learning", rule_mentions="later")
    board.end(jobs[0], error="refused")
    assert board.begin("run", "again").name == "again"


def test_an_old_outcome_is_not_shown():
    board = LearningBoard(clock=lambda: 0.0)
    board.end(board.begin("run", "walk"), LearnedUpload("walk"))
    assert board.outcome() is not None
    board.clock = lambda: 10_000.0
    assert board.outcome() is None


def test_what_a_style_cannot_do_is_greyed_out(panel):
    panel.serve(0.0)
    assert not panel._strafe.disabled and panel._cannot.content == ""
    panel._library.strafing["proud"] = False
    panel._picker.select("run", "proud")
    panel.serve(0.1)
    assert panel._strafe.disabled and "proud of run: cannot sidestep" in panel._cannot.content
    panel._picker.select("run", "angry")
    panel.serve(0.2)
    assert not panel._strafe.disabled


def test_only_learned_styles_can_be_renamed_and_deleted(panel):
    assert not panel._picker._manage.visible
    panel._library.join("run", "zombie")
    panel.serve(0.0)
    panel._picker.select("run", "zombie")
    panel.serve(0.1)
    assert panel._picker._manage.visible


def test_a_refused_name_is_shown_below_its_button_until_another_style_is_chosen(panel):
    picker = panel._picker
    panel.serve(0.0)
    picker._managed(picker._rename_style)
    assert picker._refusal.visible and "new name" in picker._refusal.content
    picker.select("run", "neutral")
    panel.serve(0.1)
    assert not picker._refusal.visible


def test_a_style_is_named_before_it_is_learned(panel, client, monkeypatch):
    names = []

    def learn(*_: Any, name: str) -> LearnedUpload:
        names.append(name)
        if len(names) == 1:
            raise InputError("upload", "style name", name, "must be a file name")
        return LearnedUpload("ok")

    monkeypatch.setattr(tab_module, "learn_upload", learn)
    panel._name.value = " Größe "
    for _ in range(3):
        tab_of(client, panel._library)._learn(panel._character, panel, "take 1.bvh", b"")
    assert names == ["Größe", "Größe", ""], "a refused name is there to be corrected, and a name is used once"


def test_a_tab_counts_as_hidden_when_it_says_so_or_is_silent(panel):
    assert panel.visible(0.0), "until the script has spoken"
    panel._channel.value = "1 0 0 0 0 60 1"
    panel.serve(1.0)
    assert panel.visible(1.0) and not panel.visible(1.0 + SILENCE)
    panel._channel.value = "2 0 0 0 0 60 0"
    panel.serve(2.0)
    assert not panel.visible(2.0)


def test_an_ended_recording_can_be_downloaded(panel):
    labels = []
    for seconds, recording in ((None, False), (1.5, True), (1.5, False)):
        panel.show(seen(recorded_seconds=seconds, recording=recording), 0.0, 60.0)
        labels.append(panel._record.label)
    assert labels == ["Record", "Stop and download (1.5 s)", "Download (1.5 s)"]


def test_a_learned_style_is_not_selected_after_a_change_of_run(panel):
    library, character = panel._library, panel._character
    panel.serve(0.0)
    library.join("run", "zombie")
    learned(panel, "zombie")
    assert character.shares == {"zombie": 1.0} and "zombie is learned" in panel._message.content
    panel._picker._run.value = "two"
    panel.serve(0.2)
    library.join("run", "weary")
    learned(panel, "weary")
    assert (character.run, character.shares) == ("two", {"neutral": 1.0})
    assert "weary" in panel._message.content and "Choose that run" in panel._message.content


def test_a_download_is_written_in_the_background(panel, client, monkeypatch):
    written, free = downloads.recording_bytes, threading.Event()
    monkeypatch.setattr(downloads, "recording_bytes", lambda *given: free.wait(SOON) and written(*given))
    panel._record_or_stop()
    assert panel._character.recording and not client.received
    panel._character.clip = synthesise("zombie", np.zeros(30), np.ones(30))[0]
    panel._record_or_stop()  # returns while the file is being written
    assert not client.received
    free.set()
    assert soon(lambda: client.received) == [("angry_30.bvh", "HIERARCHY")]


def tab_of(client: Any, library: Any = None) -> Tab:
    return Tab(client, library or any_of(Library()))


def test_an_unexpected_error_of_an_upload_is_shown(panel, client, monkeypatch):
    def fail(*_: Any, **__: Any) -> str:
        raise RuntimeError("out of paper")

    monkeypatch.setattr(tab_module, "learn_upload", fail)
    with pytest.raises(RuntimeError):
        tab_of(client, panel._library)._learn(panel._character, panel, "walk.bvh", b"")
    panel.serve(0.0)
    assert "walk.bvh: RuntimeError: out of paper" in panel._message.content
    assert not panel.upload.disabled and panel.samples.visible


def test_a_second_upload_is_refused_with_a_notice(panel, client, monkeypatch):
    tab, begun, free = tab_of(client, panel._library), threading.Event(), threading.Event()

    def learn(*_: Any, **__: Any) -> LearnedUpload:
        begun.set()
        free.wait(SOON)
        return LearnedUpload("walk")

    monkeypatch.setattr(tab_module, "learn_upload", learn)
    first = threading.Thread(target=tab._learn, args=(panel._character, panel, "walk.bvh", b""))
    first.start()
    assert begun.wait(SOON) and panel.upload.disabled and not panel.samples.visible
    tab._learn(panel._character, panel, "second.bvh", b"")
    free.set()
    first.join(SOON)
    assert client.received == [
        ("second.bvh is not learned", "Another clip is being learned; try this one again afterwards.")
    ]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_error_of_the_simulation_is_shown(client, monkeypatch):
    def fail(_: Any) -> None:
        raise RuntimeError("no legs")

    monkeypatch.setattr(tab_module, "Character", fail)
    tab = tab_of(client)
    tab.start()
    soon(lambda: not tab.alive)
    assert client.received == [("Simulation stopped; reload the page", "RuntimeError: no legs")]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_file_that_comes_while_another_is_read_is_refused(panel, monkeypatch):
    begun, free, messages = threading.Event(), threading.Event(), []

    def read(*_: Any) -> Any:
        begun.set()
        assert free.wait(SOON)
        raise RuntimeError("out of paper")

    monkeypatch.setattr(wear_panel, "read_content", read)
    panel.wear.serve_learning(lambda *_: None, lambda *message: messages.append(message))
    panel.wear.take_clip("first.glb", b"")
    assert begun.wait(SOON)
    panel.wear.take_clip("second.glb", b"")
    assert soon(lambda: messages)[0][0] == "bad" and "Another file is being read" in messages[0][1]
    free.set()
    join_threads("wear")
    assert messages[1:] == [("bad", "RuntimeError: out of paper")]


def test_a_file_is_forgotten_when_nothing_more_can_be_done_with_it(panel, monkeypatch):
    learned, walk = [], FileContent("walk", ("",), body=False)
    monkeypatch.setattr(wear_panel, "read_content", lambda *_: walk)
    panel.wear.serve_learning(lambda *sent: learned.append(sent), panel.show_message)
    panel.wear.take_clip("walk.bvh", b"HIERARCHY")
    soon(lambda: learned == [("walk.bvh", b"HIERARCHY")] and panel.wear._given == NOTHING)


def test_a_character_that_another_run_cannot_move_is_taken_off(panel):
    def refuse(_: Any) -> None:
        raise InputError("hero.glb", "roles", "no left leg", "must have legs")

    panel.wear._off.visible = True
    panel._scene.set_skeleton = refuse
    panel.wear.set_skeleton(any_of(None))
    assert "no left leg" in panel.wear._message.content and not panel.wear._off.visible


def transfer(name: str, size: int) -> dict[str, Any]:
    """Returns the state of an upload as viser keeps it, without any part yet."""
    state = {"filename": name, "parts": {}, "total_bytes": size, "transferred_bytes": 0, "lock": threading.Lock()}
    return state


def test_parts_of_files_too_large_are_dropped_on_arrival():
    large, small = transfer("large.bvh", MOST_BUFFERED + 1), transfer("small.bvh", 100)
    large["parts"][0] = bytes(1000)
    transfers = {"1": large, "2": small}
    (message,) = drop_large(transfers)
    assert message.startswith("large.bvh") and drop_large(transfers) == []
    for state in transfers.values():
        state["parts"][1] = b"abc"
    assert large["parts"] == {0: b"", 1: b""} and small["parts"] == {1: b"abc"}


def test_files_that_are_too_large_together_are_dropped():
    transfers = {name: transfer(f"{name}.bvh", MOST_BUFFERED // 2) for name in "abc"}
    (message,) = drop_large(transfers)
    assert message.startswith("c.bvh")
