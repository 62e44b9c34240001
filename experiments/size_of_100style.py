"""Does data of 100STYLE's size fit a small machine? (docs/scale.md)

Question  how long does it take, and how much memory, to prepare 4.06 million frames of 100 styles and to train on
          them from the disk, and how fast is that next to training on rows in memory?
Data      a folder in the form of 100STYLE: its tables, takes, lengths, rate and joints, with procedural walkers in
          place of people (`experiments.common.hundred_styles`).
Expect    at most 4 GB of memory for each command with all its processes.
Method    `write`: the folder. `prepare`: the layout of Mason 2022, with a tenth held out for validation. `train`: the
          LPN with FiLM, 2,000 steps at batch 32, read from the disk. `compare`: chunks of steps on some styles, in
          turn from the disk (not in the system's cache, then in it) and from memory, with FiLM and with CP adapters,
          whose steps are cheap, so that reading shows. Each is a process of its own; its memory is looked at every
          second, and includes its workers'.
Run       python -m experiments.size_of_100style --out runs/size
          Needs 25 GB of disk; stages can be run one by one (--stages prepare). About an hour on two cores.
"""

from __future__ import annotations

import json
import os
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any, Literal

import tyro

from experiments.common.hundred_styles import write_folder
from experiments.common.measured_command import measure_command
from pfnn_jax.io.files import write_json
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.motion.datasets.dataset import load_dataset
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.data import Rows
from pfnn_jax.training.log import read_metrics
from pfnn_jax.training.pretraining import pretrain

Stage = Literal["write", "prepare", "train", "compare"]

COMMAND = "import sys; from pfnn_jax.cli import main; sys.exit(main())"
"""Runs `pfnn-jax` of this checkout."""

KINDS = {"film": 1, "cp": 8}
"""Kinds of styles that are compared, and how many times as many steps are timed of each, as they are cheaper."""


FIRST_CHUNKS = 5
"""Chunks of which the first is compiled, while the next ones are read ahead."""


@dataclass(frozen=True)
class Config:
    """The experiment; the defaults are 100STYLE's size.

    Attributes:
        out: folder of the takes, the dataset, the run and `size.json`.
        styles: number of styles.
        length: of takes, relative to those of 100STYLE.
        steps: of training.
        hidden: H.
        workers: processes that write and prepare; None for the default of `prepare`.
        stages: what to do; results of other stages stay.
        compared_styles: styles whose rows are trained on from memory too.
        compared_steps: steps with FiLM of each compared training.
        chunk: steps between two measurements of the speed.
    """

    out: Path
    styles: int = 100
    length: float = 1.0
    steps: int = 2000
    hidden: int = 512
    workers: int | None = None
    stages: tuple[Stage, ...] = ("write", "prepare", "train", "compare")
    compared_styles: int = 8
    compared_steps: int = 50
    chunk: int = 5

    @property
    def clips(self) -> Path:
        """Folder of the takes."""
        return self.out / "clips"

    @property
    def dataset(self) -> Path:
        """Folder of the dataset."""
        return self.out / "dataset"

    @property
    def run(self) -> Path:
        """Folder of the run."""
        return self.out / "run"


def main(config: Config) -> dict[str, Any]:
    """Does the stages, each in a process of its own; returns what `size.json` holds."""
    config.out.mkdir(parents=True, exist_ok=True)
    file = config.out / "size.json"
    found: dict[str, Any] = json.loads(file.read_text()) if file.is_file() else {}
    for stage in config.stages:
        usage = measure_command(command_of(stage, config), config.out / f"{stage}.log")
        if usage.exit_status:
            sys.exit(f"{stage}: exit status {usage.exit_status}, see {config.out / stage}.log")
        found[stage] = asdict(usage) | figures_of(stage, config)
        write_json(file, found)
        print(stage, json.dumps(found[stage]))
    return found


def command_of(stage: Stage, config: Config) -> list[str]:
    """Returns the command of a stage."""
    workers = [] if config.workers is None else ["--workers", str(config.workers)]
    if stage == "prepare":
        options = ["--layout", "mason2022", "--validation", "0.1", "--overwrite", *workers]
        return [sys.executable, "-c", COMMAND, "prepare", str(config.clips), "--out", str(config.dataset), *options]
    if stage == "train":
        options = ["--adapter.kind", "film", "--hidden", str(config.hidden), "--steps", str(config.steps)]
        options += ["--batch-size", "32", "--overwrite"]
        return [sys.executable, "-c", COMMAND, "pretrain", str(config.dataset), "--out", str(config.run), *options]
    own = ["--styles", str(config.styles), "--length", str(config.length), "--hidden", str(config.hidden), *workers]
    own += ["--compared-styles", str(config.compared_styles), "--compared-steps", str(config.compared_steps)]
    own += ["--chunk", str(config.chunk), "--out", str(config.out)]
    return [sys.executable, "-m", "experiments.size_of_100style", "--own", stage, *own]


def figures_of(stage: Stage, config: Config) -> dict[str, Any]:
    """Returns what a stage has made."""
    if stage == "write":
        return {"takes": len(list(config.clips.rglob("*.bvh"))), "bytes": bytes_below(config.clips)}
    if stage == "prepare":
        rows = {split: sum(styles.values()) for split, styles in load_dataset(config.dataset).rows.items()}
        return {"rows": rows, "bytes": bytes_below(config.dataset)}
    if stage == "train":
        rates = [line["frames_per_second"] for line in read_metrics(config.run)]
        return {"frames_per_second": median(rates), "bytes": bytes_below(config.run)}
    return json.loads((config.out / "compared.json").read_text())


def bytes_below(folder: Path) -> int:
    """Returns the size of all files of a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def compare(config: Config) -> dict[str, float]:
    """Returns frames per second of training from the disk and from memory, for two kinds of styles."""
    dataset = load_dataset(config.dataset)
    stored = Rows.from_dataset(dataset, dataset.styles[-config.compared_styles :], max_bytes=0)
    resident = stored.in_memory()
    rates: dict[str, list[float]] = {}
    for kind, longer in KINDS.items():
        for _ in range(2):
            for place, rows in (("disk, not cached", stored), ("disk, cached", stored), ("memory", resident)):
                if place == "disk, not cached":
                    forget(config.dataset)
                rates.setdefault(f"{kind}, {place}", []).extend(chunk_rates(rows, kind, longer, config))
    return {name: median(values) for name, values in rates.items()} | {"resident_bytes": resident.nbytes}


def chunk_rates(rows: Rows, kind: str, longer: int, config: Config) -> list[float]:
    """Returns the frames per second of each chunk of steps of a training but the first ones."""
    rates = []
    steps = longer * config.compared_steps
    settings = PretrainConfig(AdapterConfig(kind), hidden=config.hidden, steps=steps, steps_per_dispatch=config.chunk)
    pretrain(rows, settings, progress_callback=lambda progress: rates.append(progress.frames_per_second))
    return rates[FIRST_CHUNKS:]


def forget(folder: Path) -> None:
    """Drops the files of a folder from the system's cache, so that they are read from the disk."""
    for path in folder.rglob("*.npy"):
        with path.open("rb") as file:
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def run_own(stage: str, config: Config) -> None:
    """Does a stage that is no command of the package."""
    if stage == "write":
        write_folder(config.clips, config.styles, config.length, workers=config.workers or 2)
    else:
        write_json(config.out / "compared.json", compare(config))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--own"]:
        run_own(sys.argv[2], tyro.cli(Config, args=sys.argv[3:]))
    else:
        main(tyro.cli(Config))
