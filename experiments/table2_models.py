"""How many parameters and how much storage and run time do the seven models of Mason 2022 need? (Table 2)

Parent    Mason 2022 §5.2.1 and Table 2, whose times are for one frame of a Unity demo on an unnamed processor.
Question  do the models have the parameters of the table, how large are they on disk, how long does a frame take?
Expect    every count as printed, except for the FiLM generator: 39,214,592 parameters instead of 35,668,530, which
          counts each convolution without its input channels. Times: see docs/results_appendix.md. By the exact spline
          or the gating network all experts are blended in every frame; a table of 50 blended networks exists for PFNNs
          only, which is the optimisation that the paper says scales poorly to gated experts.
Run       python -m experiments.table2_models --out runs/table2_models
          Parameters are random, because neither counts nor times depend on them. Under a minute.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from experiments.common.markdown import markdown_table
from pfnn_jax.benchmarks.runtime import random_predictor, walk
from pfnn_jax.benchmarks.timing import Work, interleave, machine, versions
from pfnn_jax.inference.lookup import evaluate_lookup, make_lookup
from pfnn_jax.inference.predictor import Predictor, evaluate
from pfnn_jax.io.files import write_whole
from pfnn_jax.models.presets import TABLE2, counts, network_config

BYTES = 4
"""Bytes of a float32 parameter."""

MEGABYTE = 10**6

PAPER: dict[str, tuple[int, int, int, float]] = {
    "pfnn_one_hot": (2_436_380, 194_560, 2048, 0.78),
    "lpn_one_hot": (4_935_928, 389_120, 4096, 4.11),
    "pfnn_resad": (2_436_380, 2_978_440, 31_352, 0.92),
    "lpn_resad": (4_935_928, 24_952_320, 262_656, 4.78),
    "pfnn_film": (2_436_380, 35_668_530, 2048, 1.37),
    "mann_film": (4_870_392, 35_668_530, 2048, 4.48),
    "lpn_film": (4_935_928, 35_668_530, 2048, 4.53),
}
"""Table 2: parameters of synthesis network, modulation network and one style, and milliseconds per frame."""

COLUMNS = (
    "synthesis",
    "modulation",
    "modulation as printed",
    "per style",
    "synthesis, MB",
    "modulation, MB",
    "per style, kB",
    "frame, ms",
    "frame by table, ms",
)


@dataclass(frozen=True)
class Config:
    """The experiment; the defaults are the paper's sizes.

    Attributes:
        out: folder of results.
        num_styles: S, number of styles in the modulation column.
        num_joints: J of the timed networks.
        hidden: H of the timed networks.
        timed_frames: frames of one character per repetition.
        slices: slices of the lookup table.
        repetitions: measurements of the run times.
    """

    out: Path
    num_styles: int = 95
    num_joints: int = 25
    hidden: int = 512
    timed_frames: int = 300
    slices: int = 50
    repetitions: int = 9


def frame_works(config: Config) -> dict[str, Work]:
    """Returns works of `timed_frames` frames of each model: `NAME/frame`, and for PFNNs `NAME/table`."""
    works: dict[str, Work] = {}
    for name, preset in TABLE2.items():
        sizes = network_config(preset.backbone, config.num_joints, config.hidden)
        predictor: Predictor = random_predictor(sizes, preset.adapter)
        frame = partial(jax.jit(evaluate), predictor)
        works[f"{name}/frame"] = walk(frame, sizes, config.timed_frames)
        if preset.backbone == "pfnn":
            table = partial(evaluate_lookup, make_lookup(predictor, config.slices))
            works[f"{name}/table"] = walk(table, sizes, config.timed_frames)
    return works


def measure(config: Config) -> dict[str, Any]:
    """Returns all rows: counts and storage of the paper's character, median run times and their ratios to LPN FiLM."""
    seconds = interleave(frame_works(config), config.repetitions)
    rows, ratios = {}, {}
    for name in TABLE2:
        count = counts(name, config.num_styles)
        table = seconds.get(f"{name}/table")
        rows[name] = {
            "synthesis": count.synthesis,
            "modulation": count.modulation,
            "modulation as printed": count.modulation_published,
            "per style": count.per_style,
            "synthesis, MB": BYTES * count.synthesis / MEGABYTE,
            "modulation, MB": BYTES * count.modulation / MEGABYTE,
            "per style, kB": BYTES * count.per_style / 1000,
            "frame, ms": _milliseconds(seconds[f"{name}/frame"], config),
            "frame by table, ms": None if table is None else _milliseconds(table, config),
        }
        ratios[name] = float(np.median(seconds[f"{name}/frame"] / seconds["lpn_film/frame"]))
    return {"rows": rows, "paper": PAPER, "frame_over_lpn_film": ratios}


def _milliseconds(seconds: np.ndarray, config: Config) -> float:
    return 1e3 * float(np.median(seconds)) / config.timed_frames


def table(result: dict[str, Any]) -> str:
    """Returns a table with every model above the row of the paper."""
    lines = []
    for name, row in result["rows"].items():
        synthesis, modulation, per_style, milliseconds = PAPER[name]
        lines.append([name, *(f"{row[c]:,}" if isinstance(row[c], int) else row[c] for c in COLUMNS)])
        printed = {"synthesis": synthesis, "modulation as printed": modulation, "per style": per_style}
        cells = [f"{printed[c]:,}" if c in printed else None for c in COLUMNS[:-2]]
        lines.append([f"{name}, paper", *cells, milliseconds, None])
    return markdown_table(("", *COLUMNS), lines)


def main(config: Config) -> dict[str, Any]:
    """Measures and writes `table2_models.json` and `table2_models.md` into the folder `out`."""
    config.out.mkdir(parents=True, exist_ok=True)
    settings = {**asdict(config), "out": str(config.out)}
    result = {"config": settings, "machine": machine(), "versions": versions(), **measure(config)}
    write_whole(config.out / "table2_models.json", json.dumps(result, indent=1) + "\n")
    write_whole(config.out / "table2_models.md", table(result))
    return result


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
