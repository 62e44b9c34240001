"""How long starts of the page have taken: what the next one is expected to take."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.io.compilation_cache import cache_folder, jax_version, make_private
from pfnn_jax.io.files import write_whole

TIMES = "start_times.json"
"""File with the seconds of earlier starts."""

FIRST_SECONDS, KEPT_SHARE = 20.0, 0.35
"""Seconds of a start for which there is no earlier one, and the share of it that a start with kept code takes."""


class StartTimes:
    """Seconds that earlier starts have taken on this machine, kept in a file next to the compiled code.

    Args:
        runs: a text for every run that is started, such as its path.
        kept: folder in which JAX keeps compiled code, or None.
        file: that holds the times of all starts.
    """

    def __init__(self, runs: Sequence[str], kept: Path | None, file: Path | None = None) -> None:
        self._file = file or cache_folder().parent / TIMES
        self._key, self._kept = " ".join([f"jax {jax_version()}", *runs]), kept
        found = self._read().get(self._key)
        self._times: dict[str, object] = found if isinstance(found, dict) else {}
        compiled = kept is not None and any(kept.glob("*-cache"))
        self._warm = compiled and self._times.get("folder") == str(kept)

    @property
    def expected(self) -> float:
        """Seconds that this start probably takes: as long as the last one, or by default as measured on two cores."""
        last = self._seconds("kept" if self._warm else "new")
        if last is not None:
            return last
        return (self._seconds("new") or FIRST_SECONDS) * (KEPT_SHARE if self._warm else 1.0)

    def note(self, seconds: float) -> None:
        """Keeps the seconds of this start; nothing happens where the file cannot be written."""
        entry = {**self._times, "kept" if self._warm else "new": round(seconds, 1)}
        entry["folder"] = None if self._kept is None else str(self._kept)
        with suppress(InputError, OSError):
            make_private(self._file.parent)
            write_whole(self._file, json.dumps({**self._read(), self._key: entry}, indent=1))

    def _seconds(self, which: str) -> float | None:
        value = self._times.get(which)
        return float(value) if isinstance(value, int | float) and 0.0 < value < 1e5 else None

    def _read(self) -> dict[str, object]:
        try:
            found = json.loads(self._file.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}
