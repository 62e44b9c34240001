"""What do commands do on a disk that is full or read-only, in a folder that goes away, with a clock that jumps?

Question  Does every command that writes end with one line and code 2, leave nothing half-written, keep what was there,
          and succeed once there is room?
Data      two procedural styles, a dataset and a run of 8 hidden units, as in `experiments/kills.py`.
Method    each command runs in a folder that is a file system of its own (`tmpfs`, which the superuser may mount):
          - full: with room for a part of what the command writes when nothing hinders it; then again with enough;
          - read-only: mounted so, because the superuser is refused by no permission;
          - removed: the folder of the output is removed as soon as something appears in it;
          - clock: the time of day that Python returns jumps by 1,000 hours, back and forth, four times a second. A
            library that makes it jump for all of a process (libfaketime) is no use: it makes `time.sleep` fail.
Run       python -m experiments.disk_faults --out OUT (as the superuser, on Linux)
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import tyro

from experiments import kills
from experiments.common.page_work import check_styles, use_page
from pfnn_jax.io.files import write_json
from pfnn_jax.run_config import has_shared

PARTS = (0.02, 0.5, 0.9)
"""Of what a command writes, for which the full disk has room."""

TEMPORARY = (".new", ".copy")
"""Endings of names of what is being written."""

ENOUGH = "1g"
"""Size of a file system that is not full."""

JUMP = 1000
"""Hours by which the clock jumps."""

PROGRAM = "import sys; from experiments.disk_faults import act, jump; jump(); act(sys.argv[1:])"
"""A process whose clock jumps from its start."""


@dataclass(frozen=True)
class Config:
    """What is tried.

    Attributes:
        out: folder of the file systems and of `disk_faults.json`.
        only: names of commands; all by default.
        faults: which of full, read-only, removed and clock.
    """

    out: Path
    only: tuple[str, ...] = ()
    faults: tuple[str, ...] = ("full", "read-only", "removed", "clock")


class Command(NamedTuple):
    """A command that writes.

    Attributes:
        inputs: what it needs in its folder: `clips`, `data`, `run`, `old.safetensors`.
        words: of its command line, in a folder; `page` does what the page's buttons do.
        again: words to add when it is done again after it has failed.
    """

    inputs: tuple[str, ...]
    words: Callable[[Path], list[str | Path]]
    again: tuple[str, ...] = ()

    @property
    def writes_run(self) -> bool:
        """Whether it writes into the run that it is given, and not into a folder `new`."""
        return not any("new" in Path(word).parts for word in self.words(Path("at")))


TRAIN = ("--hidden", "8", "--steps", "60", "--batch-size", "16", "--steps-per-dispatch", "5", "--save-every", "5")
LEARN = ("--learning-rates", "1e-3", "--main-dropouts", "0.0", "--eval-epochs", "2", "--rank", "2")

COMMANDS = {
    "prepare": Command(("clips",), lambda at: ["prepare", at / "clips", "--out", at / "new" / "data"]),
    "pretrain": Command(
        ("data",), lambda at: ["pretrain", at / "data", "--out", at / "new" / "run", *TRAIN], ("--resume",)
    ),
    "few-shot": Command(
        ("run", "clips"),
        lambda at: ["few-shot", at / "run", at / "clips" / "old" / "walk.bvh", "--name", "learned", *LEARN],
    ),
    "generate": Command(("run",), lambda at: ["generate", at / "run", "--seconds", "2", "--out", at / "new" / "a.bvh"]),
    "export": Command(("run",), lambda at: ["export", at / "run", "--format", "bins", "--out", at / "new" / "export"]),
    "style export": Command(
        ("run",), lambda at: ["style", "export", at / "run", "old", "--out", at / "new" / "old.safetensors"]
    ),
    "style import": Command(
        ("run", "old.safetensors"),
        lambda at: ["style", "import", at / "run", at / "old.safetensors", "--name", "again"],
    ),
    "share": Command(("run",), lambda at: ["share", at / "run", "--out", at / "new" / "shared"]),
    "page": Command(("run", "clips"), lambda at: ["page", at]),
}


class Ended(NamedTuple):
    """The end of a command: its code, and the lines it has printed to standard error."""

    code: int
    errors: list[str]


def run_command(command: Command, at: Path, more: tuple[str, ...] = ()) -> Ended:
    """Runs a command, with more words, in a process that has imported everything already."""
    log = at.with_name("log")
    process = kills.context().Process(target=_act_quietly, args=([*map(str, command.words(at)), *more], log))
    process.start()
    process.join()
    return Ended(int(process.exitcode or 0), log.read_text().splitlines())


def _act_quietly(words: list[str], log: Path) -> None:
    os.dup2(os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    act(words)


def act(words: list[str]) -> None:
    """Does a command line, or what the page's buttons do (`page FOLDER`)."""
    from pfnn_jax.cli import main
    from pfnn_jax.errors import InputError

    if words[0] != "page":
        main(words)
        return
    try:
        use_page(Path(words[1]), kills.FEW_SHOT)
    except InputError as error:  # which the page shows
        print(f"pfnn-jax: {error}", file=sys.stderr)
        raise SystemExit(2) from None


@contextmanager
def file_system(at: Path) -> Iterator[None]:
    """Mounts a file system in memory at a folder for the block."""
    at.mkdir(exist_ok=True)
    mount("-t", "tmpfs", "-o", f"size={ENOUGH}", "tmpfs", at)
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(at)], check=True)


def mount(*words: str | Path) -> None:
    subprocess.run(["mount", *map(str, words)], check=True)


def used(at: Path) -> int:
    """Returns the bytes used of a file system."""
    found = os.statvfs(at)
    return (found.f_blocks - found.f_bfree) * found.f_frsize


def fill(command: Command, sources: Path, at: Path) -> None:
    """Copies what a command needs into its folder, and makes one for what it writes."""
    (at / "new").mkdir()
    for name in command.inputs:
        source = sources / name
        shutil.copytree(source, at / name) if source.is_dir() else shutil.copyfile(source, at / name)


def contents(at: Path, inputs: tuple[str, ...]) -> dict[str, str]:
    """Returns a digest of every file among the inputs, but for locks."""
    files = [path for name in inputs for path in (at / name, *sorted((at / name).rglob("*"))) if path.is_file()]
    return {str(path.relative_to(at)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def faults_of(ended: Ended, at: Path) -> list[str]:
    """Returns what is wrong with the end of a command, and with what it has left."""
    found, said = [], [line for line in ended.errors if line.startswith("pfnn-jax: ")]
    if ended.code not in (0, 2) or (ended.code == 2 and len(said) != 1):
        found.append(f"code {ended.code}: {ended.errors[-3:]}")
    if any("Traceback" in line for line in ended.errors):
        found.append("a traceback")
    if left := [path.name for path in at.rglob(".*") if path.name.endswith(TEMPORARY)]:
        found.append(f"left: {left[:3]}")
    for run in (at / "run", at / "new" / "run"):
        if (run / "config.json").exists() and (has_shared(run) or run.parent == at):
            check_styles(run)
    return found


def changes(before: dict[str, str], now: dict[str, str]) -> list[str]:
    """Returns what is wrong with the inputs: files that are gone or changed."""
    changed = [name for name, digest in before.items() if now.get(name) != digest]
    return [f"changed: {changed[:3]}"] if changed else []


def try_full(command: Command, sources: Path, at: Path, part: float) -> dict[str, Any]:
    """Runs a command with room for a part of what it writes, and then with enough."""
    with file_system(at):
        fill(command, sources, at)
        written = size_of(command, sources, at.with_name("free"))
        mount("-o", f"remount,size={used(at) + 4096 + int(part * written)}", at)
        before = contents(at, command.inputs)
        ended = run_command(command, at)
        found = faults_of(ended, at) + changes(before, contents(at, command.inputs))
        mount("-o", f"remount,size={ENOUGH}", at)
        again = Ended(0, [])
        if ended.code:
            again = run_command(command, at, command.again if (at / "new" / "run").exists() else ())
        if again.code:
            found.append(f"not with enough room either: {again.errors[-1:]}")
    return {"code": ended.code, "said": ended.errors[-1:], "faults": found}


@cache
def size_of(command: Command, sources: Path, at: Path) -> int:
    """Returns the bytes that a command writes where nothing hinders it."""
    with file_system(at):
        fill(command, sources, at)
        before = used(at)
        ended = run_command(command, at)
        if ended.code:
            raise RuntimeError(f"code {ended.code} without any fault: {ended.errors}")
        return used(at) - before


def try_read_only(command: Command, sources: Path, at: Path) -> dict[str, Any]:
    """Runs a command in a file system that cannot be written."""
    with file_system(at):
        fill(command, sources, at)
        mount("-o", "remount,ro", at)
        before = contents(at, command.inputs)
        ended = run_command(command, at)
        found = faults_of(ended, at) + changes(before, contents(at, command.inputs))
        if not ended.code:
            found.append("code 0 although nothing can be written")
    return {"code": ended.code, "said": ended.errors[-1:], "faults": found}


def try_removed(command: Command, sources: Path, at: Path) -> dict[str, Any]:
    """Runs a command whose folder of output is removed as soon as something appears in it."""
    with file_system(at):
        fill(command, sources, at)
        watched, stop = at / ("run" if command.writes_run else "new"), threading.Event()
        known, gone = set(watched.rglob("*")), at / "gone"

        def remove() -> None:
            while not stop.is_set():
                with suppress(OSError):  # what is renamed while it is listed
                    if watched.exists() and set(watched.rglob("*")) - known:
                        watched.rename(gone)  # at once: removing file by file would race with what is written
                        shutil.rmtree(gone, ignore_errors=True)
                        return
                time.sleep(0.002)

        thread = threading.Thread(target=remove)
        thread.start()
        ended = run_command(command, at)
        stop.set()
        thread.join()
        found = faults_of(ended, at)
        if watched.exists() and (ended.code or command.writes_run):
            found.append("the folder was made again")
    return {"code": ended.code, "said": ended.errors[-1:], "faults": found}


def jump() -> None:
    """Makes the time of day of this process jump, ahead and back."""
    real, nanoseconds = time.time, time.time_ns

    def ahead() -> float:
        return 3600.0 * JUMP * (-1) ** int(4.0 * time.monotonic())

    time.time = lambda: real() + ahead()
    time.time_ns = lambda: nanoseconds() + int(1e9 * ahead())


def try_clock(command: Command, sources: Path, at: Path) -> dict[str, Any]:
    """Runs a command whose clock jumps, in a process of its own."""
    with file_system(at):
        fill(command, sources, at)
        program = [sys.executable, "-c", PROGRAM, *map(str, command.words(at))]
        done = subprocess.run(program, capture_output=True, text=True)
        ended = Ended(done.returncode, done.stderr.splitlines())
        found = faults_of(ended, at)
        if ended.code:
            found.append(f"code {ended.code}: {ended.errors[-3:]}")
    return {"code": ended.code, "said": ended.errors[-1:], "faults": found}


def make_sources(folder: Path) -> None:
    """Writes clips, a dataset, a run and a shared style."""
    from pfnn_jax.workflows.share_style import export_style

    kills.make_sources(folder)
    export_style(folder / "run", "old", folder / "old.safetensors")


def main(config: Config) -> dict[str, Any]:
    """Tries every fault with every command, and returns the ends."""
    out = config.out.absolute()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    kills.keep_compiled(out / "compiled")
    kills.in_child(make_sources, out / "sources")
    results: dict[str, Any] = {}
    for name in config.only or tuple(COMMANDS):
        tries: dict[str, Callable[[Command, Path, Path], dict[str, Any]]] = {}
        if "full" in config.faults:
            tries |= {f"full, room for {part:.0%}": partial(try_full, part=part) for part in PARTS}
        if "read-only" in config.faults:
            tries["read-only"] = try_read_only
        if "removed" in config.faults:
            tries["removed"] = try_removed
        if "clock" in config.faults:
            tries["clock"] = try_clock
        for fault, attempt in tries.items():
            results[f"{name}, {fault}"] = found = attempt(COMMANDS[name], out / "sources", out / "place")
            print(f"{name}, {fault}: {json.dumps(found)}", flush=True)
            write_json(out / "disk_faults.json", results)
    print(f"{len(results)} tries, {sum(bool(found['faults']) for found in results.values())} with faults")
    return results


if __name__ == "__main__":
    from experiments import disk_faults  # as the processes import it

    disk_faults.main(tyro.cli(disk_faults.Config, description=__doc__))
