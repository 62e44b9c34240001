"""Which weights should style transfer by optimisation use, and does the paper's form of it need any change?

Parent    Holden 2016 and 2017: style 0.01 on Gram matrices, content 1, weights of feet, bones and trajectory not given;
          the motion that leaves the autoencoder is the result. No numbers.
Question  how far do results take the style and keep the content, as the style's weight, the constraints' weights and
          the form of the method vary?
Data      Bandai-Namco-2: normal takes as contents, clips of the other styles as style, of a take with another number:
          walks for walks and turns, runs for runs. Two classifiers, of styles and of contents, learn from takes of odd
          numbers; contents and styles are takes of even numbers. Nothing is read from the test clips of Xia et al.
Expect    (16 pairs, the package's autoencoder) real takes: .998 of the style's windows are recognised and .885 of the
          content's. Shares of windows, then of clips, that show the style and the content; jitter over the content's:

          | setting                     | style | content | style, clips | content, clips | jitter | bones, cm |
          | content itself              | 0     | 1       | 0            | 1              | 1      | .10       |
          | style clip itself           | 1     | .50     | 1            | .50            | .91    | .31       |
          | default                     | .98   | .69     | .94          | .81            | 1.23   | .11       |
          | learning rate 0.01          | .94   | .70     | .94          | .94            | 1.25   | .25       |
          | style 0.001                 | .91   | .74     | .94          | .88            | 1.20   | .11       |
          | style 0.1                   | .98   | .69     | 1            | .81            | 1.32   | .13       |
          | no constraints              | 1     | .70     | 1            | .75            | 1.06   | 1.4       |
          | foot 0.1                    | .98   | .68     | 1            | .81            | 1.23   | .06       |
          | trajectory 0.1              | .96   | .70     | .94          | .88            | 1.22   | .12       |
          | own speed                   | .90   | .69     | .94          | .81            | 1.22   | .11       |
          | all through the autoencoder | .96   | .75     | 1            | .81            | 3.5    | .44       |
          | the same, no constraints    | 1     | .69     | 1            | .75            | 1.46   | 1.4       |
          | the same, from noise        | .39   | .26     | .50          | .25            | 297    | 58        |

          One pair of 16 is 6 %. The paper's weight of the style is right, and its form takes the style as well, but
          jerks three times as much; adding only the change costs nothing. The constraints bring the bones back. The
          authors' learning rate of 0.01 has not arrived after 250 steps: arms that hang do not rise to those of a
          zombie, whose Gram matrix is still off by 61 % (squared, of the content's distance 104 %; with 0.05 by 1 %).
          From noise 250 iterations are too few. Multiplying all weights of the constraints by one factor changes
          nothing: Adam does not see it.
Run       python -m experiments.transfer_weights --data bandai-namco-2 --out runs/transfer_weights
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from experiments.common.markdown import markdown_table
from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.metrics import foot_skating, jitter
from pfnn_jax.evaluation.motion_windows import motion_windows
from pfnn_jax.evaluation.style_classifier import ClassifierConfig, StyleClassifier, scores, train_classifier
from pfnn_jax.io.files import write_json, write_whole
from pfnn_jax.motion.body_points import POINT_NAMES
from pfnn_jax.motion.clip import swap_sides
from pfnn_jax.motion.datasets.labelled import read_cut_clip
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.skeleton import Roles
from pfnn_jax.motion.trajectory import Root
from pfnn_jax.transfer.clip_rows import FEET, decode_rows, encode_clip, prepare_clip
from pfnn_jax.transfer.config import LossWeights, OptimisationConfig
from pfnn_jax.transfer.layout import LAYOUT_FPS, ClipLayout
from pfnn_jax.transfer.losses import bone_loss, content_constraints
from pfnn_jax.transfer.optimisation import optimise
from pfnn_jax.transfer.run import BASE_AUTOENCODER, TransferRun, load_transfer_run

PLAIN = OptimisationConfig(keep_detail=False)
SETTINGS = {
    "default": OptimisationConfig(),
    "learning rate 0.01": OptimisationConfig(learning_rate=0.01),
    "style 0.001": OptimisationConfig(weights=LossWeights(style=0.001)),
    "style 0.1": OptimisationConfig(weights=LossWeights(style=0.1)),
    "no constraints": OptimisationConfig(constraint_iterations=0),
    "foot 0.1": OptimisationConfig(weights=LossWeights(foot=0.1)),
    "trajectory 0.1": OptimisationConfig(weights=LossWeights(trajectory=0.1)),
    "own speed": OptimisationConfig(scale_speed=False),
    "all through the autoencoder": PLAIN,
    "the same, no constraints": replace(PLAIN, constraint_iterations=0),
    "the same, from noise": replace(PLAIN, start="noise"),
}
"""What is compared."""

COLUMNS = ("style", "content", "style clips", "content clips", "jitter", "skating, m/s", "bones, cm")

_AT = {name: index for index, name in enumerate(POINT_NAMES)}
ROLES = Roles(
    hips=_AT["hips"],
    left_hip=_AT["left_thigh"],
    right_hip=_AT["right_thigh"],
    left_shoulder=_AT["left_upper_arm"],
    right_shoulder=_AT["right_upper_arm"],
    left_foot=(_AT["left_foot"], _AT["left_toe"]),
    right_foot=(_AT["right_foot"], _AT["right_toe"]),
    left_hand=_AT["left_hand"],
    right_hand=_AT["right_hand"],
    head=_AT["head"],
)
"""Roles of the points of a row."""

MIRROR = np.array([_AT[swap_sides(name)] for name in POINT_NAMES])


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        data: folder of Bandai-Namco-2.
        out: folder of results.
        run: run of style transfer.
        neutral: style of the contents.
        contents: takes of each kind of content; every content is transferred into `styles` styles in turn.
        styles: styles for each content.
        frames: of a content or style clip at 60 fps, from its middle.
        epochs: of the classifiers.
    """

    data: Path
    out: Path
    run: Path = BASE_AUTOENCODER
    neutral: str = "normal"
    contents: int = 2
    styles: int = 2
    frames: int = 200
    epochs: int = 8


@dataclass(frozen=True, eq=False)
class Take:
    """Rows of a clip in layout units, with its labels and its number."""

    rows: np.ndarray
    content: str
    style: str
    number: int

    @property
    def learned(self) -> bool:
        """Whether classifiers learn from it."""
        return self.number % 2 == 1


@dataclass(frozen=True, eq=False)
class Judge:
    """Classifiers of style and content, and what their outputs mean."""

    styles: tuple[str, ...]
    contents: tuple[str, ...]
    style_classifier: StyleClassifier
    content_classifier: StyleClassifier


def read_takes(config: Config, run: TransferRun) -> list[Take]:
    """Reads all clips of the folder onto the run's skeleton."""
    takes = []
    for file in list_clips(config.data):
        rows = encode_clip(prepare_clip(read_cut_clip(file).clip, run.skeleton), run.layout)
        takes.append(Take(rows, file.content, file.style, int(file.path.stem.rsplit("_", 1)[1])))
    return takes


def windows(rows: np.ndarray, layout: ClipLayout, mirror: bool = False) -> np.ndarray:
    """Returns the classifiers' windows of rows, or of their mirror image."""
    positions = world(rows, layout)
    return motion_windows(positions[:, MIRROR] * [-1, 1, 1] if mirror else positions, ROLES, LAYOUT_FPS)


def world(rows: np.ndarray, layout: ClipLayout) -> np.ndarray:
    """Returns the points [T, 21, 3] of rows in the world, in metres."""
    return decode_rows(np.asarray(rows, float), layout, Root(np.zeros((1, 2)), np.array([[0.0, 1.0]])))[0]


def train_judge(takes: Sequence[Take], layout: ClipLayout, epochs: int) -> Judge:
    """Trains both classifiers on the takes of odd numbers and their mirror images."""
    styles, contents = (tuple(sorted({getattr(take, name) for take in takes})) for name in ("style", "content"))
    found, labels = [], []
    for take in takes:
        for mirror in (False, True) if take.learned else ():
            found.append(windows(take.rows, layout, mirror))
            content = swap_sides(take.content) if mirror else take.content
            labels += [(styles.index(take.style), contents.index(content))] * len(found[-1])
    if not labels:
        raise InputError("transfer_weights", "data", "no takes of odd numbers", "must have some to learn from")
    both, config = np.array(labels), ClassifierConfig(epochs=epochs)
    made = [
        train_classifier(np.concatenate(found), both[:, column], len(names), config)
        for column, names in enumerate((styles, contents))
    ]
    return Judge(styles, contents, made[0], made[1])


def draw_pairs(takes: Sequence[Take], config: Config) -> list[tuple[Take, Take]]:
    """Returns pairs of a neutral content and a style clip of another take, all of even numbers, cut to their middle."""
    kept = [take for take in takes if not take.learned]
    others = sorted({take.style for take in kept} - {config.neutral})
    pairs = []
    for content in sorted({take.content for take in kept}):
        own = [take for take in kept if take.content == content and take.style == config.neutral]
        for take in own[: config.contents]:
            for _ in range(config.styles):
                style, gait = others[len(pairs) % len(others)], "run" if content == "run" else "walk"
                clips = [c for c in kept if (c.style, c.content) == (style, gait) and c.number != take.number]
                clip = clips[len(pairs) % len(clips)]
                pairs.append((_middle(take, config.frames), _middle(clip, config.frames)))
    return pairs


def judge_rows(rows: np.ndarray, content: Take, style: str, judge: Judge, layout: ClipLayout) -> dict[str, float]:
    """Returns what the table shows of one result [T, D] in layout units.

    Jitter is measured at 30 fps, the rate of the data: at 60 the content is interpolated.
    """
    seen = windows(rows, layout)
    logits = scores(judge.style_classifier, seen), scores(judge.content_classifier, seen)
    wanted = judge.styles.index(style), judge.contents.index(content.content)
    record = {}
    for name, own, index in zip(("style", "content"), logits, wanted, strict=True):
        record[name] = float(np.mean(own.argmax(axis=1) == index))
        record[f"{name} clips"] = float(own.mean(axis=0).argmax() == index)
    at, before = world(rows, layout), world(content.rows, layout)
    feet = at[:, FEET]
    record["jitter"] = jitter(at[::2], LAYOUT_FPS / 2) / jitter(before[::2], LAYOUT_FPS / 2)
    record["skating, m/s"] = foot_skating(feet, LAYOUT_FPS, np.percentile(feet[..., 1], 5, axis=0))
    constraints = content_constraints(content.rows, layout)
    record["bones, cm"] = float(np.sqrt(bone_loss(np.asarray(rows, np.float32), constraints, layout)))
    return record


def compare(
    pairs: Sequence[tuple[Take, Take]], judge: Judge, run: TransferRun, settings: dict[str, OptimisationConfig]
) -> dict[str, list[dict[str, float]]]:
    """Returns the records of every pair: of the content, of the style clip, and of each setting's result."""
    found: dict[str, list[dict[str, float]]] = {"content itself": [], "style clip itself": []}
    for content, style in pairs:
        found["content itself"].append(judge_rows(content.rows, content, style.style, judge, run.layout))
        found["style clip itself"].append(judge_rows(style.rows, content, style.style, judge, run.layout))
    for name, config in settings.items():
        found[name] = []
        for number, (content, style) in enumerate(pairs):
            rows = optimise(run, content.rows, [style.rows], config, key=jax.random.key(number))
            found[name].append(judge_rows(rows, content, style.style, judge, run.layout))
        print(
            name, {column: round(float(np.mean([r[column] for r in found[name]])), 3) for column in COLUMNS}, flush=True
        )
    return found


def real_accuracy(takes: Sequence[Take], judge: Judge, layout: ClipLayout) -> dict[str, float]:
    """Returns the share of real windows of takes of even numbers that each classifier recognises."""
    hits: dict[str, list[np.ndarray]] = {"style": [], "content": []}
    for take in takes:
        seen = windows(take.rows, layout)
        if take.learned or not len(seen):
            continue
        hits["style"].append(scores(judge.style_classifier, seen).argmax(axis=1) == judge.styles.index(take.style))
        hits["content"].append(
            scores(judge.content_classifier, seen).argmax(axis=1) == judge.contents.index(take.content)
        )
    return {name: float(np.concatenate(values).mean()) for name, values in hits.items()}


def main(config: Config, settings: dict[str, OptimisationConfig] | None = None) -> dict[str, Any]:
    """Runs the experiment; writes `transfer_weights.json` and `.md` and returns what the first holds."""
    run = load_transfer_run(config.run)
    takes = read_takes(config, run)
    judge = train_judge(takes, run.layout, config.epochs)
    found = compare(draw_pairs(takes, config), judge, run, settings or SETTINGS)
    return report(found, real_accuracy(takes, judge, run.layout), config.out)


def report(found: dict[str, list[dict[str, float]]], real: dict[str, float], out: Path) -> dict[str, Any]:
    """Writes the table: means over pairs."""
    means = {name: {c: float(np.mean([r[c] for r in records])) for c in COLUMNS} for name, records in found.items()}
    result = {"pairs": len(next(iter(found.values()))), "real": real, "rows": means}
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "transfer_weights.json", result)
    table = markdown_table(("setting", *COLUMNS), [[name, *row.values()] for name, row in means.items()])
    write_whole(out / "transfer_weights.md", table)
    return result


def _middle(take: Take, frames: int) -> Take:
    start = max(len(take.rows) - frames, 0) // 2
    return replace(take, rows=take.rows[start : start + frames])


if __name__ == "__main__":
    main(tyro.cli(Config))
