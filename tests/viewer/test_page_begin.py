"""Browsers that connect before the runs are loaded, or disconnect before their character appears."""

from __future__ import annotations

import asyncio
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from pfnn_jax.viewer.page import play as play_module  # noqa: E402
from pfnn_jax.viewer.page import widgets  # noqa: E402
from pfnn_jax.viewer.page.start_screen import StartProgress, standing_body  # noqa: E402

FLAT = 0.2  # metres: both feet are near the floor, in a mean pose of walking
UPRIGHT = 1.2  # metres above it
RIGID = 1e-6  # metres


class Tab:
    """Notes that it was started."""

    started: list[int] = []

    def __init__(self, client: Any, library: Any, scene: Any = None) -> None:
        self._number = client.client_id

    def start(self) -> None:
        Tab.started.append(self._number)

    def close(self, wait: float = 0.0) -> None:
        pass


def any_of(stand_in: object) -> Any:
    """Returns a stand-in as any type."""
    return stand_in


def connect(page: Any, client: Any, *, disconnect: bool = False) -> None:
    """Does what the server does when a browser connects and, if wanted, disconnects."""

    async def run() -> None:
        await page._open(client)
        if disconnect:
            await page._close(client)

    asyncio.run(run())


def test_early_client_waits_and_sees_the_progress(monkeypatch):
    monkeypatch.setattr(play_module, "Tab", Tab)
    monkeypatch.setattr(Tab, "started", [])
    clients = [any_of(SimpleNamespace(client_id=number)) for number in range(3)]
    seconds = iter((0.0, *[12.0] * 100))
    progress = StartProgress(40.0, clock=lambda: next(seconds))
    with play_module.Page(port=0, progress=progress) as page:
        connect(page, clients[0])
        connect(page, clients[1], disconnect=True)
        note = any_of(page._note)
        progress.report("Compiling a step")
        page._show_progress()
        assert page.tabs == () and "Compiling a step" in note.content
        assert "12 s so far" in note.content and "about 28 s to go" in note.content
        page.begin(any_of(SimpleNamespace(runs=("run",))))
        assert Tab.started == [0] and page._note is None, "no tab is started for a client that has left"
        connect(page, clients[2])
        assert Tab.started == [0, 2] and len(page.tabs) == 2


def test_the_body_stands_before_anything_is_loaded(trained_run):
    body = standing_body(trained_run, "run")
    skeleton, roles = body.skeleton, body.skeleton.roles
    assert roles is not None
    feet = body.view.joints[[*roles.left_foot, *roles.right_foot], 1]
    assert np.abs(feet).max() < FLAT and body.view.joints[roles.head, 1] > UPRIGHT
    lengths = np.linalg.norm(body.view.joints[1:] - body.view.joints[skeleton.parents[1:]], axis=1)
    np.testing.assert_allclose(lengths, np.linalg.norm(skeleton.offsets[1:], axis=1), atol=RIGID)


def test_a_start_that_takes_longer_than_expected_says_so():
    assert "longer than expected" in widgets.start_note("Compiling", 50.0, 40.0)
    assert "to go" not in widgets.start_note("Compiling", 5.0, None)


def test_a_tab_that_closes_while_it_opens_is_removed(monkeypatch):
    class Slow:
        def __init__(self, *_: Any) -> None:
            time.sleep(0.2)

        def start(self) -> None:
            pass

        def close(self, wait: float = 0.0) -> None:
            pass

    monkeypatch.setattr(play_module, "Tab", Slow)
    with play_module.Page(any_of(SimpleNamespace(runs=("run",))), port=0) as page:
        connect(page, any_of(SimpleNamespace(client_id=7)), disconnect=True)
        time.sleep(0.4)
        assert page.tabs == ()
