"""How much memory, training time and run time do the adapters need? (Mason 2018, Table 1)

Parent    Mason 2018 §7.1 and Table 1: full, diagonal and CP adapters of rank 30, on a GPU and a laptop's processor.
Question  do the three adapters need the memory and times of the paper, and is a network that is CP-decomposed in every
          layer as small and fast as the paper mentions (136 MB to 1 MB, 3 to 4 times faster)?
Expect    memory as in the paper (4.01/50.1, .016/.20, .120/.125 MB), whose megabytes are 2^20 bytes for full and
          diagonal and 10^6 bytes for CP. On 2 cores, training 16.4, 5.7 and 6.7 s with compilation (paper: 99, 44 and
          50 s on a GPU); by lookup the adapters cost the same (.24 to .28 ms), as full and diagonal ones are added into
          the table and a CP adapter is two thin matrix products. The CP network is 340 times smaller than the 50 slices
          of the full one (112 to .33 MB), 4.3 times faster at the exact spline, 3.8 times by lookup, 8.2 in a crowd.
Run       python -m experiments.table1_adapters --out runs/table1_adapters
          Frames are random, because neither time nor memory depends on them.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from experiments.common.markdown import markdown_table
from pfnn_jax.benchmarks.runtime import random_predictor, walk
from pfnn_jax.benchmarks.timing import Work, interleave, machine, versions
from pfnn_jax.benchmarks.training import random_frames
from pfnn_jax.inference.lookup import evaluate_lookup, make_lookup
from pfnn_jax.inference.predictor import Predictor, evaluate
from pfnn_jax.io.files import write_whole
from pfnn_jax.models.config import AdapterConfig, AdapterKind, NetworkConfig
from pfnn_jax.models.network import init_network
from pfnn_jax.training.config import FewShotConfig
from pfnn_jax.training.few_shot_learning import train_grid

MEBIBYTE = 2**20
BLENDED = ("weights", "biases", "d")
"""Fields of layers whose leading axis is the control points."""

KINDS: tuple[AdapterKind, ...] = ("full", "diagonal", "cp")

PAPER: dict[str, dict[str, float]] = {
    "full": {"control points, MB": 4.01, "50 slices, MB": 50.1, "training, s": 99.0, "lookup, ms": 1.3},
    "diagonal": {"control points, MB": 0.016, "50 slices, MB": 0.20, "training, s": 44.0, "lookup, ms": 1.0},
    "cp": {"control points, MB": 0.126, "50 slices, MB": 0.131, "training, s": 50.0, "lookup, ms": 1.1},
}
"""Table 1: memory of one adapter, seconds of training of one style, milliseconds of a forward pass."""

COLUMNS = ("control points, MB", "50 slices, MB", "training, s", "exact, ms", "lookup, ms", "crowd, ms")


@dataclass(frozen=True)
class Config:
    """The experiment; the defaults are the paper's sizes.

    Attributes:
        out: folder of results.
        num_joints: J of the layout `mason2018`: 234 inputs and 400 outputs at 31.
        hidden: H.
        rank: rank of the CP adapter and of every layer of the CP network.
        frames: length of the clip, before mirroring.
        epochs: epochs of few-shot training.
        timed_frames: frames of one character per repetition.
        crowd: batch size of the column `crowd`, whose time is per character.
        slices: slices of the lookup table.
        repetitions: measurements of the run times; training times, with compilation, are measured once.
    """

    out: Path
    num_joints: int = 31
    hidden: int = 512
    rank: int = 30
    frames: int = 300
    epochs: int = 100
    timed_frames: int = 300
    crowd: int = 256
    slices: int = 50
    repetitions: int = 9

    def network(self, rank: int | None = None) -> NetworkConfig:
        """Returns the sizes of the shared network, CP-decomposed in every layer if a rank is given."""
        return NetworkConfig(48 + 6 * self.num_joints, 28 + 12 * self.num_joints, self.hidden, rank=rank)


def memory(layers: Any, slices: int | None = None) -> float:
    """Returns mebibytes of float32 of the control points, or of a table that stores blended arrays for every slice."""
    total = 0
    for path, leaf in jax.tree_util.tree_leaves_with_path(layers):
        blended = getattr(path[-1], "name", None) in BLENDED
        total += slices * leaf[0].size if blended and slices is not None else leaf.size
    return 4 * total / MEBIBYTE


def training_seconds(config: Config) -> dict[str, float]:
    """Returns the seconds of training one style with the paper's settings, with compilation, by kind of adapter."""
    shared = init_network(config.network(), key=jax.random.key(0))
    data = random_frames((2 * config.frames,), config.network())
    few = jax.tree.map(lambda leaf: leaf[:32], data)
    settings = {
        kind: FewShotConfig(kind, config.rank, (1e-4,), (0.3,), (0.3,), eval_epochs=(config.epochs,)) for kind in KINDS
    }
    works: dict[str, Work] = {
        kind: lambda setting=setting: train_grid(shared, data, few, setting)[0].trained
        for kind, setting in settings.items()
    }
    seconds = interleave(works, 1, warm_up=False)
    return {kind: float(value[0]) for kind, value in seconds.items()}


def run_seconds(predictors: dict[str, Predictor], config: Config) -> dict[str, dict[str, np.ndarray]]:
    """Returns seconds per frame [n] of every network: `exact` and `lookup` for one character, `crowd` in a batch."""
    sizes = config.network()
    batch = random_frames((config.crowd,), sizes)
    works: dict[str, Work] = {}
    for name, predictor in predictors.items():
        table = make_lookup(predictor, config.slices)
        works[f"{name}/exact"] = walk(partial(jax.jit(evaluate), predictor), sizes, config.timed_frames)
        works[f"{name}/lookup"] = walk(partial(evaluate_lookup, table), sizes, config.timed_frames)
        crowd = jax.jit(jax.vmap(evaluate, in_axes=(None, 0, 0)))
        works[f"{name}/crowd"] = partial(crowd, predictor, jnp.asarray(batch.x), jnp.asarray(batch.phase))
    seconds = interleave(works, config.repetitions)
    counts = {"exact": config.timed_frames, "lookup": config.timed_frames, "crowd": config.crowd}
    return {name: {how: seconds[f"{name}/{how}"] / count for how, count in counts.items()} for name in predictors}


def measure(config: Config) -> dict[str, Any]:
    """Returns all rows of the table, and the ratios of size and time of the full and the CP network."""
    adapters = {kind: AdapterConfig(kind, config.rank) for kind in KINDS}
    predictors = {f"{kind} adapter": random_predictor(config.network(), adapters[kind]) for kind in KINDS}
    predictors["network, no adapter"] = random_predictor(config.network())
    predictors["CP network, no adapter"] = random_predictor(config.network(config.rank))
    times, training = run_seconds(predictors, config), training_seconds(config)
    rows = {}
    for name, predictor in predictors.items():
        measured = predictor.network if predictor.style is None else predictor.style
        rows[name] = {
            "control points, MB": memory(measured),
            "50 slices, MB": memory(measured, config.slices),
            "training, s": training.get(name.removesuffix(" adapter")),
            **{f"{how}, ms": 1e3 * float(np.median(value)) for how, value in times[name].items()},
        }
    full, decomposed = "network, no adapter", "CP network, no adapter"
    speedup = {how: float(np.median(times[full][how] / times[decomposed][how])) for how in times[full]}
    smaller = rows[full]["50 slices, MB"] / rows[decomposed]["50 slices, MB"]
    return {"rows": rows, "paper": PAPER, "cp_network": {"times smaller": smaller, "times faster": speedup}}


def main(config: Config) -> dict[str, Any]:
    """Measures and writes `table1_adapters.json` and `table1_adapters.md` into the folder `out`."""
    config.out.mkdir(parents=True, exist_ok=True)
    settings = {**asdict(config), "out": str(config.out)}
    result = {"config": settings, "machine": machine(), "versions": versions(), **measure(config)}
    rows = [[name, *(row[column] for column in COLUMNS)] for name, row in result["rows"].items()]
    rows += [[f"{kind} adapter, paper", *(PAPER[kind].get(column) for column in COLUMNS)] for kind in KINDS]
    write_whole(config.out / "table1_adapters.json", json.dumps(result, indent=1) + "\n")
    write_whole(config.out / "table1_adapters.md", markdown_table(("", *COLUMNS), rows))
    return result


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
