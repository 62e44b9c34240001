"""Laws of retargeting frame by frame: it equals retargeting the whole clip, between any two skeletons."""

from __future__ import annotations

import numpy as np
import pytest

from pfnn_jax.motion.filters import moving_minimum
from pfnn_jax.motion.retargeting.retarget import make_retargeter, retarget, stance_frames
from tests.motion.retargeting import SOURCES, example, world

EXACT = 1e-9  # metres and units of quaternions: sums in another order

FRAMES = range(0, 60, 7)


@pytest.mark.parametrize(("source", "target"), list(zip(SOURCES, SOURCES[1:] + SOURCES[:1], strict=True)))
def test_a_frame_equals_that_of_the_clip(mocap, source, target):
    clip, skeleton = example(mocap, source), example(mocap, target).skeleton
    retargeter = make_retargeter(clip.skeleton, skeleton, clip=clip)
    positions, rotations = world(clip)
    floor = moving_minimum(retargeter.sole_heights(positions), stance_frames(clip.fps))
    expected = world(retarget(clip, skeleton).clip)
    for frame in FRAMES:
        placed, turned = retargeter.pose(positions[frame], rotations[frame], floor[frame])
        np.testing.assert_allclose(placed, expected[0][frame], atol=EXACT)
        np.testing.assert_allclose(turned, expected[1][frame], atol=EXACT)


def test_the_same_bones_keep_their_rotations_frame_by_frame(mocap):
    clip = example(mocap, SOURCES[0])
    retargeter = make_retargeter(clip.skeleton, clip.skeleton)
    positions, rotations = world(clip)
    placed, turned = retargeter.pose(positions[3], rotations[3], 0.0)
    np.testing.assert_array_equal(placed, positions[3])
    np.testing.assert_array_equal(turned, rotations[3])
