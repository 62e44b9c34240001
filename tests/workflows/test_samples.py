"""The sample clips of the package: written by one function, readable as any clip, and unlike the pretraining styles."""

from __future__ import annotations

import numpy as np
import pytest

from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.datasets.labelled import load_labelled
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.retargeting.retarget import retarget
from pfnn_jax.motion.synthetic.samples import SAMPLES, SECONDS, make_sample
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.walks import PRETRAINING_STYLES, STYLES, synthesise
from pfnn_jax.motion.world_motion import world_motion
from pfnn_jax.workflows.clip_report import clip_warnings, inspect_clip
from pfnn_jax.workflows.samples import sample_clips, write_samples

LARGEST = 150_000  # bytes of a file
ROUNDING = 1e-4  # numbers of the files, which have 6 decimals: other machines round otherwise
SPEED = 0.05  # m/s between the median speed of the hips and that of the style
UNLIKE = 0.12  # metres by which the place or the movement of a joint differs from every pretraining style

clips = pytest.mark.parametrize("name", SAMPLES)


def numbers(text: str) -> tuple[str, np.ndarray]:
    """Returns the hierarchy and the rows of a BVH file."""
    hierarchy, motion = text.split("MOTION")
    return hierarchy, np.array([line.split() for line in motion.splitlines()[3:]], float)


def describe(clip) -> np.ndarray:
    """Returns mean and standard deviation [J, 6] of the joints' positions relative to the hips."""
    positions = world_motion(clip).positions
    positions = positions - positions[:, :1]
    return np.concatenate([positions.mean(axis=0), positions.std(axis=0)], axis=1)


def test_the_package_contains_what_the_function_writes(tmp_path):
    write_samples(tmp_path)
    kept = sample_clips()
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(path.name for path in kept.values())
    for path in kept.values():
        assert path.stat().st_size < LARGEST
        (hierarchy, rows), (again, others) = numbers(path.read_text()), numbers((tmp_path / path.name).read_text())
        assert hierarchy == again
        np.testing.assert_allclose(rows, others, atol=ROUNDING)


@clips
def test_a_sample_is_read_as_it_was_made_and_is_a_plain_forward_walk(name):
    sample = SAMPLES[name]
    labelled = load_labelled(ClipFile(sample_clips()[name], name))
    reading = labelled.clip.reading
    assert reading is not None and reading.unit == sample.unit and reading.up == ("z" if sample.z_up else "y")
    assert reading.frames_in_file / reading.fps == SECONDS
    report = inspect_clip(labelled)
    assert report.mirrored and clip_warnings(report) == []
    assert abs(report.speed - sample.size * sample.style.speed) < SPEED


@clips
def test_a_samples_style_is_unlike_every_pretraining_style(name):
    frames = np.zeros(120)
    own = describe(retarget(read_bvh(sample_clips()[name]), synthetic_skeleton()).clip)
    for style in PRETRAINING_STYLES:
        other = describe(synthesise(style, frames, frames + STYLES[style].speed)[0])
        assert np.linalg.norm(own - other, axis=1).max() > UNLIKE, style


@clips
def test_a_sample_is_the_styles_walk_whatever_its_skeleton(name):
    """Rest pose, size, names and up axis of a sample change nothing that retargeting does not undo."""
    sample = SAMPLES[name]
    made = retarget(read_bvh(sample_clips()[name]), synthetic_skeleton()).clip
    walk, _ = synthesise(sample.style, np.zeros(120), np.full(120, sample.style.speed), fps=30.0)
    assert make_sample(sample).num_frames == walk.num_frames == made.num_frames
    assert np.linalg.norm(describe(made) - describe(walk), axis=1).max() < 0.02  # metres
