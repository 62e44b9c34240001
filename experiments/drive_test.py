"""How well do characters follow a recorded player, next to the published numbers of CAMDM, and where do they not?

Parent    Chen et al. 2024 (CAMDM): 55 seconds of stick and facing that every style of a controller is driven by, with a
          foot sliding of .685 and a trajectory error of 22.8 degrees. Mason 2018 §5.1 and Mason 2022 §4.4 measure no
          commands; the baseline is the loop of their demos.
Question  how do command tracking and foot locking compare with these numbers, and what are the errors made of: the sway
          of the hips, lag, or commands that a network cannot follow, such as side steps?
Data      CAMDM's `preset.txt` and the given runs; styles that a run was pretrained on, and those that it learned later,
          are reported apart. A stick of length 1 commands the natural speed of the style; its corners are no faster.
Measure   CAMDM's foot sliding and trajectory error by its own formulas, the latter also with the world turned by 90
          degrees, which should change nothing; the share of toes and frames that its sliding counts; sliding in
          contact; the mean absolute angle between commanded and walked heading, without the sway of the hips, without
          lag, in the second after a change of the commanded heading, and later, where the command is to walk ahead,
          sideways or backward. Two points that follow the commands exactly show what the formula itself adds.
Expect    see docs/results_appendix.md. 11 minutes of processor time for the 123 styles there.
Run       python -m experiments.drive_test --runs RUN [RUN ...] --preset preset.txt --out OUT
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from experiments.common.drive_test_report import cause_table, draw, summary_table
from pfnn_jax.control.controller import make_controller
from pfnn_jax.control.tracking import TrackingConfig
from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.drive_preset import PRESET_FPS, DrivePreset, preset_commands, read_preset
from pfnn_jax.evaluation.drive_test import Drive, drive, measure_drive, measure_headings
from pfnn_jax.io.files import write_json, write_whole
from pfnn_jax.run import Run, load_run
from pfnn_jax.run_config import list_styles
from pfnn_jax.viewer.draw.drawing import save_figure

CONTROLLERS = {
    "tracked, feet locked": (True, False),
    "tracked, feet free": (True, True),
    "published loop, feet free": (False, True),
}
"""Whether commands are tracked, and whether the toes are taken before they are locked."""

SWAY, SWAY_RATE = 0.025, 1.0
"""Metres and hertz by which the hips of a walking body move from side to side."""


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        runs: run directories.
        preset: file of commands.
        out: folder of results.
        styles: number of a run's styles, evenly spaced; 0 for all.
        chunk: characters simulated at once.
        tracking: constants of command tracking.
    """

    runs: tuple[Path, ...]
    preset: Path
    out: Path
    styles: int = 0
    chunk: int = 128
    tracking: TrackingConfig = TrackingConfig()


def main(config: Config) -> dict[str, Any]:
    """Runs the experiment; writes drive_test.json, drive_test.md and drive_test.png."""
    preset = read_preset(config.preset)
    if not config.runs:
        raise InputError(config.out, "runs", "none", "pass at least one run with --runs")
    rows, drives = [], []
    for path in config.runs:
        found, driven = drive_run(load_run(path), preset, config)
        rows += found
        drives.append(driven)
    result = {"points": ideal_points(preset), "rows": rows, "example": example_of(rows, drives[0])}
    config.out.mkdir(parents=True, exist_ok=True)
    write_json(config.out / "drive_test.json", result)
    report(result, preset, config.out)
    return result


def report(result: dict[str, Any], preset: DrivePreset, out: Path) -> None:
    """Writes the tables and the figure of the results in drive_test.json."""
    text = f"{summary_table(result)}\n{cause_table(result['rows'])}"
    write_whole(out / "drive_test.md", text)
    save_figure(draw(result, preset), out / "drive_test.png")
    print(text)


def drive_run(run: Run, preset: DrivePreset, config: Config) -> tuple[list[dict[str, Any]], dict[str, Drive]]:
    """Returns a row for each style and controller of a run, and the drives by controller."""
    names = _some(list_styles(run.path), config.styles)
    if not names:
        raise InputError(run.path, "styles", "none", "must have a style to be driven")
    rows, drives = [], {}
    for tracked in (True, False):
        controller = make_controller(run, names, tracking=config.tracking if tracked else None)
        driven, speeds = drive(controller, preset, config.chunk), np.asarray(controller.params.speeds)
        for kind in [kind for kind, (used, _) in CONTROLLERS.items() if used == tracked]:
            drives[kind] = driven
            for index, name in enumerate(names):
                one = jax.tree.map(lambda leaf, index=index: leaf[index], driven)
                row = {
                    "run": run.path.name,
                    "style": name,
                    "learned": name not in run.config.styles,
                    "controller": kind,
                    "fps": run.layout.fps,
                    "finite": bool(np.isfinite(one.hips).all() and np.isfinite(one.toes).all()),
                }
                arguments = preset, float(speeds[index]), run.layout.fps, CONTROLLERS[kind][1]
                rows.append(row | (measure_drive(one, *arguments) if row["finite"] else {}))
    return rows, drives


def _some(names: Sequence[str], count: int) -> list[str]:
    """Returns `count` of the names, evenly spaced; all of them for 0."""
    spread = np.linspace(0, len(names) - 1, count or len(names)).round().astype(int)
    return [names[int(index)] for index in np.unique(spread)]


def ideal_points(preset: DrivePreset) -> dict[str, dict[str, float]]:
    """Returns the angles of two points that follow a preset exactly, at 1 m/s: without and with the sway of hips."""
    velocity, direction = (values.astype(float) for values in preset_commands(preset, PRESET_FPS))
    root = np.concatenate([np.zeros((1, 2)), np.cumsum(velocity, axis=0)[:-1]]) / PRESET_FPS
    across = np.stack([velocity[:, 1], -velocity[:, 0]], -1)
    sway = SWAY * np.sin(2 * np.pi * SWAY_RATE * np.arange(len(root)) / PRESET_FPS)
    walks = {"a point that follows exactly": root, "the same, swaying as hips do": root + sway[:, None] * across}
    return {name: measure_headings(walk, direction, preset, PRESET_FPS) for name, walk in walks.items()}


def example_of(rows: Sequence[dict[str, Any]], drives: dict[str, Drive]) -> dict[str, Any]:
    """Returns the path of the style of the first run whose error with tracking is the median.

    Returns:
        `style`, its name, and `paths`, controller -> positions of the hips in metres, at the preset's rate.
    """
    own = [row for row in rows if row["run"] == rows[0]["run"] and row["controller"] == next(iter(CONTROLLERS))]
    order = np.argsort([row.get("error", np.inf) for row in own])
    index = int(order[(len(order) - 1) // 2])
    paths = {}
    for kind, driven in drives.items():
        hips = driven.hips[index, :: round(own[index]["fps"] / PRESET_FPS)]
        paths[kind.split(",")[0]] = hips[:, [0, 2]].round(4).tolist()
    return {"style": own[index]["style"], "paths": paths}


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
