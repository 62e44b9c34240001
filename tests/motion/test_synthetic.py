"""Laws of the procedural walkers: feet planted, bones rigid, phase and path exact, and plausible for every style."""

from __future__ import annotations

import numpy as np
import pytest

from pfnn_jax.motion.bvh import read_bvh, write_bvh
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.synthetic import walks as synthetic
from pfnn_jax.motion.synthetic.body import STANDING
from pfnn_jax.motion.synthetic.skeleton import SHIN, THIGH

EXACT = 1e-12  # metres: float64 rounding over positions of tens of metres and chains of eight joints
WRITTEN = 1e-5  # metres: six decimals of centimetres and degrees
FPS = 60
EVERY_STYLE = pytest.mark.parametrize("style", list(synthetic.STYLES))
RANGE = [(speed, turn) for speed in (0.6, 1.2, 1.8) for turn in (-60.0, 0.0, 60.0)]  # m/s, degrees/s


def walk(style, speed=1.0, turn=0.0, seconds=4.0, seed=0):
    frames = int(seconds * FPS)
    return synthetic.synthesise(style, np.full(frames, np.deg2rad(turn)), np.full(frames, speed), fps=FPS, seed=seed)


def joints(clip: MotionClip) -> np.ndarray:
    return forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0]


def feet_of(clip: MotionClip) -> np.ndarray:
    roles = clip.skeleton.roles
    assert roles is not None
    return joints(clip)[:, [*roles.left_foot, *roles.right_foot]]


def test_a_clip_is_the_same_after_writing_and_reading_it_as_bvh(tmp_path):
    clip, _ = walk("zombie", 0.8, 30.0, seconds=1.0)
    write_bvh(tmp_path / "zombie.bvh", clip)
    read = read_bvh(tmp_path / "zombie.bvh")
    assert read.skeleton.names == clip.skeleton.names and read.skeleton.roles == clip.skeleton.roles
    np.testing.assert_allclose(joints(read), joints(clip), atol=WRITTEN)


def test_there_are_eight_styles_and_a_held_out_ninth():
    assert len(synthetic.PRETRAINING_STYLES) == 8
    assert list(synthetic.STYLES) == [*synthetic.PRETRAINING_STYLES, synthetic.UNSEEN_STYLE]


def test_the_skeleton_is_mirror_symmetric_and_person_sized():
    skeleton = synthetic.synthetic_skeleton()
    mirror = skeleton.mirror
    np.testing.assert_array_equal(mirror[mirror], np.arange(skeleton.num_joints))
    np.testing.assert_array_equal(skeleton.offsets[mirror], skeleton.offsets * [-1, 1, 1])
    assert all(skeleton.parents[j] < j for j in range(skeleton.num_joints))
    identity = np.zeros((1, skeleton.num_joints, 4))
    identity[..., 0] = 1.0
    rest, _ = forward_kinematics(skeleton, np.array([[0.0, STANDING, 0.0]]), identity)
    crown = rest[0, :, 1].max() + max(offset[1] for _, offset in skeleton.end_sites)
    assert 1.6 < crown < 1.85
    assert rest[0, :, 1].min() == pytest.approx(0.02)  # the toe joint, 2 cm over the sole


@EVERY_STYLE
@pytest.mark.parametrize(("speed", "turn"), RANGE)
def test_planted_feet_do_not_move_and_bones_keep_their_lengths(style, speed, turn):
    clip, labels = walk(style, speed, turn)
    contacts = synthetic.stance_contacts(synthetic.STYLES[style], labels.phase)
    both = contacts[1:] & contacts[:-1]
    moved = np.linalg.norm(np.diff(feet_of(clip), axis=0), axis=-1)
    assert both.mean() > 0.25
    assert moved[both].max() < EXACT
    positions, parents = joints(clip), clip.skeleton.parents
    lengths = np.linalg.norm(positions[:, 1:] - positions[:, parents[1:]], axis=-1)
    np.testing.assert_allclose(lengths, np.linalg.norm(clip.skeleton.offsets[1:], axis=-1) + 0 * lengths, atol=EXACT)


@EVERY_STYLE
@pytest.mark.parametrize(("speed", "turn"), RANGE)
def test_legs_reach_knees_bend_forward_and_feet_stay_above_ground(style, speed, turn):
    clip, _ = walk(style, speed, turn)
    positions, roles = joints(clip), clip.skeleton.roles
    assert roles is not None
    for hip, (ankle, _) in ((roles.left_hip, roles.left_foot), (roles.right_hip, roles.right_foot)):
        reach = np.linalg.norm(positions[:, ankle] - positions[:, hip], axis=-1)
        assert reach.max() < THIGH + SHIN
        knee = clip.skeleton.parents[ankle]
        bend = positions[:, knee] - (positions[:, hip] + positions[:, ankle]) / 2
        across = np.cross([0.0, 1.0, 0.0], positions[:, roles.left_hip] - positions[:, roles.right_hip])
        assert (bend * -across).sum(axis=-1).min() > 0
    assert feet_of(clip)[..., 1].min() > -EXACT
    hips = positions[:, roles.hips, 1]
    assert hips.min() > 0.6 and hips.max() < STANDING


@EVERY_STYLE
def test_phase_is_zero_at_right_contact_and_pi_at_left(style):
    parameters = synthetic.STYLES[style]
    clip, labels = walk(style, parameters.speed, 30.0, seconds=8.0)
    assert labels.labelled.all() and len(labels.phase) == clip.num_frames
    assert np.all((labels.phase >= 0) & (labels.phase < 2 * np.pi))
    step = 2 * np.pi * parameters.cadence / FPS  # a frame's worth of phase: contacts fall between frames
    assert np.all(labels.phase[labels.contacts_right] <= step * 1.01)
    assert np.all(np.abs(labels.phase[labels.contacts_left] - np.pi - step / 2) <= step * 0.51)
    contacts = synthetic.stance_contacts(parameters, labels.phase)
    for column, frames in ((0, labels.contacts_left), (2, labels.contacts_right)):
        lands = np.flatnonzero(contacts[1:, column] & ~contacts[:-1, column]) + 1
        np.testing.assert_array_equal(lands, frames)


def test_only_the_swinging_foot_moves():
    clip, labels = walk("neutral", 1.25)
    speed = np.linalg.norm(np.diff(feet_of(clip), axis=0), axis=-1) * FPS
    left_swing = np.abs(labels.phase[:-1] - 0.5 * np.pi) < 0.2  # halfway to its contact at π
    assert speed[left_swing, 0].min() > 1.0
    assert speed[left_swing, 2].max() < EXACT * FPS


@EVERY_STYLE
@pytest.mark.parametrize("turn", [-60.0, 25.0])
def test_the_body_follows_the_commanded_path(style, turn):
    seconds, speed = 6.0, synthetic.STYLES[style].speed
    clip, labels = walk(style, speed, turn, seconds)
    rate = np.deg2rad(turn)
    yaw = rate * np.arange(clip.num_frames) / FPS
    path = speed / rate * np.stack([1 - np.cos(yaw), np.sin(yaw)], axis=-1)
    hips = joints(clip)[:, 0][:, [0, 2]]
    assert np.linalg.norm(hips - path, axis=-1).max() < 0.25  # they sway, and move back under a bent trunk
    across = joints(clip)[:, clip.skeleton.names.index("LeftUpLeg")] - joints(clip)[:, 0]
    facing = np.unwrap(np.arctan2(-across[:, 2], across[:, 0]))
    assert np.abs(facing - yaw).max() < np.deg2rad(synthetic.STYLES[style].hip_yaw * 1.35 + 6)


def test_the_walk_starts_at_the_origin_facing_forward_whatever_the_schedule():
    turn = np.deg2rad(np.linspace(-60, 60, 300))
    clip, _ = synthetic.synthesise("strutting", turn, np.linspace(0.6, 1.8, 300), seed=4)
    assert np.abs(clip.root_positions[0, [0, 2]]).max() < 0.15


def test_equal_seeds_repeat_and_different_seeds_differ():
    first, again, other = (walk("angry", seed=seed)[0] for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.rotations, again.rotations)
    assert np.abs(first.rotations - other.rotations).max() > 1e-3


def test_styles_are_far_apart_compared_with_their_irregularity():
    """Mean poses in the hips' frame differ by centimetres between styles, by millimetres between seeds."""

    def mean_pose(style, seed):
        clip, _ = walk(style, 1.0, seconds=10.0, seed=seed)
        positions = joints(clip)
        return (positions - positions[:, :1] * [1, 0, 1]).mean(axis=0)

    poses = {style: mean_pose(style, 0) for style in synthetic.STYLES}
    within = max(np.linalg.norm(mean_pose(s, 1) - poses[s], axis=-1).mean() for s in ("neutral", "zombie"))
    names = list(poses)
    between = [np.linalg.norm(poses[a] - poses[b], axis=-1).mean() for i, a in enumerate(names) for b in names[i + 1 :]]
    assert min(between) > 2.0 * within


def test_motion_is_smooth():
    clip, _ = walk("neutral", 1.25, 20.0)
    acceleration = np.linalg.norm(np.diff(joints(clip), n=2, axis=0), axis=-1) * FPS**2
    assert acceleration[:, 0].max() < 15.0  # m/s²; hips of people who walk stay near 10
    assert acceleration.max() < 90.0  # ankles at contact


def test_mixed_clips_cover_turns_speeds_and_the_given_time():
    clips = synthetic.synthetic_clips("old", 40.0, seed=2)
    assert sum(labelled.clip.num_frames for labelled in clips) == pytest.approx(40 * FPS, abs=len(clips))
    assert all(len(labelled.labels.phase) == labelled.clip.num_frames for labelled in clips)
    schedules = [synthetic.mixed_schedule("old", 60.0, seed) for seed in range(3)]
    turn, speed = (np.concatenate(part) for part in zip(*schedules, strict=True))
    assert turn.min() < -np.deg2rad(35) and turn.max() > np.deg2rad(35)
    assert np.mean(np.abs(turn) < np.deg2rad(5)) > 0.1
    assert np.abs(turn).max() <= synthetic.FASTEST_TURN and speed.max() <= 1.8


@pytest.mark.parametrize(
    ("turn", "speed", "message"),
    [
        (np.zeros(3), np.zeros(4), "equally long"),
        (np.zeros(1), np.zeros(1), "at least 2"),
        (np.zeros(3), np.full(3, -1.0), "not negative"),
        (np.full(3, np.nan), np.ones(3), "finite"),
    ],
)
def test_bad_schedules_are_refused(turn, speed, message):
    with pytest.raises(ValueError, match=message):
        synthetic.synthesise("neutral", turn, speed)


def test_unknown_styles_and_bad_parameters_are_refused():
    with pytest.raises(ValueError, match="limp.*neutral, proud"):
        walk("limp")
    with pytest.raises(ValueError, match="SyntheticStyle.duty"):
        synthetic.SyntheticStyle("hopping", duty=0.3)
    with pytest.raises(ValueError, match="SyntheticStyle.heel_off"):
        synthetic.SyntheticStyle("flat", heel_off=1.0)
    with pytest.raises(ValueError, match="SyntheticStyle.cadence"):
        synthetic.SyntheticStyle("still", cadence=0.0)


def test_speed_zero_is_stepping_in_place():
    clip, labels = walk("neutral", 0.0)
    assert np.abs(clip.root_positions[:, [0, 2]]).max() < 0.15
    assert len(labels.contacts_right) > 0 and np.isfinite(clip.rotations).all()
