"""Writes folders in the form of 100STYLE (Mason et al. 2022), in which procedural walkers take the people's place.

Tables, names of files, joints, rate and unit are those of the data set, so that a folder is read as it is
(`pfnn_jax.motion.datasets.style100`); so are the number of takes of each gait and their mean lengths. Styles are
random mixtures of the walkers' nine, and no two takes are alike. The walkers only walk: backward walks are forward ones
played in reverse, runs are fast walks, sidesteps are forward walks too, and who idles steps on the spot.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import numpy as np

from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.datasets.style100 import CUTS, GAITS
from pfnn_jax.motion.datasets.style100 import STYLES as STYLE_TABLE
from pfnn_jax.motion.datasets.workers import map_in_order
from pfnn_jax.motion.roles import assign_roles
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.styles import STYLES, SyntheticStyle
from pfnn_jax.motion.synthetic.walks import mixed_schedule, synthesise

FPS = 60.0

MEAN_FRAMES = {"FW": 7776, "FR": 4149, "BW": 7685, "BR": 4343, "SW": 5410, "SR": 2509, "ID": 816, "TR1": 7560}
"""Mean number of frames between the cuts of each gait that every style of 100STYLE has."""

FURTHER_FRAMES = {"TR2": 3014, "TR3": 3329}
"""The same for further transitions, which eight and two of the hundred styles have."""

SHARES = {"TR2": 0.08, "TR3": 0.02}
"""Share of the styles with those."""

ASYMMETRIC_SHARE = 0.3
"""Share of the styles that may not be mirrored."""

BEFORE, AFTER = 376, 60
"""Mean frames of a file before the first cut, where people stand still to be calibrated, and frames after the last."""

SPREAD = 0.5
"""Takes are up to this share shorter or longer than the mean."""

RUN_SPEED = 1.9
"""Metres per second of runs: the fastest at which the walkers look natural."""

SPINE = {"Spine": ("Chest", "Chest2"), "Spine1": ("Chest3", "Chest4")}
"""Joints that take equal parts of the rotation of one of the walkers'."""

UPPERMOST = np.array([0.0, 0.1, 0.0])
"""Metres from the third to the fourth joint of the chest."""

LIMBS = {
    "Shoulder": "Collar", "Arm": "Shoulder", "ForeArm": "Elbow", "Hand": "Wrist",
    "UpLeg": "Hip", "Leg": "Knee", "Foot": "Ankle", "ToeBase": "Toe",
}  # fmt: skip
"""Joints of the walkers' limbs, without their side, and what they are called in 100STYLE."""

ORDER = (
    *("Hips", "Chest", "Chest2", "Chest3", "Chest4", "Neck", "Head"),
    *("RightCollar", "RightShoulder", "RightElbow", "RightWrist"),
    *("LeftCollar", "LeftShoulder", "LeftElbow", "LeftWrist"),
    *("RightHip", "RightKnee", "RightAnkle", "RightToe", "LeftHip", "LeftKnee", "LeftAnkle", "LeftToe"),
)
"""The joints of 100STYLE, as its files list them."""


@dataclass(frozen=True)
class Take:
    """One file of the folder.

    Attributes:
        style: number of its style.
        gait: as in `GAITS`.
        start, stop: its cuts.
    """

    style: int
    gait: str
    start: int
    stop: int


def write_folder(
    folder: Path, num_styles: int = 100, length: float = 1.0, *, seed: int = 0, workers: int = 1
) -> list[Take]:
    """Writes tables and takes; returns the takes.

    Args:
        folder: to create.
        num_styles: number of styles.
        length: of takes, relative to those of 100STYLE.
        seed: of all that is random.
        workers: number of processes.
    """
    folder.mkdir(parents=True)
    takes = list(plan_takes(num_styles, length, seed))
    _write_tables(folder, num_styles, takes)
    for _ in map_in_order(partial(write_take, folder, seed), takes, workers):
        pass
    return takes


def plan_takes(num_styles: int, length: float, seed: int) -> Iterator[Take]:
    """Yields the takes of a folder, style after style; see `write_folder`."""
    rng = np.random.default_rng([seed, 0])
    spread = rng.uniform(1 - SPREAD, 1 + SPREAD, (num_styles, len(GAITS)))
    spread /= spread.mean(axis=0)  # so that the gaits keep their mean lengths
    for style in range(num_styles):
        for gait, factor in zip(GAITS, spread[style], strict=True):
            if style >= round(SHARES.get(gait, 1.0) * num_styles):
                continue
            frames = {**MEAN_FRAMES, **FURTHER_FRAMES}[gait] * factor * length
            start = round(BEFORE * length * rng.uniform(1 - SPREAD, 1 + SPREAD))
            yield Take(style, gait, start, start + max(2, round(frames)))


def style_name(number: int) -> str:
    """Returns the name of a style."""
    return f"Walker{number:03}"


def make_style(number: int, seed: int) -> SyntheticStyle:
    """Returns a style: a random mixture of the walkers' nine, which favours few of them."""
    known = list(STYLES.values())
    weights = np.random.default_rng([seed, 1, number]).dirichlet(np.full(len(known), 0.5))
    mixed = {
        field.name: float(weights @ [getattr(style, field.name) for style in known])
        for field in fields(SyntheticStyle)
        if field.name != "name"
    }
    return SyntheticStyle(style_name(number), **mixed)


def write_take(folder: Path, seed: int, take: Take) -> None:
    """Writes the BVH file of a take."""
    path = folder / style_name(take.style) / f"{style_name(take.style)}_{take.gait}.bvh"
    path.parent.mkdir(exist_ok=True)
    write_bvh(path, make_take(take, seed))


def make_take(take: Take, seed: int) -> MotionClip:
    """Returns the motion of a take on the skeleton of 100STYLE, with standing before its first cut."""
    style, number = make_style(take.style, seed), list(GAITS).index(take.gait)
    own = [seed, 2, take.style, number]
    rng = np.random.default_rng(own)
    turn_rate, speed = mixed_schedule(style, (take.stop + AFTER) / FPS, int(rng.integers(2**31)), FPS)
    if take.gait in ("FR", "BR", "SR"):
        speed = speed * RUN_SPEED / speed.max()
    moving = np.clip((np.arange(len(speed)) - take.start) / FPS + 1, 0.0, 1.0)  # starts in the second before the cut
    moving = np.zeros_like(moving) if take.gait == "ID" else moving
    backward = take.gait in ("BW", "BR")
    turn_rate, speed = (values[::-1] if backward else values for values in (turn_rate * moving, speed * moving))
    walk, _ = synthesise(style, turn_rate, speed, fps=FPS, seed=int(rng.integers(2**31)), content=GAITS[take.gait])
    clip = on_skeleton(walk)
    if not backward:
        return clip
    return replace(clip, root_positions=clip.root_positions[::-1], rotations=clip.rotations[::-1])


def hundred_styles_skeleton() -> Skeleton:
    """Returns a skeleton with the joints of 100STYLE and the lengths of the walkers'."""
    walker = synthetic_skeleton()
    own = {name: offset for name, offset in zip(walker.names, walker.offsets, strict=True)}
    parts = {ours: theirs for theirs in walker.names for ours in joints_for(theirs)}
    offsets = {ours: own[theirs] for ours, theirs in parts.items()}
    offsets["Chest2"] = offsets["Chest3"] = own["Spine1"] / 2
    offsets["Chest4"] = UPPERMOST
    for name in ("Neck", "LeftCollar", "RightCollar"):
        offsets[name] = offsets[name] - UPPERMOST
    sites = {joints_for(walker.names[joint])[0]: site for joint, site in walker.end_sites}
    skeleton = Skeleton(
        names=ORDER,
        parents=np.array([ORDER.index(parent) if (parent := parent_of(name)) else -1 for name in ORDER]),
        offsets=np.stack([offsets[name] for name in ORDER]),
        end_sites=tuple((joint, sites[name]) for joint, name in enumerate(ORDER) if name in sites),
        mirror=np.arange(len(ORDER)),
    )
    return assign_roles(skeleton, source="walker on the skeleton of 100STYLE")


def joints_for(name: str) -> tuple[str, ...]:
    """Returns the joints of 100STYLE that move as one of the walkers'."""
    if name in SPINE:
        return SPINE[name]
    side = next((side for side in ("Left", "Right") if name.startswith(side)), "")
    return (side + LIMBS[name.removeprefix(side)],) if side else (name,)


def parent_of(name: str) -> str:
    """Returns the parent of a joint of 100STYLE; empty for the hips."""
    roots = {"Hips": "", "Chest": "Hips", "Neck": "Chest4"}
    roots |= {side + joint: to for side in ("Left", "Right") for joint, to in (("Collar", "Chest4"), ("Hip", "Hips"))}
    return roots.get(name, ORDER[ORDER.index(name) - 1])


def on_skeleton(walk: MotionClip) -> MotionClip:
    """Returns a walker's motion on the skeleton of 100STYLE: all limbs move as they did."""
    rotations = np.empty((walk.num_frames, len(ORDER), 4))
    for joint, name in enumerate(walk.skeleton.names):
        ours, turn = joints_for(name), walk.rotations[:, joint]
        for part in ours:
            rotations[:, ORDER.index(part)] = turn if len(ours) == 1 else _half(turn)
    return replace(walk, skeleton=hundred_styles_skeleton(), rotations=rotations)


def _half(turn: np.ndarray) -> np.ndarray:
    """Returns the quaternions [T, 4] that give `turn` when applied twice."""
    half = turn * np.where(turn[:, :1] < 0, -1.0, 1.0) + np.array([1.0, 0.0, 0.0, 0.0])
    return half / np.linalg.norm(half, axis=1, keepdims=True)


def _write_tables(folder: Path, num_styles: int, takes: Sequence[Take]) -> None:
    columns = [f"{gait}_{end}" for gait in sorted(GAITS) for end in ("START", "STOP")]
    cuts: dict[int, dict[str, int]] = {style: {} for style in range(num_styles)}
    for take in takes:
        cuts[take.style] |= {f"{take.gait}_START": take.start, f"{take.gait}_STOP": take.stop}
    rows = [[style_name(style), *(found.get(column, "N/A") for column in columns)] for style, found in cuts.items()]
    _write_table(folder / CUTS, ["STYLE_NAME", *columns], rows)
    asymmetric = round(ASYMMETRIC_SHARE * num_styles)
    styles = [
        [style_name(style), "a procedural walker", "No", "No" if style < asymmetric else "Yes", ""] for style in cuts
    ]
    _write_table(folder / STYLE_TABLE, ["Style Name", "Description", "Stochastic", "Symmetric", "Notes"], styles)


def _write_table(path: Path, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([head, *rows])
