"""Does a kill lose anything? Kills commands at random moments, and lets the next process go on.

Question  `prepare`, `pretrain`, `few-shot`, the page and a save are killed with SIGKILL at any moment: does every
          complete save load, and does what is done again end bit for bit as without a kill?
Data      two procedural styles of two seconds and a network of 8 hidden units.
Method    a process works; half of the kills come at a random moment of its usual time, half in the milliseconds after
          a temporary file has appeared, that is in the middle of a save. After each kill another process loads all that
          is there, and a third goes on with the work, until one of them is not killed. Its result is compared.
Run       python -m experiments.kills --out runs/kills --kills 100
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import jax
import numpy as np
import tyro

from experiments.common.page_work import check_styles, contents, use_page
from pfnn_jax.io.checkpoint import fingerprint, load_record, save_record
from pfnn_jax.io.files import locate, write_json
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.datasets.dataset import load_dataset
from pfnn_jax.motion.datasets.preparation import prepare
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.run import load_run, load_style, load_train_state
from pfnn_jax.run_config import has_shared, list_styles, load_config
from pfnn_jax.training.config import FewShotConfig, PretrainConfig
from pfnn_jax.training.log import read_metrics
from pfnn_jax.training.pretraining import init_state
from pfnn_jax.workflows.learn import learn_style
from pfnn_jax.workflows.pretrain import pretrain_run

TRAINING = PretrainConfig(
    adapter=AdapterConfig(rank=2), hidden=8, steps=60, batch_size=16, steps_per_dispatch=5, save_every=5
)
FEW_SHOT = FewShotConfig(rank=2, learning_rates=(1e-3,), main_dropouts=(0.0,), eval_epochs=(2,))

SAVES = 40
"""Saves of one process, one after another."""

LONGEST = 600.0
"""Seconds after which a process that should end is given up."""


@dataclass(frozen=True)
class Config:
    """How often is killed.

    Attributes:
        out: folder of the work and of `kills.json`.
        kills: in all.
        seconds: after which no further kill is begun.
        seed: of the moments.
        only: names of the works; all by default.
    """

    out: Path
    kills: int = 100
    seconds: float = 3600.0
    seed: int = 0
    only: tuple[str, ...] = ()


class Work(NamedTuple):
    """What is killed.

    Attributes:
        begin: fills a fresh folder with what the work needs, from the folder of sources.
        do: does the work in the folder, from its beginning or from where a killed process has left it.
        check: raises unless all that is complete can be loaded.
        digest: returns a digest of the result.
    """

    begin: Callable[[Path, Path], None]
    do: Callable[[Path], None]
    check: Callable[[Path], None]
    digest: Callable[[Path], str]


def make_clips(folder: Path) -> None:
    """Writes a clip of each of two styles."""
    for style in ("neutral", "old"):
        (folder / "clips" / style).mkdir(parents=True)
        clip = synthesise(style, np.zeros(120), np.full(120, 1.0), seed=1)[0]
        write_bvh(folder / "clips" / style / "walk.bvh", clip)


def make_sources(folder: Path) -> None:
    """Writes clips, a dataset and a trained run, on which the works build."""
    make_clips(folder)
    prepare(folder / "clips", folder / "data")
    pretrain_run(folder / "data", folder / "run", TRAINING)


def link(source: str) -> Callable[[Path, Path], None]:
    """Returns a function that puts a link to one of the sources into a fresh folder."""
    return lambda sources, folder: (folder / source).symlink_to(sources.absolute() / source)


def do_prepare(folder: Path) -> None:
    if locate(folder / "data") is None:
        prepare(folder / "clips", folder / "data", workers=1)


def check_prepare(folder: Path) -> None:
    if locate(folder / "data") is not None:
        digest_prepare(folder)


def digest_prepare(folder: Path) -> str:
    data = load_dataset(locate(folder / "data") or folder)
    return digest(
        [*(array for style in data.styles for array in data.arrays(style)), *vars(data.normaliser.inputs).values()]
    )


def do_pretrain(folder: Path) -> None:
    pretrain_run(folder / "data", folder / "run", TRAINING, resume=locate(folder / "run") is not None)


def check_run(folder: Path) -> None:
    run = folder / "run"
    if locate(run) is None:
        return
    config = load_config(run)
    data = load_dataset(folder / "data") if (folder / "data").exists() else None
    if data is not None:
        load_train_state(run, jax.eval_shape(lambda: init_state(TRAINING, data.layout, len(config.styles))))
    read_metrics(run)
    if has_shared(run):
        digest_run(folder)


def digest_run(folder: Path) -> str:
    run = load_run(folder / "run")
    styles = {name: fingerprint(load_style(run, name)) for name in list_styles(run.path)}
    losses = [record["loss"] for record in read_metrics(run.path)]
    return digest([run.fingerprint, styles, losses])


def begin_few_shot(sources: Path, folder: Path) -> None:
    link("clips")(sources, folder)
    shutil.copytree(sources / "run", folder / "run")


def do_few_shot(folder: Path) -> None:
    learn_style(folder / "run", folder / "clips" / "old" / "walk.bvh", FEW_SHOT, overwrite=True)


def do_page(folder: Path) -> None:
    use_page(folder, FEW_SHOT)


def check_page(folder: Path) -> None:
    check_styles(folder / "run")


def digest_page(folder: Path) -> str:
    return digest(contents(folder / "run"))


def do_saves(folder: Path) -> None:
    for step in range(SAVES):
        save_record(folder / "state", saved(step), "note.json", {"step": step})


def check_saves(folder: Path) -> None:
    if locate(folder / "state") is not None:
        found = load_record(folder / "state", saved(0))
        assert (np.asarray(found["a"]) == int(found["step"])).all(), "half of one save, half of another"


def saved(step: int) -> dict[str, Any]:
    return {"a": np.full((64, 64), step, np.int32), "step": np.array(step, np.int32)}


def digest_saves(folder: Path) -> str:
    check_saves(folder)
    return digest([np.asarray(load_record(folder / "state", saved(0))["a"])])


def digest(parts: list[Any]) -> str:
    """Returns a digest of arrays and plain values."""
    found = hashlib.sha256()
    for part in parts:
        found.update(np.ascontiguousarray(part).tobytes() if isinstance(part, np.ndarray) else repr(part).encode())
    return found.hexdigest()


WORKS = {
    "prepare": Work(link("clips"), do_prepare, check_prepare, digest_prepare),
    "pretrain": Work(link("data"), do_pretrain, check_run, digest_run),
    "few-shot": Work(begin_few_shot, do_few_shot, check_run, digest_run),
    "page": Work(begin_few_shot, do_page, check_page, digest_page),
    "save": Work(lambda sources, folder: None, do_saves, check_saves, digest_saves),
}


def main(config: Config) -> dict[str, Any]:
    """Kills, and returns for each work how often, how often in the middle of a save, and how many were lost."""
    out, random, began = config.out, Random(config.seed), time.monotonic()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    keep_compiled(out / "compiled")
    in_child(make_sources, out / "sources")
    names = config.only or tuple(WORKS)
    usual = {name: undisturbed(name, out) for name in names}
    counts = {name: {"kills": 0, "aimed": 0, "finished": 0, "faults": 0} for name in names}
    while sum(count["kills"] for count in counts.values()) < config.kills:
        if time.monotonic() - began > config.seconds:
            break
        name = min(names, key=lambda name: counts[name]["kills"])
        disturbed(name, out, usual[name], counts[name], random)
        write_json(out / "kills.json", counts)
    print(json.dumps(counts, indent=1))
    return counts


class Usual(NamedTuple):
    """A work that nobody kills: its seconds, how many temporary files appear, and the digest of its result."""

    seconds: float
    appearances: int
    digest: str


def undisturbed(name: str, out: Path) -> Usual:
    """Does a work without a kill; twice, because the first one compiles."""
    work = WORKS[name]
    in_child(work.do, fresh(name, out))
    folder, started = fresh(name, out), time.monotonic()
    process = context().Process(target=work.do, args=(folder,))
    process.start()
    appearances = await_temporaries(process, folder, None)
    process.join()
    return Usual(time.monotonic() - started, appearances, in_child(work.digest, folder))


def disturbed(name: str, out: Path, usual: Usual, count: dict[str, int], random: Random) -> None:
    """Kills a work once or several times, until it ends; counts what went wrong, and says it."""
    folder, work, killed = fresh(name, out), WORKS[name], 0
    try:
        while killed < 4:
            aimed = random.random() < 0.5
            if not killed_at(work.do, folder, usual, aimed, random):
                break
            killed += 1
            count["kills"] += 1
            count["aimed"] += aimed
            in_child(work.check, folder)
        in_child(work.do, folder)
        found = in_child(work.digest, folder)
        assert found == usual.digest, "the result differs from the undisturbed one"
        left = {name for name in temporaries(folder) if name.endswith(".new")}
        assert not left, f"temporary files are left: {left}"
        count["finished"] += 1
    except (RuntimeError, AssertionError) as error:
        count["faults"] += 1
        print(f"{name}: {error}", flush=True)
        shutil.copytree(folder, out / f"fault_{name}_{count['kills']}", symlinks=True)


def killed_at(do: Callable[[Path], None], folder: Path, usual: Usual, aimed: bool, random: Random) -> bool:
    """Starts a work in a process and kills it; returns whether it was still at work.

    Args:
        do: the work.
        folder: in which it works.
        usual: how it goes without a kill.
        aimed: kill it in the milliseconds after a temporary file has appeared, not at any moment.
        random: draws the moment.
    """
    process = context().Process(target=do, args=(folder,))
    process.start()
    if aimed:
        await_temporaries(process, folder, random.randint(1, max(usual.appearances, 1)))
        time.sleep(random.uniform(0.0, 0.02))
    else:
        process.join(random.uniform(0.0, usual.seconds))
    working = process.is_alive()
    process.kill()
    process.join()
    return working


def await_temporaries(process: Any, folder: Path, wanted: int | None) -> int:
    """Waits until so many temporary files have appeared, or the process has ended; returns how many were seen."""
    seen = 0
    while process.is_alive() and seen != wanted:
        before = temporaries(folder)
        time.sleep(0.001)
        seen += bool(temporaries(folder) - before)
    return seen


def temporaries(folder: Path) -> set[str]:
    """Returns the temporary files and folders below a folder; what disappears meanwhile is passed over."""
    entries = (name for _, folders, files in os.walk(folder) for name in (*folders, *files))
    return {name for name in entries if name.endswith((".new", ".old"))}


def fresh(name: str, out: Path) -> Path:
    folder = out / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    WORKS[name].begin(out / "sources", folder)
    return folder


def in_child(function: Callable[[Path], Any], folder: Path) -> Any:
    """Returns the result of a function in a process of its own: this one never starts JAX.

    Raises:
        RuntimeError: if it raises.
    """
    receiver, sender = context().Pipe(duplex=False)
    process = context().Process(target=_send, args=(sender, function, folder))
    process.start()
    sender.close()
    try:
        ok, value = receiver.recv() if receiver.poll(LONGEST) else (False, "does not end")
    except EOFError:
        ok, value = False, "ends without a result"
    process.kill() if value == "does not end" else process.join()
    process.join()
    if not ok:
        raise RuntimeError(value)
    return value


def _send(sender: Any, function: Callable[[Path], Any], folder: Path) -> None:
    try:
        sender.send((True, function(folder)))
    except Exception as error:
        sender.send((False, f"{type(error).__name__}: {error}"))


def keep_compiled(folder: Path) -> None:
    """Lets all processes share what they compile, so that a kill costs seconds."""
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder.absolute())
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"


@cache
def context() -> Any:
    """Returns what forks processes, from one that has imported everything and started nothing; POSIX alone has it."""
    found = multiprocessing.get_context("forkserver")
    found.set_forkserver_preload(["experiments.kills"])
    return found


if __name__ == "__main__":
    from experiments import kills  # as the processes import it

    kills.main(tyro.cli(kills.Config, description=__doc__))
