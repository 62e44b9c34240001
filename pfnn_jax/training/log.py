"""RUN/metrics.jsonl: one line for each interval of training, readable after a kill at any moment."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import replacing, reporting_disk_errors, to_plain


def append_metrics(path: str | Path, record: Mapping[str, Any]) -> None:
    """Adds one line to RUN/metrics.jsonl; numbers that are not finite become null.

    Raises:
        InputError: if the disk is full or the run's folder cannot be written, or has been removed.
    """
    line = json.dumps(to_plain(record), allow_nan=False) + "\n"
    target = Path(path) / "metrics.jsonl"
    with reporting_disk_errors(target), target.open("a", encoding="utf-8") as file:
        file.write(line)


def read_metrics(path: str | Path) -> list[dict[str, Any]]:
    """Reads the complete lines of RUN/metrics.jsonl; a last line cut by a kill is dropped.

    Raises:
        InputError: if another line is malformed.
    """
    file = Path(path) / "metrics.jsonl"
    lines = file.read_text(encoding="utf-8").split("\n")[:-1] if file.is_file() else []
    records = []
    for number, line in enumerate(lines, 1):
        try:
            records.append(json.loads(line))
        except json.JSONDecodeError as error:
            raise InputError(file, f"line {number}", error.msg, "every line must be one JSON object") from error
    return records


def rewind_metrics(path: str | Path, step: int) -> None:
    """Drops the lines written after `step` and a last line cut by a kill, so that a resumed run repeats none."""
    records = [record for record in read_metrics(path) if record.get("step", 0) <= step]
    with replacing(Path(path) / "metrics.jsonl") as new:
        new.write_text("".join(json.dumps(record) + "\n" for record in records), encoding="utf-8")
