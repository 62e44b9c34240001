"""How long earlier starts of the page have taken, and when that is kept."""

from __future__ import annotations

import contextlib
from pathlib import Path
from types import SimpleNamespace

import pytest

from pfnn_jax.viewer.page.start_times import FIRST_SECONDS, KEPT_SHARE, StartTimes


@pytest.mark.parametrize("keep", [True, False])
def test_the_seconds_of_a_start_are_kept_only_with_its_compiled_code(monkeypatch, keep: bool):
    pytest.importorskip("viser", reason="viser is not installed")
    from pfnn_jax.viewer.page import background, play

    class Library:
        runs = ()

        def warm_up(self, meanwhile: object) -> None: ...

        def empty_trash(self) -> None: ...

        @property
        def styles(self) -> None:
            raise KeyboardInterrupt  # as soon as the page is announced

    noted: list[float] = []
    page = SimpleNamespace(url="", begin=lambda library: None)
    times = SimpleNamespace(expected=1.0, note=noted.append)
    stubs = {"standing_body": None, "RunLibrary": Library(), "Page": contextlib.nullcontext(page), "StartTimes": times}
    for name, value in (stubs | {"check_finished": None, "cancel_learning": None, "_cache": None}).items():
        monkeypatch.setattr(play, name, lambda *_, value=value, **__: value)
    monkeypatch.setattr(background, "leave_work", lambda code: None)
    play.play(["run"], port=0, keep_compiled=keep)
    assert len(noted) == keep


def test_a_start_is_expected_to_take_as_long_as_the_last(tmp_path: Path):
    file, kept = tmp_path / "times.json", tmp_path / "kept"
    kept.mkdir()
    assert StartTimes(["run"], kept, file).expected == FIRST_SECONDS
    StartTimes(["run"], kept, file).note(60.0)
    assert StartTimes(["run"], kept, file).expected == 60.0, "nothing was kept"
    (kept / "step-cache").write_bytes(b"code")
    assert StartTimes(["run"], kept, file).expected == pytest.approx(60.0 * KEPT_SHARE)
    StartTimes(["run"], kept, file).note(12.0)
    assert StartTimes(["run"], kept, file).expected == 12.0
    assert StartTimes(["run"], None, file).expected == 60.0
    assert StartTimes(["other"], kept, file).expected == FIRST_SECONDS


@pytest.mark.parametrize("text", ["", "[1]", '{"jax": 3}', "{"])
def test_a_damaged_file_of_times_is_as_none(tmp_path: Path, text: str):
    file = tmp_path / "times.json"
    file.write_text(text)
    times = StartTimes(["run"], None, file)
    assert times.expected == FIRST_SECONDS
    times.note(5.0)
    assert StartTimes(["run"], None, file).expected == 5.0
