"""Do other data sets, put onto one skeleton, help a network to learn a style from a few seconds?

Question  `prepare A B C --skeleton` puts several data sets onto one skeleton. Does a network that is pretrained on more
          of them learn a held-out style of the first one better?
Data      Bandai-Namco-2, its held-out style left out, alone and with more and more data sets retargeted onto its
          skeleton: Bandai-Namco-1 (without styles of the held-out one's name), the walks of Xia et al. 2015, 100STYLE,
          and the eight procedural styles. Each network takes the same number of steps.
Measure   as in `leave_one_style_out`: adapted on at most 5 seconds of one straight walk, by few-shot's own grid; tested
          on all turning takes and the other straight walks of the held-out style. Errors are divided by the standard
          deviations of Bandai-Namco-2 alone, so that they can be compared.
Run       python -m experiments.added_data_sets --mocap FOLDER --out runs/added_data_sets
          FOLDER holds bandai-namco-1, bandai-namco-2, xia-test and 100style. Each fold is written when it is
          finished; run again with the same --out to resume.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from experiments.common.markdown import markdown_table
from experiments.common.style_takes import Take, load_takes
from experiments.leave_one_style_out import Config as Folds
from experiments.leave_one_style_out import make_fold, pretrained
from pfnn_jax.evaluation.style_methods import CONSERVATIVE_ROW, GRIDS, compare_methods
from pfnn_jax.io.files import write_whole
from pfnn_jax.motion.datasets.clip_rows import labelled_features, load_for_layout, match_skeleton
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.features.encode import Features, join_rows
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import fit_normaliser
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.synthetic.styles import PRETRAINING_STYLES
from pfnn_jax.motion.synthetic.walks import synthetic_clips

ADDED = ("bandai-namco-1", "xia-test", "100style", "procedural")
"""Data sets in the order in which they are added to Bandai-Namco-2."""

MIXES: dict[str, tuple[str, ...]] = {
    "Bandai-Namco-2 alone": (),
    "and Bandai-Namco-1": ADDED[:1],
    "and Xia walks, 100STYLE": ADDED[:3],
    "and procedural styles": ADDED,
}
"""What every network is pretrained on in addition to Bandai-Namco-2, by name."""

ROWS = ("no adapter", CONSERVATIVE_ROW, "CP, 1e-4, no dropout, 100 epochs")
"""Methods in the table."""


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        mocap: folder of the data sets.
        out: folder of results.
        styles: held-out styles of Bandai-Namco-2.
        steps, batch_size, learning_rate, hidden: of pretraining, the same for all mixes.
        seed: of networks, shuffling and the choice of the adaptation clip.
        procedural_seconds: of motion for each procedural style.
        takes: largest number of takes of each style and content of Bandai-Namco-2, 0 for all.
    """

    mocap: Path
    out: Path
    styles: tuple[str, ...] = ("elderly", "feminine", "youthful")
    steps: int = 2000
    batch_size: int = 128
    learning_rate: float = 1e-3
    hidden: int = 256
    seed: int = 0
    procedural_seconds: float = 45.0
    takes: int = 0

    def folds(self) -> Folds:
        """Returns the settings that `leave_one_style_out` needs."""
        return Folds(
            data=self.mocap / "bandai-namco-2",
            out=self.out,
            steps=self.steps,
            batch_size=self.batch_size,
            learning_rate=self.learning_rate,
            hidden=self.hidden,
            takes=self.takes,
        )


def added_rows(config: Config, layout: FrameLayout, skeleton: Skeleton) -> dict[str, dict[str, list[Features]]]:
    """Returns data set -> style -> rows of its clips and their mirror images on the skeleton."""
    found: dict[str, dict[str, list[Features]]] = {}
    for data_set in ADDED:
        styles = found.setdefault(data_set, {})
        for labelled in _labelled(config, data_set, layout):
            rows = labelled_features(match_skeleton(labelled, skeleton), layout, True)
            styles.setdefault(f"{data_set}_{labelled.clip.style.lower()}", []).extend(rows)
    return found


def _labelled(config: Config, data_set: str, layout: FrameLayout) -> Iterator[LabelledClip]:
    if data_set == "procedural":
        for number, style in enumerate(PRETRAINING_STYLES):
            yield from synthetic_clips(style, config.procedural_seconds, seed=config.seed + number)
        return
    for clip_file in list_clips(config.mocap / data_set):
        if data_set == "xia-test" and "_01_" not in clip_file.path.name:
            continue  # 01 is walking
        with suppress(NoGaitError):
            yield load_for_layout(clip_file, layout)


def training_rows(
    takes: Sequence[Take], added: Mapping[str, Mapping[str, list[Features]]], mix: Sequence[str], held_out: str
) -> dict[str, Features]:
    """Returns style -> rows of a mix, without the held-out style and added styles of its name."""
    own = {take.style for take in takes} - {held_out}
    rows = {style: [p for t in takes if t.style == style for p in (t.rows, t.mirrored)] for style in sorted(own)}
    for data_set in mix:
        rows |= {style: parts for style, parts in added[data_set].items() if not style.endswith(f"_{held_out}")}
    return {style: join_rows(parts) for style, parts in rows.items()}


def run_fold(takes, added, mix: str, held_out: str, layout, skeleton, config: Config) -> dict[str, Any]:
    """Returns the measures of one held-out style for a network of one mix."""
    started = time.perf_counter()
    alone, rows = (training_rows(takes, added, sets, held_out) for sets in ((), MIXES[mix]))
    std = fit_normaliser([p.x for p in alone.values()], [p.y for p in alone.values()], layout, True).outputs.std
    network = pretrained(rows, layout, config.folds(), config.seed)
    fold = make_fold(takes, held_out, config.seed, layout, skeleton, std, config.folds())
    grids = {"CP": GRIDS["CP"]}
    found = compare_methods(network.shared, network.normaliser, fold.clip, fold.test, grids=grids, seed=config.seed)
    return {
        "mix": mix,
        "style": held_out,
        "styles": len(rows),
        "frames": sum(len(part.x) for part in rows.values()),
        "pretrain_loss": network.loss,
        "seconds": time.perf_counter() - started,
        "rows": {name: found[name]["measures"] for name in ROWS},
    }


def summary(folds: Sequence[Mapping[str, Any]]) -> str:
    """Returns a Markdown table: for each mix and method the means over held-out styles, and every style's error."""
    styles = sorted({fold["style"] for fold in folds})
    head = ["pretrained on", "method", "straight", "turning", *styles, "nearest real turn, cm", "skating, cm/s"]
    table = []
    for mix in MIXES:
        own = {fold["style"]: fold["rows"] for fold in folds if fold["mix"] == mix}
        for method in ROWS if own else ():
            rows = [own[style][method] for style in own]
            turns = {style: own[style][method]["turning"]["pose_velocity"] for style in own}
            means = [np.mean([row[kind]["pose_velocity"] for row in rows]) for kind in ("straight", "turning")]
            cm = [100 * np.mean([row[name] for row in rows]) for name in ("nearest_turning_pose", "skating")]
            table.append([mix, method, *means, *(turns.get(style) for style in styles), *cm])
    return markdown_table(head, table)


def main(config: Config) -> None:
    """Runs the missing folds, and writes the table of all folds."""
    config.out.mkdir(parents=True, exist_ok=True)
    takes, layout, skeleton = load_takes(config.folds().data, config.takes)
    added = added_rows(config, layout, skeleton)
    for style in config.styles:
        for number, mix in enumerate(MIXES):
            file = config.out / f"fold_{style}_{number}.json"
            if not file.exists():
                fold = run_fold(takes, added, mix, style, layout, skeleton, config)
                write_whole(file, json.dumps(fold, indent=1))
                error = fold["rows"][CONSERVATIVE_ROW]["turning"]["pose_velocity"]
                print(f"{style}, {mix}: {error:.3f} on turns, {fold['seconds']:.0f} s", flush=True)
    folds = [json.loads(file.read_text()) for file in sorted(config.out.glob("fold_*.json"))]
    write_whole(config.out / "table.md", summary(folds))


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
