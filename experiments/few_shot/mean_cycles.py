"""How much of a turn does a straight walk not show?

Question  how far apart, in cm, are the mean gait cycles of the adaptation clip, of the style's other straight walks, of
          the straight parts of its turning takes and of its turns? How near does the clip's cycle come to that of the
          turns with the mean difference of the known styles added, as it is and scaled by the walking speed?
Method    Fourier series of joint positions in the gait phase, on left turns, mirror images included; mean over the
          phase and over the joints of trunk, arms and legs. No network is involved.
Verdict   (active, elderly, feminine, normal; one minute) clip to turns 3.5 cm: trunk 2.0, arms 3.1, legs 4.9. 1.6 of
          them lie between the clip and the straight parts of the turning takes, which were recorded later: mostly arms.
          With the known styles' mean difference 2.4 cm, scaled by speed 2.2 (elderly 1.9 instead of 2.5): legs 2.0,
          arms 2.9. Known styles tell how legs turn and nothing about arms; a clip does not tell how the actor holds
          them in another take. (exhausted, masculine, youthful, after the choice) clip to turns 4.3 cm, 2.6 of them to
          the straight parts; with the mean difference 3.7, 3.7 and 2.0 cm.
Run       python -m experiments.few_shot.mean_cycles --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import tyro

from experiments.common.markdown import markdown_table
from experiments.common.style_takes import rows_of
from experiments.common.turning_folds import Fold, FoldConfig, TurningFolds
from pfnn_jax.evaluation.actor_test import by_part
from pfnn_jax.evaluation.style_test import is_turning
from pfnn_jax.io.files import write_whole
from pfnn_jax.motion.features.decode import median_speed, root_steps
from pfnn_jax.motion.features.encode import Features, join_rows, select_rows
from pfnn_jax.motion.labels.phase import CYCLE
from pfnn_jax.training.data import Batch
from pfnn_jax.training.restyling import fit_mean_row, mean_row

PHASES = 64
"""Points of a cycle."""

PAIRS = {
    "clip to the other walks": ("clip", "walks"),
    "clip to straight parts of turning takes": ("clip", "straight parts"),
    "straight parts to turns": ("straight parts", "turns"),
    "clip to turns": ("clip", "turns"),
    "clip and mean difference to turns": ("added", "turns"),
    "clip and mean difference by speed to turns": ("scaled", "turns"),
    "walks and mean difference by speed to turns": ("walks scaled", "turns"),
}
"""Which cycles are compared."""


def cycle(fold: Fold, rows: Features) -> np.ndarray:
    """Returns the mean joint positions [PHASES, J, 3] in metres of rows, relative to the root."""
    layout = fold.layout
    mean = mean_row(fit_mean_row(Batch(rows.x, rows.y, rows.phase)), np.arange(PHASES) * (CYCLE / PHASES))
    positions = mean[:, layout.input_size :][:, layout.output_slice("joint_position")]
    return layout.length_unit * positions.reshape(PHASES, -1, 3)


def left_turns(fold: Fold, rows: Features) -> Features:
    """Returns the rows that turn to the left."""
    turning = is_turning(rows.y, fold.layout)
    return select_rows(rows, turning & (root_steps(fold.layout, rows.y)[1] > 0))


def cycles(fold: Fold) -> dict[str, np.ndarray]:
    """Returns the cycles that are compared, by name."""
    turning = rows_of([take for take in fold.own if "turn" in take.content])
    found = {
        "clip": cycle(fold, join_rows(fold.clip)),
        "walks": cycle(fold, rows_of(fold.walks[1:])),
        "straight parts": cycle(fold, select_rows(turning, ~is_turning(turning.y, fold.layout))),
        "turns": cycle(fold, left_turns(fold, turning)),
    }
    added, scaled = differences(fold)
    return found | {
        "added": found["clip"] + added,
        "scaled": found["clip"] + scaled,
        "walks scaled": found["walks"] + scaled,
    }


def differences(fold: Fold) -> tuple[np.ndarray, np.ndarray]:
    """Returns the known styles' mean difference between turns and straight walks, as it is and scaled by speed."""
    added, scaled = [], []
    for takes in fold.known_takes().values():
        walks = rows_of([take for take in takes if take.content == "walk"])
        turns = left_turns(fold, rows_of([take for take in takes if "turn" in take.content]))
        added.append(cycle(fold, turns) - cycle(fold, walks))
        scaled.append(added[-1] * fold.speed / median_speed(fold.layout, walks.y))
    return np.mean(added, axis=0), np.mean(scaled, axis=0)


def compare(fold: Fold) -> dict[str, Mapping[str, float]]:
    """Returns the distances in cm of `PAIRS`, by part of the body."""
    own = cycles(fold)
    return {
        name: by_part(np.linalg.norm(own[a] - own[b], axis=-1).mean(axis=0), fold.everything.skeleton)
        for name, (a, b) in PAIRS.items()
    }


def main(config: FoldConfig) -> None:
    """Writes the distances of all folds as `mean_cycles.md`."""
    found = {(fold.style, fold.seed): compare(fold) for fold in TurningFolds(config).folds()}
    parts = ("distance", "trunk", "arms", "legs")
    rows = []
    for name in PAIRS:
        styles = [one[name]["distance"] for one in found.values()]
        rows.append([name, *styles, *(float(np.mean([one[name][part] for one in found.values()])) for part in parts)])
    head = ["cm", *(style for style, _ in found), "mean", *parts[1:]]
    table = markdown_table(head, rows)
    config.out.mkdir(parents=True, exist_ok=True)
    write_whole(config.out / "mean_cycles.md", table)
    print(table)


if __name__ == "__main__":
    main(tyro.cli(FoldConfig, description=__doc__))
