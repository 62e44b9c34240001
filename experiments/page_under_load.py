"""Does the page hold for an hour under many tabs, random input and nonsense?

Question  Many tabs do at random what people and broken programs can do: drive, choose styles, press buttons, type,
          rename, delete, upload, record, restyle, close in the middle, send values that no page sends, send garbage.
          Does the memory of the server stop growing? Are threads and files left when the tabs have closed? Does a
          traceback reach its terminal? Is a file written outside the run? Does it end at once, with code 0?
Data      a run of three procedural styles, trained here; uploads are the package's samples, and the files of folders
          that are given. With `--every-file` each of those is sent once more by a tab that waits for the answer.
Method    `pfnn-jax play` runs in a process with a home and folders of temporary files of its own. Tabs speak its
          protocol without a browser (`experiments/common/page_tab.py`): twenty browsers would draw in software on the
          same cores. Every ten seconds the memory of the server, its threads and its open files are noted, and what
          its memory holds: arrays, compiled programs, blocks of Python (`experiments/common/watched_page.py`).
Run       python -m experiments.page_under_load --out OUT --seconds 3600 [--uploads FOLDER ...] [--every-file]
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import shutil
import signal
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import psutil
import tyro
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from experiments.common.page_server import HELD, HOST, processor_time, serving
from experiments.common.page_tab import PageTab, complete, open_tab
from experiments.common.random_visitor import acts
from pfnn_jax.io.files import write_json
from pfnn_jax.workflows.samples import sample_clips

ENDING = 60.0
"""Seconds within which threads of closed tabs must have ended; what a tab was learning is learned to its end."""

PREPARING = 60.0
"""Seconds within which a server has compiled what learning needs, after its first tab."""

STALE = 60.0
"""Seconds after which what a server's memory holds is not taken for present: the thread that notes it has ended."""

ANSWERING = 300.0
"""Seconds within which an upload must be answered, on a busy machine."""

CHARACTERS = (".glb", ".gltf", ".vrm")

FAULTS = re.compile("Traceback|Error|FATAL|exception|terminate|Warning")
"""What must not stand in the server's output."""


@dataclass(frozen=True)
class Config:
    """How long, and with what.

    Attributes:
        out: folder of the run, of the server's home, and of the results.
        seconds: of random input.
        tabs: open at once.
        pause: mean seconds between two acts of a tab.
        life: mean seconds until a tab is closed and opened again.
        every: seconds between two measurements.
        uploads: folders whose files are uploaded at random.
        every_file: whether each of those files is sent once more, by a tab that waits for the answer.
        run: a run to serve a copy of; by default a small one is trained.
        seed: of what the tabs do; their order in time is the machine's.
    """

    out: Path
    seconds: float = 3600.0
    tabs: int = 20
    pause: float = 1.0
    life: float = 120.0
    every: float = 10.0
    uploads: tuple[Path, ...] = ()
    every_file: bool = False
    run: Path | None = None
    seed: int = 0


@dataclass
class Found:
    """What was done and seen.

    Attributes:
        acts: how often each thing was done.
        ends: how often tabs ended, and why.
        answers: of the uploads of every file: name, kind and text of the answer.
        moments: measurements of the server.
    """

    acts: Counter[str] = field(default_factory=Counter)
    ends: Counter[str] = field(default_factory=Counter)
    answers: list[dict[str, Any]] = field(default_factory=list)
    moments: list[dict[str, Any]] = field(default_factory=list)


def make_run(folder: Path) -> None:
    """Trains a small network of three styles."""
    from pfnn_jax.models.config import AdapterConfig
    from pfnn_jax.motion.datasets.preparation import prepare
    from pfnn_jax.motion.synthetic.walks import synthetic_clips
    from pfnn_jax.training.config import PretrainConfig
    from pfnn_jax.workflows.pretrain import pretrain_run

    clips = [clip for style in ("depressed", "neutral", "proud") for clip in synthetic_clips(style, 5)]
    settings = PretrainConfig(AdapterConfig("cp", 4), hidden=32, steps=100, batch_size=64, learning_rate=3e-3)
    pretrain_run(prepare(clips, folder.with_name("data")), folder, settings)


def measure(server: psutil.Process, began: float, out: Path) -> dict[str, Any]:
    """Returns seconds, memory in MiB, threads, open files and styles of the server, and what its memory holds."""
    with server.oneshot():
        memory = server.memory_full_info()
        moment = {
            "seconds": round(time.monotonic() - began, 1),
            "rss": round(memory.rss / 2**20, 1),
            "pss": round(getattr(memory, "pss", memory.rss) / 2**20, 1),
            "threads": server.num_threads(),
            "files": server.num_fds(),
            "processor": round(processor_time(server), 1),
            "styles": len(list((out / "run" / "styles").glob("[!.]*"))),
        }
    with contextlib.suppress(OSError):
        held = json.loads((out / HELD).read_text())
        if time.time() - held.pop("noted") < STALE:
            moment |= held
    return moment


async def visit(port: int, number: int, files: tuple[Path, ...], config: Config, until: float, found: Found) -> None:
    """Opens tabs, one after another, and does at random what can be done there."""
    random = Random(1000 * config.seed + number)
    offered = acts(files)
    names, shares = list(offered), [share for _, share in offered.values()]
    while time.monotonic() < until:
        ends = min(until, time.monotonic() + random.expovariate(1.0 / config.life))
        try:
            async with open_tab(HOST, port) as tab:
                await complete(tab)
                while time.monotonic() < ends:
                    name = random.choices(names, shares)[0]
                    with contextlib.suppress(KeyError, IndexError):  # a control that is not there
                        await offered[name][0](tab, random)
                        found.acts[name] += 1
                    await asyncio.sleep(random.expovariate(1.0 / config.pause))
                found.ends["closed"] += 1
        except ConnectionClosed as error:
            code = None if error.rcvd is None else error.rcvd.code
            found.ends[f"by the server, code {code}"] += 1
        except (OSError, InvalidHandshake, TimeoutError) as error:
            found.ends[type(error).__name__] += 1
            await asyncio.sleep(1.0)
        except Exception as error:  # of this program
            found.ends[f"fault: {type(error).__name__}: {error}"[:200]] += 1


async def send_every_file(port: int, files: tuple[Path, ...], until: float, found: Found) -> None:
    """Uploads each file, clips as content to restyle and characters to be worn, and notes the answer."""
    left = list(enumerate(files))
    while left and time.monotonic() < until:
        try:
            async with open_tab(HOST, port) as tab:
                await complete(tab)
                while left and time.monotonic() < until:
                    found.answers.append(await answer_to(tab, *left[0]))
                    left.pop(0)
        except Exception as error:
            found.ends[f"of every file: {type(error).__name__}: {error}"[:200]] += 1
            await asyncio.sleep(1.0)


async def answer_to(tab: PageTab, number: int, file: Path) -> dict[str, Any]:
    """Uploads a file, and returns what the page says of it."""
    label = "Wear a character" if file.suffix in CHARACTERS else "Upload the clip to restyle"
    before, new = tab.messages(), []
    await tab.upload(label, f"{number} {file.name}", file.read_bytes())

    def answered() -> bool:
        new[:] = [line for line in tab.messages() if line not in before and not line[1].startswith("Reading ")]
        return bool(new)

    done = await tab.until(answered, ANSWERING)
    kind, text = new[0] if done else ("none", "no answer")
    return {"file": file.name, "kind": kind, "text": text}


async def watch(server: psutil.Process, config: Config, until: float, began: float, found: Found) -> None:
    """Measures the server until a moment."""
    with (config.out / "moments.jsonl").open("a") as file:
        while time.monotonic() < until:
            found.moments.append(measure(server, began, config.out))
            file.write(json.dumps(found.moments[-1]) + "\n")
            file.flush()
            await asyncio.sleep(config.every)


async def load(server: psutil.Process, port: int, config: Config) -> Found:
    """Lets all tabs act at once."""
    found, began = Found(), time.monotonic()
    until = began + config.seconds
    folders = [path for folder in config.uploads for path in sorted(folder.rglob("*")) if path.is_file()]
    files = tuple(sample_clips().values()) + tuple(folders)
    tasks = [visit(port, number, files, config, until, found) for number in range(config.tabs)]
    if config.every_file:
        tasks.append(send_every_file(port, tuple(folders), until, found))
    await asyncio.gather(watch(server, config, until, began, found), *tasks)
    return found


async def settle(port: int) -> None:
    """Opens and closes a tab, so that what the first one of a server needs is there."""
    async with open_tab(HOST, port) as tab:
        await complete(tab)


def wait_until_idle(server: psutil.Process, threads: int, out: Path) -> dict[str, Any]:
    """Returns a measurement once no more threads are left than before, or after a while."""
    began = time.monotonic()
    while server.num_threads() > threads and time.monotonic() - began < ENDING:
        time.sleep(0.5)
    return measure(server, began, out)


def main(config: Config) -> dict[str, Any]:
    """Serves the page, lets the tabs act, and returns what was found."""
    out = config.out
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    if config.run is None:
        make_run(out / "run")
    else:
        shutil.copytree(config.run, out / "run")
    with serving([str(out / "run")], out, watched=True) as (server, port):
        asyncio.run(settle(port))
        time.sleep(PREPARING)
        before = measure(server, time.monotonic(), out)
        found = asyncio.run(load(server, port, config))
        after = wait_until_idle(server, before["threads"], out)
        server.send_signal(signal.SIGTERM)
        code = server.wait(timeout=ENDING)
    result = {
        "before": before,
        "after": after,
        "code": code,
        "acts": dict(found.acts),
        "ends": dict(found.ends),
        "growth": growth(found.moments),
        "answers": dict(Counter(answer["kind"] for answer in found.answers)),
        "log": [line for line in (out / "server.log").read_text().splitlines() if FAULTS.search(line)],
        "outside": outside(out),
    }
    write_json(out / "answers.json", {"answers": found.answers})
    write_json(out / "result.json", result)
    print(json.dumps(result, indent=1))
    return result


def growth(moments: list[dict[str, Any]]) -> dict[str, float]:
    """Returns by how much a minute everything grows in the second half, by least squares, and the largest memory."""
    late = moments[len(moments) // 2 :]
    if len(late) < 2:
        return {}
    minutes = np.array([moment["seconds"] for moment in late]) / 60.0
    names = [name for name in late[0] if name not in ("seconds", "processor") and all(name in one for one in late)]
    slopes = {name: float(np.polyfit(minutes, [moment[name] for moment in late], 1)[0]) for name in names}
    return {**slopes, "largest rss": max(moment["rss"] for moment in moments)}


def outside(out: Path) -> list[str]:
    """Returns the files that the server has left outside the run, apart from what its start keeps in the cache."""
    home = out / "home"
    files = (path.relative_to(home).as_posix() for path in home.rglob("*") if path.is_file())
    return sorted(file for file in files if not file.startswith("cache/pfnn_jax/"))


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
