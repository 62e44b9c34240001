"""Files of an experiment's results."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from pfnn_jax.benchmarks.timing import machine, versions
from pfnn_jax.io.files import json_text, write_whole


def write_results(config: Any, table: str, **found: Any) -> dict[str, Any]:
    """Writes `results.json` and `table.md` into `config.out`, and returns what the first holds.

    Args:
        config: dataclass of the experiment's settings, with the folder `out`.
        table: in Markdown.
        found: results; the settings, the machine and the versions are added.
    """
    settings = {name: str(value) if isinstance(value, Path) else value for name, value in asdict(config).items()}
    result = {"config": settings, "machine": machine(), "versions": versions(), **found}
    config.out.mkdir(parents=True, exist_ok=True)
    write_whole(config.out / "results.json", json_text(result))
    write_whole(config.out / "table.md", table)
    return result
