"""A few tabs that do anything for some seconds; `experiments/page_under_load.py` lets twenty do so for an hour."""

from __future__ import annotations

import asyncio
import logging
import threading

import psutil
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from experiments import page_under_load  # noqa: E402
from experiments.common.page_tab import open_tab  # noqa: E402
from experiments.common.random_visitor import WRONG  # noqa: E402
from tests.viewer.watching import SECONDS, until  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection:UserWarning")


def tab_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("tab ")]


def test_random_input_leaves_no_thread_and_no_traceback(served, tmp_path, caplog, capsys, monkeypatch):
    """Learning is left out, which takes longer than this."""
    offered = page_under_load.acts(())
    fewer = {name: (offered[name][0], 1.0) for name in offered if name != "sample"}
    monkeypatch.setattr(page_under_load, "acts", lambda files: fewer)
    caplog.set_level(logging.WARNING)
    config = page_under_load.Config(tmp_path, seconds=6.0, tabs=4, pause=0.02, life=2.0, every=1.0)
    found = asyncio.run(page_under_load.load(psutil.Process(), served.port, config))
    assert set(found.acts) == set(fewer) and found.ends["by the server, code 1007"] > 0
    assert set(found.ends) <= {"closed", "by the server, code 1007"}
    assert until(lambda: not served.tabs and not tab_threads()), tab_threads()
    assert not [record for record in caplog.records if record.levelno >= logging.ERROR]
    assert "Traceback" not in capsys.readouterr().err


def test_values_that_fit_no_control_are_dropped_without_a_word(served, caplog):
    """They are of a kind that browsers send, so the connection stays, and the tab keeps working."""

    async def send_all() -> bool:
        async with open_tab("127.0.0.1", served.port) as tab:
            assert await tab.until(lambda: any(control.label == "Speed" for control in tab.controls.values()), SECONDS)
            for value in (value for value in WRONG if isinstance(value, bool | int | float | str)):
                for control in list(tab.controls.values()):
                    await tab.set(control, value)
            seen = tab.frames
            return await tab.until(lambda: tab.frames > seen + 20, SECONDS)

    caplog.set_level(logging.ERROR)
    assert asyncio.run(send_all()) and not caplog.records
