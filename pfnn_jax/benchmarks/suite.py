"""The benchmark of all systems: medians of repetitions, compared within one run."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from pfnn_jax.benchmarks.characters import rigged_figures
from pfnn_jax.benchmarks.crowds import crowd_figures
from pfnn_jax.benchmarks.lpn import (
    generator_config,
    generator_figures,
    local_phase_figures,
    lpn_character_figures,
    lpn_preparation_figures,
    lpn_sizes,
    lpn_step_figures,
)
from pfnn_jax.benchmarks.other_libraries import PACKAGES, is_installed
from pfnn_jax.benchmarks.preparation import preparation_figures
from pfnn_jax.benchmarks.runtime import character_figures
from pfnn_jax.benchmarks.timing import REST, Figure, machine, versions
from pfnn_jax.benchmarks.torch_training import torch_step_figures
from pfnn_jax.benchmarks.training import few_shot_figures, rate_figures, step_figures
from pfnn_jax.benchmarks.transfer import (
    TransferSizes,
    command_figures,
    fast_figures,
    optimisation_figures,
    training_figures,
)
from pfnn_jax.errors import check_at_least
from pfnn_jax.models.config import NetworkConfig


def _mocap() -> Path | None:
    folder = os.environ.get("PFNN_JAX_MOCAP")
    return Path(folder) if folder else None


@dataclass(frozen=True)
class BenchmarkConfig:
    """Sizes of the benchmark; the defaults are the papers' networks and take about 4 minutes on two idle cores.

    Attributes:
        num_joints: J of the layout `mason2018`, which gives the network's inputs and outputs (234 and 400 at 31).
        hidden: H.
        rank: R of the CP adapters.
        batch_sizes: batch sizes of the training steps; the share of the product rate is measured at the largest.
        steps_per_dispatch: training steps compiled into one call.
        few_shot_frames: frames of the clip of a new style, before mirroring.
        few_shot_epochs: epochs of few-shot training.
        characters: sizes of the crowds.
        frames: frames of one character per repetition.
        lpn_joints: J of the layout `mason2022`, which gives the LPN's inputs and outputs (348 and 342 at 25).
        generator_filters, generator_hidden: sizes of the FiLM generator.
        clips: clips that the generator reads at once.
        seconds_per_style: seconds of procedural motion to prepare for each of 8 styles.
        transfer: sizes of style transfer.
        rest: seconds of sleep before each measurement of a frame (`timing.REST`).
        repetitions: measurements of every short figure; long ones are measured a third as often.
        mocap: folder with real motion capture (`bandai-namco-2`, `pfnn`) to prepare; from PFNN_JAX_MOCAP by default.
    """

    num_joints: int = 31
    hidden: int = 512
    rank: int = 30
    batch_sizes: tuple[int, ...] = (32, 256)
    steps_per_dispatch: int = 10
    few_shot_frames: int = 300
    few_shot_epochs: int = 100
    characters: tuple[int, ...] = (1, 16, 256, 1024)
    frames: int = 300
    lpn_joints: int = 25
    generator_filters: int = 256
    generator_hidden: int = 2048
    clips: int = 8
    seconds_per_style: float = 30.0
    transfer: TransferSizes = TransferSizes()
    rest: float = REST
    repetitions: int = 9
    mocap: Path | None = field(default_factory=_mocap)

    def __post_init__(self):
        check_at_least(self, "num_joints", "hidden", "rank", "steps_per_dispatch", "few_shot_frames")
        check_at_least(self, "few_shot_epochs", "frames", "repetitions")
        check_at_least(self, "seconds_per_style", least=5)

    @property
    def network(self) -> NetworkConfig:
        """Sizes of the measured network."""
        return NetworkConfig(48 + 6 * self.num_joints, 28 + 12 * self.num_joints, self.hidden)


def run_benchmark(
    config: BenchmarkConfig | None = None, *, on_section: Callable[[str], None] = lambda name: None
) -> dict[str, Any]:
    """Measures training steps, few-shot learning, run time, preparation and style transfer.

    Args:
        config: sizes.
        on_section: called with the name of each section before it is measured.

    Returns:
        `machine`, `versions`, total `seconds`, `figures`: `Figure.to_json` of every figure, and `left_out`: libraries
        that are not installed and therefore not compared.
    """
    config = config or BenchmarkConfig()
    started, figures = time.perf_counter(), []
    for name, measure in _sections(config).items():
        on_section(name)
        figures += measure()
    return {
        "machine": machine(),
        "versions": versions(),
        "seconds": time.perf_counter() - started,
        "figures": [figure.to_json() for figure in figures],
        "left_out": [library for library in PACKAGES if not is_installed(library)],
    }


def _sections(config: BenchmarkConfig) -> dict[str, Callable[[], list[Figure]]]:
    sizes, rank, repetitions, steps = config.network, config.rank, config.repetitions, config.steps_per_dispatch
    sections: dict[str, Callable[[], list[Figure]]] = {}
    for batch in config.batch_sizes:
        sections[f"training steps of {batch} frames"] = lambda b=batch: step_figures(sizes, rank, b, repetitions, steps)
    largest = max(config.batch_sizes)
    sections["share of the matrix-product rate"] = lambda: rate_figures(sizes, rank, largest, repetitions, steps)
    sections |= _sections_pytorch(config)
    sections["one character"] = lambda: character_figures(sizes, rank, repetitions, config.frames, config.rest)
    few = max(1, repetitions // 3)
    sections["crowds"] = lambda: crowd_figures(config.hidden, config.characters, few)
    sections |= _sections_2022(config)
    sections |= _sections_transfer(config)
    sections["rigged characters"] = lambda: rigged_figures(few)
    sections["preparation"] = lambda: preparation_figures(config.mocap, config.seconds_per_style, few)
    # Last, because it clears the caches of compiled functions.
    sections["few-shot learning"] = lambda: few_shot_figures(
        sizes, rank, config.few_shot_frames, config.few_shot_epochs, few
    )
    return sections


def _sections_pytorch(config: BenchmarkConfig) -> dict[str, Callable[[], list[Figure]]]:
    """Returns the sections that compare training steps with PyTorch, where it is installed."""
    if not is_installed("PyTorch"):
        return {}
    options = config.network, config.rank
    return {
        f"training steps of {batch} frames in PyTorch": lambda b=batch: torch_step_figures(
            *options, b, config.repetitions, config.steps_per_dispatch
        )
        for batch in config.batch_sizes
    }


def _sections_2022(config: BenchmarkConfig) -> dict[str, Callable[[], list[Figure]]]:
    """Returns the sections of the system of Mason 2022."""
    sizes, repetitions = lpn_sizes(config.lpn_joints, config.hidden), config.repetitions
    few = max(1, repetitions // 3)
    generator = generator_config(config.lpn_joints, config.hidden, config.generator_filters, config.generator_hidden)
    sections: dict[str, Callable[[], list[Figure]]] = {}
    for batch in config.batch_sizes:
        sections[f"LPN training steps of {batch} frames"] = lambda b=batch: lpn_step_figures(
            sizes, b, few, config.steps_per_dispatch
        )
    sections["one character of an LPN"] = lambda: lpn_character_figures(sizes, repetitions, config.frames, config.rest)
    sections["FiLM generator"] = lambda: generator_figures(generator, config.clips, few)
    sections["local phases"] = lambda: local_phase_figures(config.seconds_per_style, few)
    sections["preparation for an LPN"] = lambda: lpn_preparation_figures(config.mocap, config.seconds_per_style, few)
    return sections


def _sections_transfer(config: BenchmarkConfig) -> dict[str, Callable[[], list[Figure]]]:
    """Returns the sections of the system of Holden 2017, and of the optimisation of 2016."""
    sizes, repetitions = config.transfer, config.repetitions
    return {
        "style transfer by the fast network": lambda: fast_figures(sizes, repetitions),
        "style transfer by optimisation": lambda: optimisation_figures(sizes, max(1, repetitions // 3)),
        "training of style transfer": lambda: training_figures(sizes),
        "style transfer of a clip": lambda: command_figures(sizes, repetitions),
    }


def print_benchmark(result: dict[str, Any], console: Console | None = None) -> None:
    """Prints the result of `run_benchmark` as a table."""
    console = console or Console()
    about = result["machine"]
    console.print(f"{about['processor']}, {about['cores']} cores, {about['backend']}; {result['seconds']:.0f} s total")
    table = Table("figure", "median", "quartiles", "aim", "", "n")
    section = None
    for row in result["figures"]:
        if row["section"] != section:
            section = row["section"]
            table.add_section()
            table.add_row(f"[bold]{section}")
        sign = "≤" if row["at_most"] else "≥"
        aim = "" if row["aim"] is None else f"{sign} {_number(row['aim'])}"
        met = {True: "[green]met", False: "[red]missed", None: ""}[row["meets_aim"]]
        spread = f"{_number(row['low'])} to {_number(row['high'])}" if row["repetitions"] > 1 else ""
        value = f"{_number(row['value'])} {row['unit']}".rstrip()
        table.add_row(f"  {row['name']}", value, spread, aim, met, str(row["repetitions"]))
    console.print(table)
    for library in result["left_out"]:
        console.print(f"{library} is not installed: what compares with it was left out.")


def _number(value: float) -> str:
    """Formats a number with three digits, without an exponent."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
