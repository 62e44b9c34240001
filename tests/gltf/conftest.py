"""The validator of glTF and three.js in a browser, which most engines' importers agree with."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.common.chromium import FLAGS

HERE = Path(__file__).parent
MODULES = HERE / "node_modules"
SITE = "http://gltf.test/"  # every request is answered from files by the tests themselves
TYPES = {".html": "text/html", ".mjs": "text/javascript", ".js": "text/javascript", ".glb": "model/gltf-binary"}


@pytest.fixture(scope="session")
def validate() -> Callable[[Sequence[Path]], dict[Path, set[tuple[str, str]]]]:
    """Returns the errors (code, pointer) that the validator of glTF finds in files, all in one process."""
    node = shutil.which("node")
    if node is None or not (MODULES / "gltf-validator").is_dir():
        pytest.skip("gltf-validator is not installed: npm ci in tests/gltf")

    def run(paths: Sequence[Path]) -> dict[Path, set[tuple[str, str]]]:
        names = "\n".join(map(str, paths))
        done = subprocess.run(
            [node, str(HERE / "validate.mjs")], input=names, capture_output=True, text=True, check=True
        )
        return {
            Path(path): {(issue["code"], issue["pointer"]) for issue in issues if issue["severity"] == 0}
            for path, issues in json.loads(done.stdout).items()
        }

    return run


class Three:
    """A page with three.js that opens GLB files."""

    def __init__(self, browser: Any) -> None:
        self._files: dict[str, Path] = {}
        self._page = browser.new_page()
        self.errors: list[str] = []
        self._page.on("pageerror", lambda error: self.errors.append(str(error)))
        self._page.route("**/*", self._answer)
        self._page.goto(SITE)
        self._page.wait_for_function("window.ready")

    def _answer(self, route: Any) -> None:
        name = route.request.url.removeprefix(SITE) or "page.html"
        path = self._files.get(name) or (MODULES / name if name.startswith("three/") else HERE / name)
        if path.is_file():
            kind = TYPES.get(path.suffix, "application/octet-stream")
            route.fulfill(body=path.read_bytes(), content_type=kind)
        else:
            route.abort()

    def _serve(self, path: Path) -> str:
        name = f"{len(self._files)}.glb"
        self._files[name] = path
        return name

    def sample(self, path: Path, clips: dict[str, np.ndarray], nodes: Sequence[int]) -> dict[str, np.ndarray]:
        """Returns where three.js puts nodes [T, n, 3] of a file at the times [T] of each of its clips."""
        asked = [[name, [float(time) for time in times]] for name, times in clips.items()]
        given = [self._serve(path), asked, [int(node) for node in nodes]]
        found = self._page.evaluate("given => window.sample(...given)", given)
        return {name: np.array(places) for name, places in zip(clips, found["positions"], strict=True)}

    def durations(self, path: Path) -> dict[str, float]:
        """Returns name and seconds of each clip of a file."""
        found = self._page.evaluate("given => window.sample(...given)", [self._serve(path), [], []])
        return dict(found["clips"])

    def draw(self, path: Path, clip: str, times: Sequence[float], size: tuple[int, int], **view: float) -> bytes:
        """Returns a PNG with one picture of the clip for each time."""
        given = [self._serve(path), clip, list(times), list(size), view.get("azimuth", 35.0), view.get("reach", 1.25)]
        self._page.evaluate("given => window.draw(...given)", given)
        return self._page.locator("#canvas").screenshot()


@pytest.fixture(scope="module")
def three() -> Iterator[Three]:
    """Three.js in headless Chromium, one page for a module: a process drives one browser at a time."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no chromium on PATH: three.js is tested in a browser")
    if not (MODULES / "three").is_dir():
        pytest.skip("three is not installed: npm ci in tests/gltf")
    with api.sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=chromium, args=list(FLAGS))
        page = Three(running)
        yield page
        running.close()
        assert not page.errors
