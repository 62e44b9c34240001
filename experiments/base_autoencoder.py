"""Which motion makes a motion autoencoder that reconstructs strangers' clips? Trains the one that is shipped.

Question  `pfnn_jax/base_autoencoder` is the loss network of `transfer CONTENT.bvh --style STYLE.bvh`. It must be small,
          free to redistribute, and wide enough for walks, runs, jumps, punches and kicks of real people on any
          skeleton, after retargeting.
Data      the eight procedural walkers and walkers of random styles; 100STYLE (CC BY 4.0, Ian Mason) on the procedural
          skeleton; variants of both whose upper bodies are posed differently; the captured motion faster and slower;
          and gestures: smooth random movement of arms, legs and trunk, and jumps, added to all of these.
Run       python -m experiments.base_autoencoder --hundred-style FOLDER --out runs/autoencoder
          then copy runs/autoencoder/run to pfnn_jax/base_autoencoder. FOLDER holds the takes of 100STYLE that CARD.md
          there lists, and no others. `--held-out FOLDER` reports the reconstruction error on other clips.
Result    docs/results_appendix.md, "Motion autoencoders": gestures make every kind of held-out clip more exact, walks
          too. The settings were chosen on Bandai-Namco 1 and 2 and PFNN.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import tyro

from experiments.base_network import random_style, random_variation, vary
from pfnn_jax.io.files import write_json
from pfnn_jax.motion.clip import MotionClip, mirror_clip, resample
from pfnn_jax.motion.datasets.labelled import load_clip
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.filters import gaussian_filter
from pfnn_jax.motion.kinematics import quat_exp, quat_multiply
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.styles import PRETRAINING_STYLES
from pfnn_jax.motion.synthetic.walks import synthetic_clips
from pfnn_jax.training.loop import Progress
from pfnn_jax.transfer.autoencoder_training import fit_statistics, train_autoencoder
from pfnn_jax.transfer.clip_rows import cut_windows, encode_clip, prepare_clip
from pfnn_jax.transfer.config import AutoencoderTrainingConfig
from pfnn_jax.transfer.layout import HOLDEN2017, LAYOUT_FPS
from pfnn_jax.transfer.predict import reconstruct
from pfnn_jax.transfer.run import TransferRun, create_transfer_run

CENTIMETRES = 100.0


@dataclass(frozen=True)
class Config:
    """The autoencoder and its data.

    Attributes:
        out: folder of results: `run/`, which is shipped, and `errors.json`.
        hundred_style: folder of 100STYLE; None leaves it out.
        held_out: folders of clips on which the reconstruction error is reported.
        random_styles: number of procedural styles with random parameters.
        variants: of the captured motion, with other poses of the upper body.
        gestures: share of clips that are added once more, with gestures.
        seconds: of motion for each procedural style, before mirroring.
        training: sizes and schedule of the autoencoder.
        seed: of the data.
    """

    out: Path
    hundred_style: Path | None = None
    held_out: tuple[Path, ...] = ()
    random_styles: int = 32
    variants: int = 2
    gestures: float = 1.0
    seconds: float = 20.0
    training: AutoencoderTrainingConfig = field(default_factory=AutoencoderTrainingConfig)
    seed: int = 0


SPEEDS = (0.75, 1.35)
"""Factors by which captured motion is played slower and faster."""

GESTURE_ANGLES = {
    "Spine": 10.0, "Spine1": 8.0, "Neck": 8.0, "Head": 12.0, "Shoulder": 8.0, "Arm": 40.0, "ForeArm": 35.0,
    "Hand": 20.0, "Foot": 8.0,
}  # fmt: skip
"""Standard deviation, in degrees about each axis, of the movement that a gesture adds to a joint."""

GESTURE_SECONDS = (0.08, 0.5)
"""Range of the smoothing of a gesture: from punches to slow movement."""

LIFT, KICK = (0.1, 0.5), (20.0, 100.0)
"""Metres that a jump is high, and degrees that a leg is raised."""


def captured_clips(folder: Path) -> list[MotionClip]:
    """Returns the takes of 100STYLE on the procedural skeleton."""
    skeleton = synthetic_skeleton()
    return [prepare_clip(load_clip(file), skeleton) for file in list_clips(folder)]


def training_clips(config: Config) -> Iterator[MotionClip]:
    """Returns all clips on the procedural skeleton, without mirror images."""
    rng = np.random.default_rng([config.seed, 3])
    for clip in _plain_clips(config):
        yield clip
        if rng.uniform() < config.gestures:
            yield add_gestures(clip, rng)


def _plain_clips(config: Config) -> Iterator[MotionClip]:
    for number, name in enumerate(PRETRAINING_STYLES):
        yield from (walk.clip for walk in synthetic_clips(name, config.seconds, seed=config.seed + number))
    for number in range(config.random_styles):
        variation = random_variation(np.random.default_rng([config.seed, 1, number]))
        walks = synthetic_clips(random_style(number, config.seed), config.seconds, seed=100 + config.seed + number)
        yield from (vary(walk.clip, variation) for walk in walks)
    captured = [] if config.hundred_style is None else captured_clips(config.hundred_style)
    yield from captured
    for clip in captured:
        yield from (change_speed(clip, factor) for factor in SPEEDS)
        for number in range(config.variants):
            yield vary(clip, random_variation(np.random.default_rng([config.seed, 2, number])))


def change_speed(clip: MotionClip, factor: float) -> MotionClip:
    """Returns a clip played faster or slower by a factor."""
    return resample(replace(clip, fps=clip.fps * factor), clip.fps)


def add_gestures(clip: MotionClip, rng: np.random.Generator) -> MotionClip:
    """Returns a clip whose joints make further smooth random movements, whose legs kick, and which jumps.

    Knees only flex. Feet may slide and leave the ground.
    """
    names, count = clip.skeleton.names, clip.num_frames
    vectors = np.zeros((count, len(names), 3))
    seconds = rng.uniform(*GESTURE_SECONDS)
    for joint, name in enumerate(names):
        part = name.removeprefix("Left").removeprefix("Right")
        if part in GESTURE_ANGLES:
            vectors[:, joint] = np.deg2rad(GESTURE_ANGLES[part]) * smooth_noise(rng, (count, 3), seconds)
    for side in ("Left", "Right"):
        raised = np.deg2rad(rng.uniform(*KICK)) * pulses(rng, count, seconds)
        hip, knee = names.index(f"{side}UpLeg"), names.index(f"{side}Leg")
        vectors[:, hip, 0] -= raised
        vectors[:, hip, 1:] += 0.3 * raised[:, None] * rng.normal(size=2)
        vectors[:, knee, 0] += raised * rng.uniform(0.0, 1.2)
    positions = clip.root_positions.copy()
    positions[:, 1] += rng.uniform(*LIFT) * pulses(rng, count, seconds)
    return replace(clip, rotations=quat_multiply(clip.rotations, quat_exp(vectors / 2)), root_positions=positions)


def smooth_noise(rng: np.random.Generator, shape: tuple[int, ...], seconds: float) -> np.ndarray:
    """Returns smooth noise over the first axis, of unit variance."""
    noise = gaussian_filter(rng.normal(size=shape), seconds * LAYOUT_FPS)
    return noise / max(noise.std(), 1e-9)


def pulses(rng: np.random.Generator, count: int, seconds: float) -> np.ndarray:
    """Returns values [count] that rise from 0 to about 1 now and then."""
    return np.clip(smooth_noise(rng, (count,), seconds) - 0.8, 0.0, 1.5)


def training_windows(config: Config) -> np.ndarray:
    """Returns windows [N, 240, D] of all clips and of their mirror images, in layout units."""
    windows = []
    for clip in training_clips(config):
        for image in (clip, mirror_clip(clip)):
            windows.append(cut_windows(encode_clip(image, HOLDEN2017), HOLDEN2017))
    return np.concatenate(windows)


def train(config: Config) -> tuple[TransferRun, int]:
    """Trains the autoencoder; returns the run, and the number of windows."""
    windows = training_windows(config)
    statistics = fit_statistics(windows, HOLDEN2017)
    started = time.perf_counter()

    def report(progress: Progress) -> None:
        passed = time.perf_counter() - started
        print(f"step {progress.step}: squared error {progress.loss:.5f}, {passed:.0f} s", flush=True)

    normalised = ((windows - statistics.mean) / statistics.std).astype(np.float32)
    autoencoder = train_autoencoder(normalised, config.training, progress_callback=report)
    note = {"dataset": "procedural walkers and 100STYLE, see CARD.md", "windows": len(windows)}
    note |= {"steps": config.training.steps, "batch_size": config.training.batch_size}
    run = create_transfer_run(
        config.out / "run", HOLDEN2017, synthetic_skeleton(), statistics, autoencoder, note, overwrite=True
    )
    return run, len(windows)


def reconstruction_errors(run: TransferRun, folder: Path) -> dict[str, float]:
    """Returns the mean error in centimetres of the points of every clip in a folder, put onto the run's skeleton."""
    errors = {}
    for file in list_clips(folder):
        rows = encode_clip(prepare_clip(load_clip(file), run.skeleton), run.layout)
        rows = rows[: len(rows) // 2 * 2]
        columns = run.layout.joint_position
        apart = (reconstruct(run, rows).y - rows)[:, columns].reshape(len(rows), -1, 3)
        unit = CENTIMETRES * run.layout.length_unit
        errors[file.path.stem] = float(unit * np.linalg.norm(apart, axis=-1).mean())
    return errors


def card(config: Config, windows: int) -> str:
    """Returns the card of the shipped autoencoder: data, sizes, training, licence."""
    takes = [] if config.hundred_style is None else sorted(file.path.stem for file in list_clips(config.hundred_style))
    training, sizes = config.training, config.training.autoencoder
    return f"""# Base autoencoder

The motion autoencoder with which `pfnn-jax transfer` compares and reconstructs motion, without training one first.

- **Data**: {windows:,} windows of 240 frames at 60 per second on the procedural skeleton, mirror images included: the
  eight procedural walkers of `pfnn_jax.motion.synthetic`, {config.random_styles} walkers of random styles, and
  100STYLE ({", ".join(takes)}), retargeted: as captured, played at
  {SPEEDS[0]:g} and {SPEEDS[1]:g} times the speed, and in {config.variants} variants whose upper bodies are posed
  differently. Copies of {100 * config.gestures:g} % of these clips have random movement of arms, legs and trunk and
  jumps added.
- **Network**: layout `holden2017`, {sizes.filters} filters of width {sizes.width}, tied decoder.
- **Training**: {training.steps:,} steps of {training.batch_size} windows at a learning rate of
  {training.learning_rate:g}, by `experiments/base_autoencoder.py`.
- **Licence**: CC BY 4.0, as its captured motion: "The 100STYLE Dataset – Ian Mason",
  <https://doi.org/10.5281/zenodo.8127870>, under <https://creativecommons.org/licenses/by/4.0/>; changed by
  retargeting, mirroring, change of speed and added movement. The procedural walkers carry no third-party licence.
"""


def main(config: Config) -> None:
    """Trains the autoencoder, writes what is shipped, and reports errors on held-out clips."""
    shutil.rmtree(config.out / "run", ignore_errors=True)
    run, windows = train(config)
    (run.path / "CARD.md").write_text(card(config, windows), encoding="utf-8")
    errors = {folder.name: reconstruction_errors(run, folder) for folder in config.held_out}
    write_json(config.out / "errors.json", errors)
    for name, found in errors.items():
        print(f"{name}: mean {np.mean(list(found.values())):.2f} cm over {len(found)} clips")


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
