"""Browsers that connect before the runs are loaded, or disconnect before their character appears."""

from __future__ import annotations

import asyncio
import time
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("viser", reason="viser is not installed")

from pfnn_jax.viewer.page import play as play_module  # noqa: E402


class Tab:
    """Notes that it was started."""

    started: list[int] = []

    def __init__(self, client: Any, library: Any) -> None:
        self._number = client.client_id

    def start(self) -> None:
        Tab.started.append(self._number)

    def close(self, wait: float = 0.0) -> None:
        pass


class Gui:
    """Keeps the content that is shown."""

    def __init__(self) -> None:
        self.shown: list[str] = []

    def add_html(self, content: str) -> SimpleNamespace:
        self.shown.append(content)
        return SimpleNamespace(remove=lambda: self.shown.remove(content))


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


def test_early_client_waits_with_message(monkeypatch):
    monkeypatch.setattr(play_module, "Tab", Tab)
    monkeypatch.setattr(Tab, "started", [])
    clients = [any_of(SimpleNamespace(client_id=number, gui=Gui())) for number in range(3)]
    with play_module.Page(port=0) as page:
        connect(page, clients[0])
        connect(page, clients[1], disconnect=True)
        assert page.tabs == () and "Compiling: your character appears in about" in clients[0].gui.shown[0]
        page.begin(any_of(SimpleNamespace()))
        assert Tab.started == [0] and clients[0].gui.shown == [], "no tab is started for a client that has left"
        connect(page, clients[2])
        assert Tab.started == [0, 2] and clients[2].gui.shown == [] and len(page.tabs) == 2


def test_a_tab_that_closes_while_it_opens_is_removed(monkeypatch):
    class Slow:
        def __init__(self, *_: Any) -> None:
            time.sleep(0.2)

        def start(self) -> None:
            pass

        def close(self, wait: float = 0.0) -> None:
            pass

    monkeypatch.setattr(play_module, "Tab", Slow)
    with play_module.Page(any_of(SimpleNamespace()), port=0) as page:
        connect(page, any_of(SimpleNamespace(client_id=7)), disconnect=True)
        time.sleep(0.4)
        assert page.tabs == ()
