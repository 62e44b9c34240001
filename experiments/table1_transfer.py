"""How long do both methods of style transfer take? (Holden 2017, Table 1)

Parent    Holden 2017, Table 1: the fast network and the optimisation of 2016, clips of 240, 480 and 960 frames, on a
          GeForce GTX 660.
Question  what do both take on this machine, and does the time grow as slowly with the length of the clip as in the
          paper?
Measure   medians of interleaved repetitions, after compilation, from normalised rows to normalised rows: the fast
          network with its projection (of the paper's sizes), and 250 + 100 iterations of the optimisation; reading,
          retargeting and holding feet are not in them, as they are not in the paper's. The fast network is also
          measured as `transfer` applies it, which projects the content as well.
Expect    see docs/results_appendix.md.
Run       python -m experiments.table1_transfer --out runs/table1_transfer
          Parameters are random and clips procedural, because times depend on neither.
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from experiments.common.markdown import markdown_table
from pfnn_jax.benchmarks.timing import interleave, machine, versions
from pfnn_jax.benchmarks.transfer import TransferSizes, applied_works, fast_works, optimisation_works, time_forms
from pfnn_jax.io.files import write_json, write_whole

PAPER = {
    "fast network": {240: 0.0120, 480: 0.0140, 960: 0.0170},
    "optimisation": {240: 15.219, 480: 20.341, 960: 33.371},
}
"""Seconds of Table 1, by number of frames."""

OURS = "ours"
"""Name in `fast_works` of the form that the package uses."""


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        out: folder of results.
        sizes: of networks, clips and iterations; the paper's by default.
        repetitions: of the fast network; the optimisation is measured a third as often.
    """

    out: Path
    sizes: TransferSizes = TransferSizes()
    repetitions: int = 21


def measure(config: Config) -> dict[str, dict[int, np.ndarray]]:
    """Returns the seconds [n] of both methods, and of the other forms of the fast network, by number of frames."""
    found: dict[str, dict[int, np.ndarray]] = {}
    applied = applied_works(config.sizes)
    for num_frames, works in fast_works(config.sizes).items():
        works = {**works, "as `transfer` applies it": applied[num_frames]}
        for name, seconds in time_forms(works, config.repetitions).items():
            title = "fast network" if name == OURS else f"fast network, {name}"
            found.setdefault(title, {})[num_frames] = seconds
    works = {str(num_frames): work for num_frames, work in optimisation_works(config.sizes).items()}
    seconds = interleave(works, max(1, config.repetitions // 3))
    return {**found, "optimisation": {int(name): value for name, value in seconds.items()}}


def main(config: Config) -> dict[str, Any]:
    """Measures and writes `table1_transfer.json` and `table1_transfer.md` into the folder `out`."""
    config.out.mkdir(parents=True, exist_ok=True)
    load = os.getloadavg()[0]
    seconds = measure(config)
    rows = {
        method: {
            num_frames: {
                "median": float(np.median(values)),
                "quartiles": np.quantile(values, (0.25, 0.75)).tolist(),
                "least": float(values.min()),
                "frames per second": num_frames / float(np.median(values)),
                "paper": PAPER.get(method, {}).get(num_frames),
            }
            for num_frames, values in by_frames.items()
        }
        for method, by_frames in seconds.items()
    }
    settings = {**asdict(config), "out": str(config.out)}
    about = {"machine": machine(), "versions": versions(), "load_before": load}
    result = {"config": settings, **about, "rows": rows}
    head = ["method", "frames", "seconds", "quartiles", "least", "frames per second", "paper, GTX 660, s"]
    lines = [
        [
            method,
            str(num_frames),
            row["median"],
            " to ".join(f"{value:.3g}" for value in row["quartiles"]),
            row["least"],
            row["frames per second"],
            row["paper"],
        ]
        for method, by_frames in rows.items()
        for num_frames, row in by_frames.items()
    ]
    text = markdown_table(head, lines)
    write_json(config.out / "table1_transfer.json", result)
    write_whole(config.out / "table1_transfer.md", text)
    print(f"{about['machine']['processor']}, {about['machine']['cores']} cores, load before {load:.1f}\n{text}")
    return result


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
