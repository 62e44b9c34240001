"""Labels of a clip: files next to the clip take precedence, and are cut and resampled with it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.datasets.labelled import load_clip, load_labelled
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips
from pfnn_jax.motion.features.encode import clip_features
from pfnn_jax.motion.features.layout import pfnn2017
from pfnn_jax.motion.ground import wrap_angle
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.phase import write_phase
from pfnn_jax.motion.synthetic.walks import mixed_schedule, synthesise


@pytest.fixture
def walk(tmp_path):
    path = tmp_path / "walk.bvh"
    write_bvh(path, synthesise("proud", *mixed_schedule("proud", 4, 0), seed=0)[0])
    return path


def test_a_phase_file_takes_precedence_over_the_labeller(walk):
    found = load_labelled(ClipFile(walk, "proud"))
    shifted = dataclasses.replace(found.labels, phase=(found.labels.phase + 1.0) % (2 * np.pi))
    write_phase(walk.with_suffix(".phase"), shifted)
    corrected = load_labelled(ClipFile(walk, "proud"))
    np.testing.assert_allclose(wrap_angle(corrected.labels.phase - found.labels.phase - 1.0), 0.0, atol=1e-5)
    assert corrected.clip.style == "proud" and corrected.gait is None


def test_hand_made_labels_are_cut_and_resampled_with_their_clip(mocap):
    file = list_clips(mocap / "pfnn")[0]
    whole, part = load_labelled(file), load_labelled(dataclasses.replace(file, start=400, stop=1000))
    assert part.clip.num_frames == part.labels.num_frames == 300
    assert part.gait is not None and whole.gait is not None
    np.testing.assert_allclose(part.labels.phase, whole.labels.phase[200:500], atol=1e-9)
    np.testing.assert_allclose(part.gait, whole.gait[200:500], atol=1e-9)
    assert clip_features(part.clip, pfnn2017(31), part.labels, part.gait).x.shape[1] == 342


def test_a_clip_without_steps_loads_if_no_phase_is_needed(walk, mocap):
    labelled = load_labelled(ClipFile(walk, "proud"), phase=False)
    assert labelled.labels.num_frames == labelled.clip.num_frames and not labelled.labels.labelled.any()
    idle = next(clip for clip in list_clips(mocap / "100style") if clip.content == "idle")
    assert load_labelled(idle, phase=False).clip.content == "idle"
    with pytest.raises(NoGaitError):
        load_labelled(idle)


def test_labelling_does_not_change_the_clip(walk):
    clip_file = ClipFile(walk, "proud", "walk", start=10, stop=200)
    labelled, plain = load_labelled(clip_file, 30.0), load_clip(clip_file, fps=30.0)
    np.testing.assert_array_equal(labelled.clip.rotations, plain.rotations)
    assert (labelled.clip.style, labelled.clip.content) == (plain.style, plain.content) == ("proud", "walk")
