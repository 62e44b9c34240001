"""How long does a person wait for the page: until a character walks, and until an uploaded style does?

Question  How many seconds pass from the command until a character can be driven and moves, in a tab of the protocol
          and in a browser that draws? From sending a clip until the tab's character has changed to its style, when the
          clip is sent at once, or some seconds later? With nothing kept from earlier starts, and with everything?
Data      the base network, and clips of the package.
Method    every measurement is a start of its own, `pfnn-jax play` in a process with its own home. Cold: the home is
          empty. Warm: its last start prepared all that learning needs. Medians over the repetitions.
Run       python -m experiments.page_times --out OUT, on an idle machine, with Chromium for the browser's rows
"""

from __future__ import annotations

import asyncio
import math
import re
import shutil
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import tyro

from experiments.common.chromium import FLAGS
from experiments.common.page_server import HOST, LOADED, OPEN, processor_time, serving
from experiments.common.page_tab import PageTab, complete, open_tab
from experiments.common.random_visitor import STYLE
from experiments.common.results_files import write_results
from pfnn_jax.workflows.samples import sample_clips

PREPARING = 60.0
"""Seconds for which a start is left alone to prepare learning, so that the next one is warm."""

ANSWERING = 300.0
"""Seconds within which a clip must be learned."""

MOVED = 0.05
"""Metres from where it stood at which a character counts as walking."""


@dataclass(frozen=True)
class Config:
    """What is measured.

    Attributes:
        out: folder of homes and results.
        delays: seconds after the page says that characters can walk, at which a clip is sent.
        repeats: starts for each row.
        clip: sample of the package that is sent.
        browser: whether Chromium is timed too.
    """

    out: Path
    delays: tuple[float, ...] = (0.0, 3.0, 6.0, 30.0)
    repeats: int = 3
    clip: str = "ape"
    browser: bool = True


def place(tab: PageTab) -> tuple[float, float] | None:
    """Returns where a tab's character is, in metres, once it is shown."""
    for control in tab.controls.values():
        found = re.search(r'data-value="(\S+) (\S+) ', str(control.props.get("content", "")))
        if found:
            return float(found[1]), float(found[2])
    return None


async def walk(port: int) -> None:
    """Opens a tab, holds W, and returns once its character has moved."""
    async with open_tab(HOST, port) as tab:
        await complete(tab)
        number = 0

        def moved() -> bool:
            now = place(tab)  # a character begins at the origin
            return now is not None and math.hypot(*now) > MOVED

        async with asyncio.timeout(ANSWERING):
            while not moved():
                number += 1
                await tab.drive(number, (1.0, 0.0, 0.0))
                await tab.until(moved, 0.2)


async def learn(port: int, name: str, delay: float) -> float:
    """Opens a tab, sends a clip after a delay, and returns the seconds until its character has the new style."""
    opened = time.monotonic()
    async with open_tab(HOST, port) as tab:
        await complete(tab)
        await asyncio.sleep(max(0.0, delay - (time.monotonic() - opened)))
        data, sent = sample_clips()[name].read_bytes(), time.monotonic()
        await tab.upload("Upload a clip", f"{name}.bvh", data)
        styles = tab.find(STYLE, "Dropdown")
        if not await tab.until(lambda: str(styles.value).startswith(name), ANSWERING):
            raise RuntimeError(f"{name} was not learned: {tab.messages()}")
        return time.monotonic() - sent


def walk_in_browser(port: int) -> None:
    """Opens the page in Chromium, holds W, and returns once the character that it draws has moved."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as api:
        browser = api.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
        page = browser.new_page(viewport={"width": 760, "height": 440})
        page.goto(f"http://{HOST}:{port}")
        page.wait_for_selector("[data-value]", state="attached", timeout=1e3 * ANSWERING)
        page.keyboard.down("w")
        page.wait_for_function(
            f"() => {{const [x, z] = document.querySelector('[data-value]').dataset.value.split(' ').map(Number);"
            f" return Math.hypot(x, z) > {MOVED}}}",
            timeout=1e3 * ANSWERING,
        )
        browser.close()


def timed_start(kept: Path | None, visit: Callable[[int], Any], until: str, fresh: Path) -> dict[str, float]:
    """Starts the page, visits it, and returns seconds of the clock and of the server's processor until then.

    Args:
        kept: home to begin with a copy of; None for an empty one.
        visit: called with the port.
        until: line of the page after which it is visited.
        fresh: folder of the home.
    """
    make_home(kept, fresh)
    began = time.monotonic()
    with serving([], fresh, until) as (server, port):
        visit(port)
        return {"seconds": time.monotonic() - began, "processor": processor_time(server)}


def timed_learning(kept: Path | None, name: str, delay: float, fresh: Path) -> dict[str, float]:
    """Starts the page, sends a clip after a delay, and returns the seconds that learning took; see `timed_start`."""
    make_home(kept, fresh)
    with serving([], fresh) as (server, port):
        before = processor_time(server)
        seconds = asyncio.run(learn(port, name, delay))
        return {"seconds": seconds, "processor": processor_time(server) - before}


def make_home(kept: Path | None, fresh: Path) -> None:
    """Makes the folder of a home: empty, or a copy."""
    if kept is None:
        fresh.mkdir(parents=True)
    else:
        shutil.copytree(kept, fresh)


def prepare_home(here: Path, kept: Path) -> None:
    """Makes a home whose start had the time to prepare all that learning needs, and learned one style."""
    here.mkdir(parents=True)
    with serving([], here) as (_, port):
        time.sleep(PREPARING)
        asyncio.run(learn(port, "soldier", 0.0))
    shutil.rmtree(here / "home" / "data", ignore_errors=True)  # the copy of the base network, with that style
    here.rename(kept)


def rows(config: Config, warm: Path) -> dict[str, Callable[[Path], dict[str, float]]]:
    """Returns what is measured: name -> function of a folder for the home."""
    found: dict[str, Callable[[Path], dict[str, float]]] = {}
    for state, kept in (("cold", None), ("warm", warm)):
        found[f"walks, {state}"] = partial(timed_start, kept, lambda port: asyncio.run(walk(port)), LOADED)
        if config.browser:
            found[f"walks in Chromium, {state}"] = partial(timed_start, kept, walk_in_browser, OPEN)
        for delay in config.delays:
            sent = f"learned, sent after {delay:g} s, {state}"
            found[sent] = partial(timed_learning, kept, config.clip, delay)
    return found


def main(config: Config) -> dict[str, Any]:
    """Measures every row in turn, several times, and writes medians."""
    shutil.rmtree(config.out, ignore_errors=True)
    measured: dict[str, list[dict[str, float]]] = {}
    here, warm = config.out / "here", config.out / "warm"  # one path, because JAX finds compiled code by it
    prepare_home(here, warm)
    for _ in range(config.repeats):
        for name, measure in rows(config, warm).items():
            measured.setdefault(name, []).append(measure(here))
            shutil.rmtree(here)
            print(f"{name}: {measured[name][-1]}", flush=True)
    return write_results(config, table(measured), measured=measured)


def table(measured: dict[str, list[dict[str, float]]]) -> str:
    """Returns medians, and the least and the largest value."""
    lines = ["| what | seconds, median | least to most | processor seconds |", "| --- | --- | --- | --- |"]
    for name, found in measured.items():
        seconds = [one["seconds"] for one in found]
        computed = statistics.median(one["processor"] for one in found)
        spread = f"{min(seconds):.1f} to {max(seconds):.1f}"
        lines.append(f"| {name} | {statistics.median(seconds):.1f} | {spread} | {computed:.1f} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    config = tyro.cli(Config, description=__doc__)
    main(replace(config, out=config.out.resolve()))
