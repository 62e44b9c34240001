"""How much does foot IK reduce the sliding of feet, and how does it affect bones and smoothness?

Parent    Mason 2022 §4.4: foot contact inverse kinematics after the network, to reduce sliding; no numbers.
Question  how much less do feet slide during the contacts predicted by the network, do they rest where the data's feet
          rest, and do accelerations and jitter increase?
Data      the given runs, whose styles walk along a figure-eight.
Expect    toes slide, before and after, in m/s: 0.209 and 0.012 (Bandai-Namco-2, PFNN with CP), 0.246 and 0.021 (base
          network), 0.372 and 0.058 (the authors' PFNN), 0.413 and 0.108 (their LPN, 8 styles). Planted toes are
          where the data's rest. Accelerations of toes fall by 4 to 12 %; those of knees rise by 9 to 27 %, jitter by 9
          to 16 %. Bones keep their lengths; in the networks' predictions they are wrong by 2 to 6 mm.
Run       python -m experiments.foot_ik --runs RUN [RUN ...] --out runs/foot_ik
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from experiments.common.markdown import markdown_table
from pfnn_jax.control.ik.fix_feet import fix_feet
from pfnn_jax.control.ik.pose import make_rig
from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.metrics import bone_length_error, contact_sliding, jitter
from pfnn_jax.io.files import write_json, write_whole
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.labels.contacts import foot_contacts
from pfnn_jax.motion.paths import figure_eight
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.run import Run, load_run
from pfnn_jax.run_config import list_styles
from pfnn_jax.workflows.generate import generate_walk

COLUMNS = {
    "toes": ("toes slide, m/s", 3),
    "heels": ("heels slide, m/s", 3),
    "held": ("planted toes, mm per frame", 2),
    "height": ("planted toes, cm", 2),
    "toe_acceleration": ("toes, m/s²", 1),
    "knee_acceleration": ("knees, m/s²", 1),
    "jitter": ("jitter, m/s³", 0),
    "bones": ("bones, mm", 2),
}


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        runs: run directories.
        out: folder of results.
        styles: styles to use where a run has them; all styles by default.
        most: largest number of styles per run, evenly spaced over its list.
        seconds: length of each walk; the first second is not evaluated.
    """

    runs: tuple[Path, ...]
    out: Path
    styles: tuple[str, ...] = ()
    most: int = 8
    seconds: float = 12.0


def main(config: Config) -> dict[str, Any]:
    """Runs the experiment; writes foot_ik.json and foot_ik.md."""
    rows = []
    for path in config.runs:
        run = load_run(path)
        for style in _styles(run, config):
            found = compare(run, style, config.seconds)
            rows.append({"run": path.name, "style": style or "(none)", **found})
    if not rows:
        raise InputError(config.out, "runs", "none", "pass at least one run with --runs")
    config.out.mkdir(parents=True, exist_ok=True)
    write_json(config.out / "foot_ik.json", {"rows": rows})
    text = _table(rows)
    write_whole(config.out / "foot_ik.md", text)
    print(text)
    return {"rows": rows}


def compare(run: Run, style: str | None, seconds: float) -> dict[str, dict[str, float]]:
    """Returns the measures of one walk: `network` (joints as predicted), `before` (rigid bones) and `after` foot IK."""
    made = generate_walk(run, style, figure_eight(), seconds=seconds, foot_ik=False, published_loop=True)
    contacts = made.contacts
    if contacts is None:
        contacts = foot_contacts(_joints(made.clip), need_roles(run.skeleton), run.layout.fps).astype(float)
    fixed = fix_feet(made.clip, contacts)
    walks = {"network": made.joints, "before": _joints(made.clip), "after": _joints(fixed)}
    return {name: measures(run, positions, contacts) for name, positions in walks.items()}


def measures(run: Run, positions: np.ndarray, contacts: np.ndarray) -> dict[str, float]:
    """Returns the measures of `COLUMNS` for joints [T, J, 3] in metres with contacts [T, 4]."""
    fps, skip, rig = run.layout.fps, round(run.layout.fps), make_rig(run.skeleton)
    positions, touching = positions[skip:], contacts[skip:] >= 0.5
    feet, toes, heels = positions[:, list(rig.feet)], [1, 3], [0, 2]
    lengths = np.linalg.norm(run.skeleton.offsets, axis=-1)
    return {
        "toes": contact_sliding(feet[:, toes], touching[:, toes], fps),
        "heels": contact_sliding(feet[:, heels], touching[:, heels], fps),
        "held": 1000.0 * _middle_steps(feet[:, toes], touching[:, toes]),
        "height": 100.0 * _middle_height(feet[:, toes, 1], touching[:, toes], round(fps / 10)),
        "toe_acceleration": _acceleration(feet[:, toes], fps),
        "knee_acceleration": _acceleration(positions[:, [leg[1] for leg in rig.legs]], fps),
        "jitter": jitter(positions, fps),
        "bones": 1000.0 * bone_length_error(positions, run.skeleton.parents, lengths),
    }


def _middle_steps(toes: np.ndarray, touching: np.ndarray) -> float:
    """Returns a toe's median displacement on the ground in metres between adjacent frames in contact, typical of
    mid-stance."""
    both = touching[1:] & touching[:-1]
    steps = np.linalg.norm(np.diff(toes[..., [0, 2]], axis=0), axis=-1)[both]
    return float(np.median(steps)) if len(steps) else float("nan")


def _middle_height(heights: np.ndarray, touching: np.ndarray, frames: int) -> float:
    """Returns the median height in metres of toes that have been in contact for a number of frames, and stay for as
    many: a foot comes down, rolls, and lifts at both ends of a contact."""
    windows = np.lib.stride_tricks.sliding_window_view(touching, 2 * frames + 1, axis=0).all(axis=-1)
    planted = heights[frames:-frames][windows]
    return float(np.median(planted)) if len(planted) else float("nan")


def _acceleration(points: np.ndarray, fps: float) -> float:
    return float(np.linalg.norm(np.diff(points, n=2, axis=0), axis=-1).mean() * fps**2)


def _joints(clip: MotionClip) -> np.ndarray:
    return forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0]


def _styles(run: Run, config: Config) -> list[str | None]:
    names = list(list_styles(run.path))
    chosen = [name for name in names if name in config.styles] if config.styles else names
    if not names:
        return [None]
    spread = np.unique(np.linspace(0, len(chosen) - 1, min(config.most, len(chosen))).round().astype(int))
    return [chosen[i] for i in spread] if chosen else []


def _table(rows: list[dict[str, Any]]) -> str:
    lines = []
    for run in dict.fromkeys(row["run"] for row in rows):
        own = [row for row in rows if row["run"] == run]
        for kind in ("network", "before", "after"):
            means = {key: np.nanmean([row[kind][key] for row in own]) for key in COLUMNS}
            numbers = [f"{means[key]:.{digits}f}" for key, (_, digits) in COLUMNS.items()]
            lines.append([f"{run} ({len(own)})" if kind == "network" else "", kind, *numbers])
    return markdown_table(["run (styles)", "walk", *(title for title, _ in COLUMNS.values())], lines)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
