"""A small folder in the form of 100STYLE goes through preparation and training from the disk."""

from __future__ import annotations

import sys

import jax
import numpy as np
import pytest

from experiments.common.hundred_styles import ORDER, hundred_styles_skeleton, on_skeleton, plan_takes, write_folder
from experiments.common.measured_command import measure_command
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.kinematics import joint_positions
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.data import Rows
from pfnn_jax.training.pretraining import pretrain
from tests.training.toy import assert_bitwise

LENGTH = 0.08  # takes of 150 to 900 frames, of which the shortest have no whole window
RUNS_AND_WALKS = 7  # gaits of every style that layouts for locomotion take
ROUNDING = 1e-9  # metres
SPINE = 0.01  # metres: arms hang on four joints of the spine in place of two
FRAMES = 4.06e6  # of 100STYLE
MEGABYTE = 10**6

PROGRAM = """
import subprocess, sys, time
room = b"x" * 50_000_000
if sys.argv[1:]:
    subprocess.run([sys.executable, "-c", sys.argv[1]], check=True)
time.sleep(0.5)
"""

TINY = PretrainConfig(
    AdapterConfig("film"), hidden=8, num_control_points=2, gating_hidden=4, clips_per_batch=2, generator_filters=4,
    generator_width=5, generator_hidden=8, batch_size=8, steps=6, steps_per_dispatch=3,
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("size") / "clips"
    write_folder(folder, 2, LENGTH)
    return folder


@pytest.fixture(scope="module")
def dataset(folder, tmp_path_factory):
    config = PrepareConfig("mason2022", validation=0.1)
    return prepare(folder, tmp_path_factory.mktemp("size") / "dataset", config, workers=1)


def test_at_full_size_it_has_the_frames_of_100style():
    takes = list(plan_takes(100, 1.0, 0))
    assert sum(take.stop - take.start for take in takes) == pytest.approx(FRAMES, rel=1e-2)
    assert len({(take.style, take.gait) for take in takes}) == len(takes) == 100 * (RUNS_AND_WALKS + 1) + 10


def test_takes_are_listed_with_their_cuts_and_differ(folder):
    clips = list_clips(folder)
    assert {clip.style for clip in clips} == {"Walker000", "Walker001"}
    assert [clip.symmetric for clip in clips if clip.content == "walk"] == [False, True]
    assert all(clip.stop is not None and 0 < clip.start < clip.stop for clip in clips)
    assert len({clip.path.read_bytes() for clip in clips}) == len(clips)


def test_limbs_move_as_the_walkers_do():
    walk, _ = synthesise("neutral", np.full(40, 0.4), np.full(40, 1.2))
    clip = on_skeleton(walk)
    assert clip.skeleton.names == ORDER
    need_roles(hundred_styles_skeleton())

    def points(motion: MotionClip, *names: str) -> np.ndarray:
        own = joint_positions(motion.skeleton, motion.rotations) + motion.root_positions[:, None]
        return own[:, [motion.skeleton.names.index(name) for name in names]]

    legs, arms = points(clip, "LeftToe", "RightAnkle"), points(clip, "LeftWrist", "RightElbow")
    np.testing.assert_allclose(legs, points(walk, "LeftToeBase", "RightFoot"), atol=ROUNDING)
    np.testing.assert_allclose(arms, points(walk, "LeftHand", "RightForeArm"), atol=SPINE)


def test_all_walks_and_runs_are_prepared(dataset):
    assert dataset.layout.num_joints == len(ORDER) + 2  # the ends of the hands
    used = {clip["file"] for clip in dataset.clips}
    assert len(used) == 2 * RUNS_AND_WALKS and {skipped["reason"][:7] for skipped in dataset.skipped} == {"an idle"}


def test_training_from_the_disk_is_training_from_memory(dataset):
    stored = Rows.from_dataset(dataset, max_bytes=0)
    assert len(stored.parts) == 2
    disk, memory = (pretrain(rows, TINY) for rows in (stored, stored.in_memory()))
    assert_bitwise(disk.params, memory.params)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="other devices have memory of their own")
def test_rows_in_memory_are_not_copied_for_a_cpu_device(dataset):
    rows = Rows.from_dataset(dataset)
    for host, device in zip(*map(jax.tree.leaves, (rows.parts[0], rows.on_device())), strict=True):
        assert device.unsafe_buffer_pointer() == host.ctypes.data


def test_the_memory_of_a_command_includes_its_children(tmp_path):
    usage = measure_command([sys.executable, "-c", PROGRAM, PROGRAM], tmp_path / "log", interval=0.05)
    assert usage.exit_status == 0
    assert len(usage.peaks) == 2 and min(usage.peaks) > 50 * MEGABYTE
    assert 100 * MEGABYTE < usage.peak_own_bytes <= usage.peak_bytes <= sum(usage.peaks)


def test_a_failing_command_is_reported(tmp_path):
    assert measure_command([sys.executable, "-c", "import sys; sys.exit(3)"], tmp_path / "log").exit_status == 3
