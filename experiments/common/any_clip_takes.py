"""Which clips of which source a style is learned from, and which takes it is judged on: rules, and no choice by hand.

Of every style, in the order of names, the first window of at most 5 seconds in which somebody walks ahead is learned.
It is judged on the first such window of each other take. Where a style has a single take, it is judged on a window of
that take at least 2 seconds away, and where the take is too short for that, on the learned frames themselves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.datasets.labelled import LabelledClip, load_labelled, read_cut_clip
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips
from pfnn_jax.motion.synthetic.styles import PRETRAINING_STYLES, UNSEEN_STYLE
from pfnn_jax.motion.synthetic.walks import mixed_schedule, synthesise
from pfnn_jax.workflows.clip_report import ADVICE, clip_warnings, inspect_clip

LEARNED_SECONDS = 5.0
"""Longest clip to learn from."""

LEAST_LEARNED = 3.0
"""Shortest part of a longer take to learn from."""

LEAST_SECONDS = 2.0
"""Shortest clip that is used at all: about one and a half gait cycles."""

GAP_SECONDS = 2.0
"""Between the learned part of a take and the part that it is judged on."""

STEP_SECONDS = 1.0
"""Between the starts of two windows that are tried."""

SPEED_RATIO = 1.4
"""Largest ratio between the speeds of the learned and the judged take: a run does not test a walk."""

OTHER_TAKE, SAME_TAKE, SAME_FRAMES = "other take", "same take, 2 s away", "learned frames"


@dataclass(frozen=True)
class Source:
    """Where clips come from.

    Attributes:
        name: of the source.
        folder: of its files, below the folder of all motion capture; empty for procedural walks.
        learned: contents that are learned; empty for all.
        judged: contents that are judged on, one take of each; empty for the first other take of any content.
    """

    name: str
    folder: str
    learned: tuple[str, ...] = ()
    judged: tuple[str, ...] = ()


SOURCES = (
    Source("procedural", "", ("walk",), ("walk-mixed",)),
    Source("bandai-namco-1", "bandai-namco-1", ("walk",), ("walk",)),
    Source("bandai-namco-2", "bandai-namco-2", ("walk",), ("walk", "walk-turn-left")),
    Source("100style", "100style", ("walk",), ("walk",)),
    Source("xia", "xia-test", ("walk",), ("walk",)),
    Source("pfnn", "pfnn"),
    Source("field", "field"),
)
"""All sources. The public test split of Xia holds all walks of the smaller folder."""


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a take in which somebody walks ahead.

    Attributes:
        file: the take, cut to the part.
        labelled: the part as it is read.
        begin, seconds: where it begins in its file, and how long it is.
        speed: metres per second.
    """

    file: ClipFile
    labelled: LabelledClip
    begin: float
    seconds: float
    speed: float


@dataclass(frozen=True, eq=False)
class Trial:
    """One style to be learned: from what, and judged on what.

    Attributes:
        source, style: names.
        learned: the part to learn from.
        judged: the parts to judge on.
        how: what they are to the learned part: `OTHER_TAKE`, `SAME_TAKE` or `SAME_FRAMES`.
    """

    source: str
    style: str
    learned: Part
    judged: tuple[Part, ...]
    how: str


def list_styles_of(source: Source, mocap: Path, work: Path) -> dict[str, list[ClipFile]]:
    """Returns the clips of a source by style, in the order in which styles are tried.

    Args:
        source: the source.
        mocap: folder of all motion capture.
        work: folder for procedural clips, written once.

    Raises:
        InputError: if the source's folder is absent or holds no clips.
    """
    if not source.folder:
        return {style: synthetic_files(style, work) for style in (UNSEEN_STYLE, *sorted(PRETRAINING_STYLES))}
    folder = mocap / source.folder
    if source.name == "field":
        files = [ClipFile(path, path.stem) for path in sorted(folder.glob("*.bvh"))]
        if not files:
            raise InputError(folder, "folder", "no BVH files", "must hold the clips of the source")
    else:
        files = list_clips(folder)
    styles: dict[str, list[ClipFile]] = {}
    for file in files:
        styles.setdefault(file.style, []).append(file)
    return dict(sorted(styles.items()))


def synthetic_files(style: str, work: Path) -> list[ClipFile]:
    """Writes 5 s straight ahead and 6 s of mixed walking of a procedural style, with other noise than any training."""
    straight = np.zeros(300), None
    files = []
    for content, seed, (turn_rate, speed) in (
        ("walk", 9001, straight),
        ("walk-mixed", 9002, mixed_schedule(style, 5.0, 9002)),
    ):
        path = work / f"{style}_{content}.bvh"
        if speed is None:
            speed = np.full(len(turn_rate), np.median(mixed_schedule(style, 60.0, 0)[1]))
        if not path.exists():
            work.mkdir(parents=True, exist_ok=True)
            write_bvh(path, synthesise(style, turn_rate, speed, seed=seed, content=content)[0], overwrite=True)
        files.append(ClipFile(path, style, content))
    return files


def find_trial(source: Source, style: str, files: Sequence[ClipFile]) -> Trial | str:
    """Returns what of a style is learned and what it is judged on, or why it is skipped."""
    reasons: list[str] = []
    own = [file for file in files if not source.learned or file.content in source.learned]
    for file in own:
        part = next(walks_in(file, single=len(own) == 1, reasons=reasons), None)
        if part is not None:
            return Trial(source.name, style, part, *_judged(source, part, files))
    return "; ".join(dict.fromkeys(reasons)) or f"no take with content {' or '.join(source.learned)}"


def walks_in(file: ClipFile, *, single: bool, reasons: list[str], longest: float | None = None) -> Iterator[Part]:
    """Yields the windows of a take in which somebody walks ahead, in the order of time.

    Args:
        file: the take.
        single: whether the rest of the take is to be judged on, so that enough of it must be left.
        reasons: receives why windows or the take are not used.
        longest: seconds of a window; by default as long as the take allows.
    """
    try:
        whole = read_cut_clip(file)
    except InputError as error:
        reasons.append(f"{error.value}; {error.rule}")
        return
    fps, total = whole.clip.fps, whole.clip.num_frames / whole.clip.fps
    seconds = _length(total, single) if longest is None else min(longest, total)
    if seconds < LEAST_SECONDS:
        reasons.append(f"only {total:.1f} s")
        return
    for begin in np.arange(0.0, total - seconds + 1e-6, STEP_SECONDS):
        start = whole.start + round(begin * fps)
        part = replace(file, start=start, stop=start + round(seconds * fps))
        try:
            labelled = load_labelled(part)
        except InputError as error:
            reasons.append(f"{error.value}; {error.rule}")
            continue
        report = inspect_clip(labelled, True)
        if warnings := clip_warnings(report):
            reasons.append(warnings[0].removesuffix(f"; {ADVICE}"))
            continue
        yield Part(part, labelled, (start - file.start) / fps, seconds, report.speed)


def _length(total: float, single: bool) -> float:
    """Returns the seconds of a take of `total` seconds that are learned."""
    left = total - GAP_SECONDS - LEAST_SECONDS
    if single and left >= LEAST_LEARNED:
        return min(left, LEARNED_SECONDS)
    return min(total, LEARNED_SECONDS)


def _judged(source: Source, learned: Part, files: Sequence[ClipFile]) -> tuple[tuple[Part, ...], str]:
    """Returns the parts that a learned part is judged on, and what they are to it."""
    found = []
    for content in source.judged or ("",):
        others = (file for file in files if file.path != learned.file.path and content in ("", file.content))
        found += next(filter(None, (_first(file, learned) for file in others)), [])
    if found:
        return tuple(found), OTHER_TAKE
    end = learned.begin + learned.seconds
    whole = next(file for file in files if file.path == learned.file.path)
    for longest in (LEARNED_SECONDS, LEAST_SECONDS):
        for part in walks_in(whole, single=False, reasons=[], longest=longest):
            away = part.begin - end >= GAP_SECONDS or learned.begin - part.begin - part.seconds >= GAP_SECONDS
            if away and _as_fast(part, learned):
                return (part,), SAME_TAKE
    return (learned,), SAME_FRAMES


def _first(file: ClipFile, learned: Part) -> list[Part]:
    """Returns the first window of a take that is walked about as fast as the learned part, or none."""
    for part in walks_in(file, single=False, reasons=[]):
        if _as_fast(part, learned):
            return [part]
    return []


def _as_fast(part: Part, learned: Part) -> bool:
    return 1 / SPEED_RATIO <= part.speed / learned.speed <= SPEED_RATIO
