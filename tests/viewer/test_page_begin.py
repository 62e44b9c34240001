"""Who comes to a page and when: before it has compiled, and gone again before the character is there."""

from __future__ import annotations

import asyncio
import time
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("viser", reason="viser is not installed")

from pfnn_jax.viewer.page import play as play_module  # noqa: E402


class Tab:
    """Notes that it has begun, and ends when it is closed."""

    begun: list[int] = []

    def __init__(self, client: Any, library: Any) -> None:
        self._number = client.client_id

    def start(self) -> None:
        Tab.begun.append(self._number)

    def close(self, wait: float = 0.0) -> None:
        pass


class Gui:
    """Keeps what is shown."""

    def __init__(self) -> None:
        self.shown: list[str] = []

    def add_html(self, content: str) -> SimpleNamespace:
        self.shown.append(content)
        return SimpleNamespace(remove=lambda: self.shown.remove(content))


def any_of(stand_in: object) -> Any:
    """A stand-in where the real thing is asked for."""
    return stand_in


def come(page: Any, client: Any, *, go: bool = False) -> None:
    """What the server does when a browser connects, and when it leaves."""

    async def coming() -> None:
        await page._server._dispatch_client_callbacks(tuple(page._server._client_connect_cb), client)
        if go:
            await page._server._dispatch_client_callbacks(tuple(page._server._client_disconnect_cb), client)

    asyncio.run(coming())


def test_who_comes_before_the_runs_are_ready_waits_and_is_told(monkeypatch):
    monkeypatch.setattr(play_module, "Tab", Tab)
    monkeypatch.setattr(Tab, "begun", [])
    clients = [any_of(SimpleNamespace(client_id=number, gui=Gui())) for number in range(3)]
    with play_module.Page(port=0) as page:
        come(page, clients[0])
        come(page, clients[1], go=True)
        assert page.tabs == () and "Compiling: your character comes in about" in clients[0].gui.shown[0]
        page.begin(any_of(SimpleNamespace()))
        assert Tab.begun == [0] and clients[0].gui.shown == [], "none is begun for who has left"
        come(page, clients[2])
        assert Tab.begun == [0, 2] and clients[2].gui.shown == [] and len(page.tabs) == 2


def test_a_tab_that_closes_while_it_opens_leaves_nothing(monkeypatch):
    class Slow:
        def __init__(self, *_: Any) -> None:
            time.sleep(0.2)

        def start(self) -> None:
            pass

        def close(self, wait: float = 0.0) -> None:
            pass

    monkeypatch.setattr(play_module, "Tab", Slow)
    with play_module.Page(any_of(SimpleNamespace()), port=0) as page:
        come(page, any_of(SimpleNamespace(client_id=7)), go=True)
        time.sleep(0.4)
        assert page.tabs == ()
