"""A run that is trained in seconds, a page that serves it, and a browser that opens the page."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.common.chromium import FLAGS
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.synthetic.walks import synthesise, synthetic_clips
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.workflows.pretrain import pretrain_run

STYLES = ("depressed", "neutral", "proud")
TIMEOUT_SECONDS = 60.0  # seconds, for a browser that draws in software on a loaded machine
WINDOW = {"width": 760, "height": 440}  # small, because it is drawn in software


@pytest.fixture(scope="session")
def trained_run(tmp_path_factory) -> Path:
    """A small PFNN with three styles, which no test changes."""
    folder = tmp_path_factory.mktemp("trained")
    clips = [clip for style in STYLES for clip in synthetic_clips(style, 10)]
    dataset = prepare(clips, folder / "data", PrepareConfig(layout="mason2018"))
    settings = PretrainConfig(AdapterConfig("cp", 4), hidden=32, steps=200, batch_size=64, learning_rate=3e-3)
    return pretrain_run(dataset, folder / "run", settings).path


@pytest.fixture(scope="module")
def played_run(trained_run, tmp_path_factory) -> Path:
    """A copy of the run for the tests of one file, which may learn styles in it."""
    path = tmp_path_factory.mktemp("played") / "run"
    shutil.copytree(trained_run, path)
    return path


@pytest.fixture(scope="session")
def zombie_bvh(tmp_path_factory) -> Path:
    """A walk of 2.5 seconds in a style that the run was not trained on."""
    path = tmp_path_factory.mktemp("clips") / "zombie walk.bvh"
    write_bvh(path, synthesise("zombie", np.zeros(150), np.full(150, 0.9))[0])
    return path


@pytest.fixture(scope="session")
def second_run(trained_run, tmp_path_factory) -> Path:
    """A copy with two of the styles: another run for which nothing must be compiled."""
    path = tmp_path_factory.mktemp("second") / "two"
    shutil.copytree(trained_run, path)
    shutil.rmtree(path / "styles" / "depressed")
    return path


@pytest.fixture(scope="module")
def served(played_run, second_run) -> Iterator[Any]:
    """The page of both runs, on a free port."""
    pytest.importorskip("viser", reason="viser is not installed")
    from pfnn_jax.viewer.page.play import Page
    from pfnn_jax.viewer.page.run_library import RunLibrary

    library = RunLibrary([played_run, second_run])
    library.warm_up()
    with Page(library, port=0) as page:
        yield page


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium, closed at the end of the module because it keeps drawing. Skips if it is not installed."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no chromium on PATH: the tests of the page need a browser")
    with api.sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=chromium, args=list(FLAGS))
        yield running
        running.close()


class Visitor:
    """A user of a tab: reads the readouts, presses keys, clicks."""

    def __init__(self, browser: Any, url: str) -> None:
        self.errors: list[str] = []
        self._devtools: Any = None
        self._touched: dict[str, tuple[float, float]] = {}
        self.page = browser.new_page(viewport=WINDOW, accept_downloads=True)
        self.page.set_default_timeout(1e3 * TIMEOUT_SECONDS)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(url)
        self.page.wait_for_selector("[data-readout=style]")
        self.page.wait_for_selector("[data-value]", state="attached")

    def read(self, name: str) -> str:
        """Returns one line of the readout."""
        return self.page.locator(f"[data-readout={name}]").first.text_content()

    def numbers(self) -> np.ndarray:
        """Returns the root x and z in metres and the facing in degrees, which are under Details."""
        return np.array(self.page.locator("[data-value]").first.get_attribute("data-value").split(), float)

    def root(self) -> np.ndarray:
        """Returns the root [2] in metres."""
        return self.numbers()[:2]

    def wait(self, what: Callable[[], Any], message: str) -> None:
        """Waits until a condition holds."""
        end = time.monotonic() + TIMEOUT_SECONDS
        while not what():
            assert time.monotonic() < end, f"{message}: {self.page.locator('[data-readout]').all_inner_texts()}"
            self.page.wait_for_timeout(100)

    def walk(self, metres: float, keys: str = "w") -> None:
        """Holds keys until the root has moved this far."""
        start = self.root()
        for key in keys:
            self.page.keyboard.down(key)
        self.wait(lambda: np.linalg.norm(self.root() - start) > metres, f"{keys} moves the root {metres} m")
        for key in keys:
            self.page.keyboard.up(key)

    def touch(self, **fingers: tuple[float, float]) -> None:
        """Puts fingers on the screen, each at a point in pixels."""
        self._touched.update(fingers)
        self._send_touch("touchStart", self._touched)

    def lift(self, finger: str) -> None:
        """Lifts a finger."""
        self._send_touch("touchEnd", {finger: self._touched.pop(finger)})

    def _send_touch(self, kind: str, fingers: dict[str, tuple[float, float]]) -> None:
        if self._devtools is None:
            self._devtools = self.page.context.new_cdp_session(self.page)
        points = [{"id": ord(finger), "x": x, "y": y} for finger, (x, y) in fingers.items()]
        self._devtools.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    def press(self, label: str) -> None:
        """Clicks a button by its label."""
        self.page.get_by_role("button", name=label).first.click()

    def upload(self, label: str, path: Path) -> None:
        """Uploads a file with the button of a label."""
        with self.page.expect_file_chooser() as chooser:
            self.press(label)
        chooser.value.set_files(path)

    def field(self, label: str) -> Any:
        """Returns the input field of a label."""
        xpath = f"xpath=//label[normalize-space()='{label}']/ancestor::div[.//input][1]//input"
        return self.page.locator(xpath).first

    def choose(self, label: str, option: str) -> None:
        """Chooses an option of a list."""
        self.field(label).click()
        self.page.get_by_role("option", name=option, exact=True).first.click()

    def options(self, label: str) -> list[str]:
        """Returns the options of a list."""
        self.field(label).click()
        found = self.page.get_by_role("option")
        found.first.wait_for()
        names = found.all_inner_texts()
        self.page.keyboard.press("Escape")
        return names

    def close(self) -> None:
        """Closes the tab."""
        self.page.close()


@pytest.fixture(scope="module")
def visitor(browser, served) -> Iterator[Visitor]:
    """One tab that most tests share, because loading it takes long."""
    person = Visitor(browser, served.url)
    yield person
    person.close()


@pytest.fixture(scope="module")
def another_visitor(browser, served) -> Callable[[], Visitor]:
    """Opens one more tab."""
    return lambda: Visitor(browser, served.url)
