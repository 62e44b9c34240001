"""Which motion makes a small network on which the walks of strangers can be learned? Trains the one that is shipped.

Question  `pfnn_jax/base_network` is the run from which `few-shot base CLIP` starts. It must be small, free to
          redistribute, and wide enough that an adapter of its middle layer reaches the walks of real people on any
          skeleton, after retargeting.
Data      the eight procedural styles; procedural walkers of random styles; 100STYLE (CC BY 4.0, Ian Mason) on the
          procedural skeleton; and variants of both whose upper bodies are posed differently and swing more or less,
          because an adapter recombines only what the last layer has learned to represent.
Run       python -m experiments.base_network --hundred-style FOLDER --out runs/base
          then copy runs/base/run to pfnn_jax/base_network. FOLDER holds the takes of 100STYLE that CARD.md there
          lists, and no others. All clips that the network is judged on, in
          `experiments/any_clip.py`, are of other sources, but for the two styles of 100STYLE.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from pfnn_jax.control.controller import make_controller
from pfnn_jax.control.kept_calibration import SHIPPED, write_calibrations
from pfnn_jax.io.files import write_json
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.datasets.clip_rows import load_for_skeleton
from pfnn_jax.motion.datasets.dataset import load_dataset
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.features.layout import mason2018
from pfnn_jax.motion.kinematics import quat_conjugate, quat_exp, quat_log, quat_multiply, quat_normalise
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.styles import PRETRAINING_STYLES, STYLES, SyntheticStyle
from pfnn_jax.motion.synthetic.walks import synthetic_clips
from pfnn_jax.run import Run, load_run
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.restyling import save_differences
from pfnn_jax.workflows.pretrain import dataset_differences, pretrain_run


@dataclass(frozen=True)
class Config:
    """The network and its data.

    Attributes:
        out: folder of results: `data/`, `full/` with every style, and `run/`, which is shipped.
        hundred_style: folder of 100STYLE; None leaves it out.
        random_styles: number of procedural styles with random parameters.
        variants: of every captured style, with other poses of the upper body.
        seconds: of motion for each procedural style, before mirroring.
        hidden: H.
        steps, batch_size, learning_rate, dropout: of pretraining.
        seed: of the data and of training.
    """

    out: Path
    hundred_style: Path | None = None
    random_styles: int = 32
    variants: int = 6
    seconds: float = 45.0
    hidden: int = 256
    steps: int = 12000
    batch_size: int = 128
    learning_rate: float = 1e-3
    dropout: float = 0.3
    seed: int = 0


RANGES = {
    "cadence": (0.62, 1.25),
    "duty": (0.56, 0.69),
    "step_width": (0.04, 0.26),
    "toe_out": (-4.0, 18.0),
    "swing_height": (0.035, 0.16),
    "circumduction": (0.0, 0.06),
    "strike": (-8.0, 22.0),
    "push_off": (15.0, 54.0),
    "heel_off": (0.5, 0.74),
    "knee_out": (0.0, 12.0),
    "crouch": (0.0, 0.17),
    "hip_bob": (0.004, 0.045),
    "bob_delay": (-20.0, 50.0),
    "sway": (0.01, 0.065),
    "hip_roll": (0.0, 10.0),
    "hip_yaw": (0.0, 14.0),
    "lean": (-12.0, 30.0),
    "lean_bob": (0.0, 4.0),
    "pelvis_pitch": (-10.0, 14.0),
    "twist": (0.0, 20.0),
    "trunk_roll": (0.0, 9.0),
    "head_pitch": (-15.0, 45.0),
    "head_bob": (0.0, 4.0),
    "head_roll": (0.0, 8.0),
    "arm_raise": (-12.0, 80.0),
    "arm_swing": (0.0, 44.0),
    "arm_lag": (0.0, 60.0),
    "arm_out": (2.0, 40.0),
    "arm_in": (-10.0, 50.0),
    "elbow": (5.0, 95.0),
    "elbow_swing": (0.0, 24.0),
    "shrug": (-8.0, 12.0),
    "hunch": (-16.0, 20.0),
    "wrist": (-20.0, 40.0),
    "bank": (0.3, 1.0),
    "look": (0.0, 0.4),
}
"""Ranges from which the parameters of random styles are drawn: those of the named styles, and a little beyond."""

CAPTURED = ("100style-neutral", "100style-angry")
"""Styles of 100STYLE that are shipped."""

STEP_LENGTH = (0.35, 0.75)
"""Metres; with the cadence it gives a random style's speed."""

POSE_ANGLES = {
    "Spine": 6.0, "Spine1": 6.0, "Neck": 8.0, "Head": 8.0, "Shoulder": 6.0, "Arm": 16.0, "ForeArm": 12.0, "Hand": 15.0,
    "Foot": 3.0, "ToeBase": 5.0,
}  # fmt: skip
"""Standard deviation, in degrees about each axis, of the rotation that a variant adds to a joint."""

SWING = (0.5, 1.5)
"""Factor of a variant's movement of trunk and arms about their mean pose."""


def random_style(number: int, seed: int) -> SyntheticStyle:
    """Returns a procedural style whose parameters lie at random shares between a named style's and random ones."""
    rng = np.random.default_rng([seed, number])
    named = STYLES[PRETRAINING_STYLES[number % len(PRETRAINING_STYLES)]]
    values = {}
    for name, (low, high) in RANGES.items():
        share = rng.uniform(0.0, 1.0)
        values[name] = (1 - share) * getattr(named, name) + share * rng.uniform(low, high)
    values["speed"] = 2 * values["cadence"] * rng.uniform(*STEP_LENGTH)
    return SyntheticStyle(f"random-{number:02d}", **values)


@dataclass(frozen=True, eq=False)
class Variation:
    """Another pose of a body: a rotation that is added to each joint, and a factor of the upper body's movement."""

    turns: np.ndarray  # [J, 4]
    swing: np.ndarray  # [J]


def random_variation(rng: np.random.Generator) -> Variation:
    """Returns a random variation of the procedural skeleton, mostly symmetric between left and right."""
    skeleton = synthetic_skeleton()
    vectors, swing = np.zeros((skeleton.num_joints, 3)), np.ones(skeleton.num_joints)
    amount = {part: rng.uniform(*SWING) for part in ("trunk", "arms")}
    for joint, name in enumerate(skeleton.names):
        part = name.removeprefix("Left").removeprefix("Right")
        if part in POSE_ANGLES and not name.startswith("Right"):
            vectors[joint] = rng.normal(0.0, np.deg2rad(POSE_ANGLES[part]), 3)
            if name == part:  # the midline seldom leans or turns to a side
                vectors[joint, 1:] *= 0.3
        if part not in ("Hips", "UpLeg", "Leg", "Foot", "ToeBase"):
            swing[joint] = amount["trunk" if name == part else "arms"]
    for joint, partner in enumerate(skeleton.mirror):
        if skeleton.names[joint].startswith("Right"):
            noise = rng.normal(0.0, 0.3, 3) * np.abs(vectors[partner])
            vectors[joint] = vectors[partner] * np.array([1.0, -1.0, -1.0]) + noise
    return Variation(quat_exp(vectors / 2), swing)


def vary(clip: MotionClip, variation: Variation) -> MotionClip:
    """Returns a clip in another pose: every joint swings about its mean more or less, and is turned by a constant."""
    rotations = clip.rotations
    mean = quat_normalise(_aligned(rotations).mean(axis=0))
    apart = quat_log(quat_multiply(quat_conjugate(mean), rotations))
    swung = quat_multiply(mean, quat_exp(apart * variation.swing[:, None]))
    swung[:, variation.swing == 1.0] = rotations[:, variation.swing == 1.0]
    return replace(clip, rotations=quat_multiply(swung, variation.turns))


def _aligned(rotations: np.ndarray) -> np.ndarray:
    """Returns quaternions [T, J, 4] in the hemisphere of each joint's first one."""
    return rotations * np.where((rotations * rotations[:1]).sum(-1, keepdims=True) < 0, -1.0, 1.0)


def captured_clips(folder: Path) -> list[LabelledClip]:
    """Returns the walks and runs of 100STYLE on the procedural skeleton, under styles named `100style-NAME`."""
    skeleton = synthetic_skeleton()
    layout, clips = mason2018(skeleton.num_joints), []
    for clip_file in list_clips(folder):
        try:
            labelled = load_for_skeleton(clip_file, layout, skeleton)
        except NoGaitError:
            continue
        named = replace(labelled.clip, style=f"100style-{labelled.clip.style.lower()}")
        clips.append(replace(labelled, clip=named, world=None))
    return clips


def training_clips(config: Config) -> Iterator[LabelledClip]:
    """Returns all clips, with exact labels for procedural ones."""
    for number, name in enumerate(PRETRAINING_STYLES):
        yield from synthetic_clips(name, config.seconds, seed=config.seed + number)
    for number in range(config.random_styles):
        style = random_style(number, config.seed)
        variation = random_variation(np.random.default_rng([config.seed, 1, number]))
        for clip in synthetic_clips(style, config.seconds, seed=100 + config.seed + number):
            yield _varied(clip, variation, style.name)
    captured = [] if config.hundred_style is None else captured_clips(config.hundred_style)
    yield from captured
    for number in range(config.variants):
        for index, style in enumerate(sorted({clip.clip.style for clip in captured})):
            variation = random_variation(np.random.default_rng([config.seed, 2, number, index]))
            yield from (_varied(clip, variation, f"{style}-{number}") for clip in captured if clip.clip.style == style)


def _varied(labelled: LabelledClip, variation: Variation, style: str) -> LabelledClip:
    return replace(labelled, clip=replace(vary(labelled.clip, variation), style=style), world=None)


def train(config: Config) -> Run:
    """Prepares the data, trains the network, and returns the run with every style."""
    preparation = PrepareConfig(validation=0.05, seed=config.seed)
    clips, skeleton = list(training_clips(config)), synthetic_skeleton()
    dataset = prepare(clips, config.out / "data", preparation, skeleton=skeleton, overwrite=True)
    settings = PretrainConfig(
        hidden=config.hidden,
        steps=config.steps,
        batch_size=config.batch_size,
        learning_rate=config.learning_rate,
        dropout=config.dropout,
        seed=config.seed,
    )
    return pretrain_run(dataset, config.out / "full", settings, overwrite=True)


def ship(run: Run, config: Config) -> Path:
    """Writes what is shipped of a run: network, styles with names, differences of procedural styles, a card.

    Returns the folder. No row of 100STYLE is in it.
    """
    out = config.out / "run"
    shutil.rmtree(out, ignore_errors=True)
    styles = [style for style in run.config.styles if style in (*PRETRAINING_STYLES, *CAPTURED)]
    left_out = set(run.config.styles) - set(styles)
    shutil.copytree(
        run.path,
        out,
        ignore=lambda folder, names: [
            name
            for name in names
            if name in ("train_state", "differences") or (Path(folder).name == "styles" and name in left_out)
        ],
    )
    procedural = [style for style in run.config.styles if not style.startswith("100style")]
    differences = dataset_differences(load_dataset(config.out / "data"), config.seed, procedural)
    assert differences is not None  # the layout has a global phase, and procedural walkers turn
    save_differences(out, differences)
    data = json.loads((out / "config.json").read_text())
    data["styles"] = styles
    data["pretrain"] |= {
        "dataset": "procedural walkers and 100STYLE, see CARD.md",
        "frames": {style: run.config.pretrain["frames"][style] for style in styles},
    }
    write_json(out / "config.json", data)
    for style in styles:
        note = json.loads((out / "styles" / style / "style.json").read_text())
        note["info"]["source"] = "100STYLE" if style in CAPTURED else "procedural walker"
        write_json(out / "styles" / style / "style.json", note)
    (out / "CARD.md").write_text(card(run, config), encoding="utf-8")
    ship_calibrations(out)
    return out


def ship_calibrations(run: Path) -> None:
    """Writes what trial walks show of a run's styles, so that the package need not measure it on every machine."""
    controller = make_controller(load_run(run))
    rows = range(len(controller.styles))
    write_calibrations(run / SHIPPED.name, controller.setup, controller.params, rows)


def card(run: Run, config: Config) -> str:
    """Returns the card of the shipped network: data, sizes, training, licence."""
    frames = run.config.pretrain["frames"]
    captured = sum(count for style, count in frames.items() if style.startswith("100style"))
    clips = json.loads((config.out / "data" / "dataset.json").read_text())["clips"]
    takes = sorted({Path(clip["file"]).stem for clip in clips if clip["file"].endswith(".bvh")})
    return f"""# Base network

A small network on which a style is learned from one clip, without training a network first.

- **Data**: {sum(frames.values()):,} frames at 60 per second in {len(frames)} styles on the procedural skeleton,
  mirror images included: the eight procedural walkers of `pfnn_jax.motion.synthetic`, {config.random_styles} walkers
  of random styles, and {captured:,} frames of 100STYLE ({", ".join(takes)}), retargeted, as
  captured and in {config.variants} variants whose upper bodies are posed differently. Only the styles with names are
  shipped, and differences between turning and straight walks of the procedural walkers alone.
- **Network**: layout `mason2018`, a phase-functioned network with {config.hidden} hidden units and CP adapters of rank
  {run.config.adapter.rank}.
- **Training**: {config.steps:,} steps of {config.batch_size} frames at a learning rate of {config.learning_rate:g},
  with noise on poses, by `experiments/base_network.py`.
- **Licence**: CC BY 4.0, as its captured motion: "The 100STYLE Dataset – Ian Mason",
  <https://doi.org/10.5281/zenodo.8127870>, under <https://creativecommons.org/licenses/by/4.0/>; changed by
  retargeting, mirroring and variation. The procedural walkers carry no third-party licence.
"""


def main(config: Config) -> None:
    """Trains the network and writes what is shipped."""
    print(ship(train(config), config))


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
