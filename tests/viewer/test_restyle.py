"""Restyling on the page: what `transfer_clip` does, with uploads that are checked and named as they were sent."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.transfer.config import OptimisationConfig
from pfnn_jax.viewer.page import restyle as restyle_module
from pfnn_jax.viewer.page.restyle import ClipUpload, check_clip, restyle
from pfnn_jax.workflows import transfer as workflow
from pfnn_jax.workflows.samples import sample_clips
from pfnn_jax.workflows.transfer import transfer_clip
from tests.raising import assert_refused
from tests.transfer_runs import make_transfer_run, make_walk
from tests.viewer.pages import captions, check_page
from tests.viewer.threads import join_threads

DECIMALS = 2e-5  # metres: numbers in a BVH file have 6 decimals, in centimetres


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small run and a walk."""
    folder = tmp_path_factory.mktemp("restyle")
    make_transfer_run(folder)
    make_walk(folder / "walk.bvh")
    return folder


@pytest.fixture(autouse=True)
def small_and_quick(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The small run in place of the package's, and few iterations."""
    monkeypatch.setattr(workflow, "BASE_AUTOENCODER", folder / "run")
    quick = OptimisationConfig(iterations=3, constraint_iterations=2)
    monkeypatch.setattr(workflow, "OptimisationConfig", lambda: quick)


@pytest.fixture
def walk(folder: Path) -> ClipUpload:
    return check_clip("C:\\clips\\my walk.bvh", (folder / "walk.bvh").read_bytes())


@pytest.fixture
def zombie() -> ClipUpload:
    return ClipUpload("zombie", sample_clips()["zombie"].read_bytes())


def test_the_result_equals_that_of_the_workflow(folder, walk, zombie, tmp_path):
    shares: list[float] = []
    done = restyle(walk, zombie, 1.2, "upper", lambda share, what: shares.append(share))
    (tmp_path / "result.bvh").write_bytes(done.bvh)
    again = transfer_clip(folder / "walk.bvh", sample_clips()["zombie"], strength=1.2, parts="upper").clip
    clip = read_bvh(tmp_path / "result.bvh", travel="keep")
    np.testing.assert_allclose(clip.root_positions, again.root_positions, atol=DECIMALS)
    assert done.name == "my walk_zombie" and shares == sorted(shares) and shares[-1] == 1.0


def test_content_style_and_result_play_side_by_side(walk, zombie):
    page = restyle(walk, zombie, 1.0, "all").page
    check_page(page)
    assert captions(page) == ["my walk", "zombie", "result"]


def test_messages_name_files_as_they_were_sent(walk, zombie):
    error = assert_refused(lambda: restyle(walk, walk, 1.0, "all"), file="my walk.bvh", place="style")
    assert error.file == "my walk.bvh" and "content/" not in str(error) and "/tmp" not in str(error)
    broken = ClipUpload("broken", b"HIERARCHY\nROOT Hips\n{\n")
    assert assert_refused(lambda: restyle(walk, broken, 1.0, "all")).file == "broken.bvh"
    ape = ClipUpload("ape", sample_clips()["ape"].read_bytes())
    assert not any("style/" in note or "/tmp" in note for note in restyle(walk, ape, 1.0, "all").notes)


def test_uploads_that_cannot_be_clips_are_refused_when_they_arrive():
    assert_refused(lambda: check_clip("walk.fbx", b"HIERARCHY"), file="upload", place="file name")
    assert_refused(lambda: check_clip("walk.bvh", b"HIERARCHY\0"), file="walk.bvh", place="file")


def test_one_clip_at_a_time(walk, zombie, monkeypatch):
    begun, free, said = threading.Event(), threading.Event(), []
    transfer = restyle_module.transfer_clip

    def slowly(*args: Any, **options: Any) -> Any:
        begun.set()
        assert free.wait(60.0)
        return transfer(*args, **options)

    monkeypatch.setattr(restyle_module, "transfer_clip", slowly)
    first = threading.Thread(target=restyle, args=(walk, zombie, 1.0, "all"))
    first.start()
    assert begun.wait(60.0)
    second = threading.Thread(
        target=restyle, args=(walk, zombie, 1.0, "all", lambda share, what: said.append(what)), daemon=True
    )
    second.start()
    end = time.monotonic() + 60.0
    while not said and time.monotonic() < end:
        time.sleep(0.01)
    assert said == ["waiting"]
    free.set()
    first.join()
    second.join()


viser = pytest.importorskip("viser", reason="viser is not installed")

from pfnn_jax.viewer.page import restyle_panel as panel_module  # noqa: E402
from pfnn_jax.viewer.page.restyle import Restyled  # noqa: E402
from pfnn_jax.viewer.page.restyle_panel import MOST_STYLES, RestylePanel, player_frame  # noqa: E402


@pytest.fixture(scope="module")
def server() -> Iterator[Any]:
    served = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield served
    served.stop()


@pytest.fixture
def client(server: Any) -> Iterator[Any]:
    received: list[tuple[str, bytes]] = []
    yield SimpleNamespace(
        gui=server.gui,
        received=received,
        send_file_download=lambda name, content, save_immediately: received.append((name, content)),
    )
    server.gui.reset()


@pytest.fixture
def panel(client: Any) -> RestylePanel:
    return RestylePanel(client)


DONE = Restyled(
    "walk_zombie",
    "walk in the style of zombie",
    b"HIERARCHY",
    "<!doctype html><title>a</title>",
    ("zombie.bvh: retargeted",),
    1.5,
)


def working(monkeypatch: pytest.MonkeyPatch, result: Callable[..., Restyled]) -> list[tuple[Any, ...]]:
    """Replaces the work; returns the arguments that it is called with."""
    calls: list[tuple[Any, ...]] = []
    monkeypatch.setattr(panel_module, "restyle", lambda *args: calls.append(args) or result(*args))
    return calls


def test_the_panel_restyles_what_was_uploaded_as_chosen(panel, client, walk, monkeypatch):
    calls = working(monkeypatch, lambda *_: DONE)
    panel._take_content("walk.bvh", walk.data)
    panel._take_style("old.bvh", walk.data + b"\n")
    panel._strength.value, panel._parts.value = 0.5, "arms"
    panel.begin()
    content, style, strength, parts, _ = calls[0]
    assert (content.name, style.name, strength, parts) == ("walk", "old", 0.5, "arms")
    assert 'data-message="good"' in panel._message.content and "Note: zombie.bvh: retargeted." in panel._message.content
    assert all(button.visible for button in panel._results) and not panel._bar.visible
    panel._send_bvh()
    panel._send_page()
    assert client.received == [("walk_zombie.bvh", DONE.bvh), ("walk_zombie.html", DONE.page.encode())]


def test_a_sample_is_a_style_and_other_names_are_refused(panel, walk, monkeypatch):
    calls = working(monkeypatch, lambda *_: DONE)
    panel._take_content("walk.bvh", walk.data)
    panel._style.value = "soldier"
    panel.begin()
    assert calls[0][1] == ClipUpload("soldier", sample_clips()["soldier"].read_bytes())
    panel._style.value = "../../etc/passwd"
    panel.begin()
    assert len(calls) == 1 and 'data-message="bad"' in panel._message.content


def test_without_a_clip_nothing_is_done(panel, monkeypatch):
    calls = working(monkeypatch, lambda *_: DONE)
    panel.begin()
    assert not calls and 'data-message="bad"' in panel._message.content


def test_refusals_are_shown_and_the_button_works_again(panel, walk, monkeypatch):
    def refuse(*_: Any) -> Restyled:
        raise InputError("walk.bvh", "length", "24 frames", "must be longer")

    working(monkeypatch, refuse)
    panel._take_content("walk.bvh", walk.data)
    panel.begin()
    assert "walk.bvh: length: 24 frames; must be longer" in panel._message.content
    assert not panel._begin.disabled and not panel._results[0].visible


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_unexpected_error_of_an_upload_is_shown(panel):
    def take(filename: str, data: bytes) -> None:
        raise RuntimeError("out of paper")

    sent = SimpleNamespace(target=SimpleNamespace(value=SimpleNamespace(name="walk.bvh", content=b"")))
    asyncio.run(panel._receiver(take)(sent))
    join_threads("restyle")
    assert "out of paper" in panel._message.content


def test_the_last_style_clips_are_kept(panel, walk):
    for number in range(MOST_STYLES + 3):
        panel._take_style(f"style {number}.bvh", walk.data)
    panel._take_style("style 5.bvh", walk.data)
    assert len(panel._styles) == MOST_STYLES and list(panel._styles)[-1] == "style 5"
    assert set(sample_clips()) < set(panel._style.options)


def test_the_player_is_isolated():
    frame = player_frame('<p title="a">&</p>')
    assert 'sandbox="allow-scripts"' in frame and "&lt;p title=&quot;a&quot;&gt;&amp;&lt;/p&gt;" in frame


def test_no_more_clips_wait_to_be_restyled_than_fit_into_memory(monkeypatch):
    monkeypatch.setattr(restyle_module, "_waiting", threading.BoundedSemaphore(1))
    clip = ClipUpload("walk", b"")
    with restyle_module._waiting:
        assert_refused(lambda: restyle(clip, clip, 1.0, "all"), place="restyling", rule_mentions="later")
    refused = assert_refused(lambda: restyle(clip, clip, 1.0, "all"))
    assert refused.place != "restyling", "the place is free again"
    assert restyle_module._waiting.acquire(blocking=False), "and given back"
