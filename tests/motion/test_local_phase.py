"""Local phases: laws that any motion must obey, and what real walks show."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pfnn_jax.motion.clip import MotionClip, mirror_clip
from pfnn_jax.motion.datasets.labelled import load_clip
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.ground import wrap_angle
from pfnn_jax.motion.kinematics import quat_from_yaw, quat_multiply, quat_rotate
from pfnn_jax.motion.labels.local_phase import (
    EndEffectors,
    LocalPhaseConfig,
    PrincipalAxes,
    clip_local_phases,
    contact_source,
    end_effectors,
    fit_axes,
    local_phases,
    mirror_local_phases,
    principal_axis,
    source_functions,
    speeds,
    toe_contacts,
)
from pfnn_jax.motion.synthetic.walks import synthesise
from tests.raising import assert_refused

FPS = 60.0
ROUNDING = 1e-6  # phase vectors of motion that is equal but for rounding: the fit stops at 1e-11 of a window's power
LEFT_HAND, RIGHT_HAND, LEFT_TOE, RIGHT_TOE = range(4)


def angle(phases: np.ndarray) -> np.ndarray:
    """Phase of vectors [..., 2] as (sin, cos)."""
    return np.arctan2(phases[..., 0], phases[..., 1])


def swing(frequency: float, phase: float = 0.0, frames: int = 300) -> np.ndarray:
    return np.sin(2 * np.pi * frequency * np.arange(frames) / FPS + phase)


def arms(left: np.ndarray, right: np.ndarray) -> EndEffectors:
    """Hands that swing forwards by `left` and `right` metres next to the hips; toes stay on the ground."""
    local = np.zeros((len(left), 4, 3))
    local[:, LEFT_HAND] = np.stack([np.full_like(left, 0.3), 0.1 * left**2, left], axis=-1)
    local[:, RIGHT_HAND] = np.stack([np.full_like(left, -0.3), 0.1 * right**2, right], axis=-1)
    return EndEffectors(local + [0.0, 1.0, 0.0], local, FPS)


@pytest.fixture(scope="module")
def walk() -> MotionClip:
    return synthesise("neutral", np.linspace(-0.5, 0.5, 400), np.full(400, 1.2), seed=2)[0]


def test_a_sinusoid_has_its_own_phase_and_length():
    frequency, speed = 1.0, 1.7  # whole cycles in the second of the normalisation
    phases = local_phases(swing(frequency), np.full(300, speed), FPS)
    middle = slice(60, -60)  # a whole second of window on either side
    turned = wrap_angle(angle(phases) - 2 * np.pi * frequency * np.arange(300) / FPS)
    assert np.abs(turned[middle]).max() < 0.02
    length = np.linalg.norm(phases, axis=-1)[middle]
    np.testing.assert_allclose(length, np.sqrt(2) * speed, rtol=0.05)  # a std of 1 is an amplitude of √2


def test_a_later_source_has_a_later_phase():
    source = swing(1.0, frames=400) + 0.3 * swing(2.0, 0.4, 400)
    early, late = (local_phases(part, np.ones(350), FPS) for part in (source[20:370], source[:350]))
    np.testing.assert_allclose(late[90:-60], early[70:-80], atol=0.02)  # away from what the clips' ends change


@pytest.mark.parametrize("scale", [8.0, 1e-3, 1e6])
def test_scale_and_offset_of_the_source_do_not_matter(scale):
    source = swing(1.1) + 0.5 * swing(1.9, 1.0)
    phases = local_phases(source, np.ones(300), FPS)
    np.testing.assert_allclose(local_phases(scale * source + 3 * scale, np.ones(300), FPS), phases, atol=1e-4)


def test_alternating_arms_are_half_a_cycle_apart():
    way = 0.3 * swing(0.9)
    together, apart = clip_local_phases(arms(way, way)), clip_local_phases(arms(way, -way))
    np.testing.assert_allclose(together[:, LEFT_HAND], together[:, RIGHT_HAND], atol=ROUNDING)
    np.testing.assert_allclose(apart[:, LEFT_HAND], -apart[:, RIGHT_HAND], atol=ROUNDING)
    np.testing.assert_allclose(together[:, LEFT_HAND], apart[:, LEFT_HAND], atol=ROUNDING)


def test_a_bone_that_never_moves_has_length_zero():
    still = arms(np.zeros(200), 0.3 * swing(1.0, frames=200))
    phases = clip_local_phases(still)
    assert np.isfinite(phases).all()
    assert (phases[:, [LEFT_HAND, LEFT_TOE, RIGHT_TOE]] == 0).all()
    assert np.linalg.norm(phases[:, RIGHT_HAND], axis=-1).min() > 0.5


def test_noise_is_not_amplified_to_a_cycle():
    """A hand that trembles by a tenth of a millimetre: its source is normalised, its speed is not."""
    noise = 1e-4 * np.random.default_rng(0).normal(size=300).cumsum() / 10
    phases = clip_local_phases(arms(noise, 0.3 * swing(1.0)))
    length = np.linalg.norm(phases, axis=-1).mean(axis=0)
    assert length[LEFT_HAND] < 0.002 * length[RIGHT_HAND]


def test_phases_vanish_after_the_character_stops():
    way = 0.3 * swing(1.0, frames=600)
    way[300:] = way[300]
    length = np.linalg.norm(clip_local_phases(arms(way, way))[:, LEFT_HAND], axis=-1)
    # two windows of half a second and the tail of a smoothing of 4 Hz
    assert length[:240].min() > 0.5 and length[390:].max() < 1e-3


@pytest.mark.parametrize("frames", [1, 2, 4, 5, 20, 31, 32, 61])
def test_short_clips_have_finite_phases(frames):
    phases = clip_local_phases(arms(swing(1.0, frames=frames), swing(1.3, 1.0, frames)))
    assert phases.shape == (frames, 4, 2) and np.isfinite(phases).all()


def test_the_principal_axis_is_the_longest_and_points_forwards():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(500, 3)) * [0.1, 0.2, 1.0] + [3.0, 2.0, 1.0]
    axis, mean = principal_axis(points)
    np.testing.assert_allclose(mean, points.mean(axis=0))
    np.testing.assert_allclose(axis, [0, 0, 1], atol=0.05)
    assert np.linalg.norm(axis) == pytest.approx(1.0)
    for turned in (points * [1, 1, -1], -points):
        assert principal_axis(turned)[0][2] > 0.9
    sideways = np.array([[1.0, 0, 0], [2.0, 0, 0], [-4.0, 0, 0]])
    np.testing.assert_allclose(principal_axis(sideways)[0], [1, 0, 0])
    np.testing.assert_allclose(principal_axis(-sideways)[0], [1, 0, 0])


def test_axes_are_pooled_over_takes(walk):
    other = synthesise("neutral", np.zeros(300), np.full(300, 0.8), seed=3)[0]
    local = np.concatenate([end_effectors(clip).local for clip in (walk, other)])
    axes = fit_axes([walk, other])
    for bone in range(4):
        axis, mean = principal_axis(local[:, bone])
        np.testing.assert_array_equal(axes.directions[bone], axis)
        np.testing.assert_array_equal(axes.means[bone], mean)
    pooled, own = clip_local_phases(walk, axes=axes), clip_local_phases(walk)
    assert np.abs(pooled[:, :2] - own[:, :2]).max() > 0
    np.testing.assert_allclose(pooled[:, 2:], own[:, 2:], atol=ROUNDING)  # feet go by contacts


@pytest.mark.parametrize("style", ["neutral", "zombie", "old"])
def test_a_mirrored_clip_has_mirrored_phases(style):
    clip, _ = synthesise(style, np.linspace(-0.6, 0.4, 300), np.full(300, 1.0), seed=4)
    mirrored = clip_local_phases(mirror_clip(clip))
    np.testing.assert_allclose(mirrored, mirror_local_phases(clip_local_phases(clip)), atol=1e-4)


def test_mirroring_phases_twice_is_identity(walk):
    phases = clip_local_phases(walk)
    np.testing.assert_array_equal(mirror_local_phases(mirror_local_phases(phases)), phases)
    np.testing.assert_array_equal(mirror_local_phases(phases)[:, LEFT_HAND], phases[:, RIGHT_HAND])


def test_the_same_clip_gives_the_same_phases(walk):
    np.testing.assert_array_equal(clip_local_phases(walk), clip_local_phases(walk))
    np.testing.assert_array_equal(clip_local_phases(end_effectors(walk)), clip_local_phases(walk))


def test_phases_are_invariant_under_rigid_motion_on_the_ground(walk):
    turn = quat_from_yaw(2.0)
    rotations = walk.rotations.copy()
    rotations[:, 0] = quat_multiply(turn, rotations[:, 0])
    positions = quat_rotate(turn, walk.root_positions) + [5.0, 0.7, -3.0]
    moved = dataclasses.replace(walk, root_positions=positions, rotations=rotations)
    np.testing.assert_allclose(clip_local_phases(moved), clip_local_phases(walk), atol=1e-4)


def test_a_rig_whose_hips_are_turned_gives_the_same_local_frame(walk):
    """Another rig's hip bone may have any axes: only joints' positions count."""
    skeleton, turn = walk.skeleton, quat_from_yaw(1.1)
    back = turn * [1, -1, -1, -1]
    rotations, offsets = walk.rotations.copy(), skeleton.offsets.copy()
    below = skeleton.parents == 0
    rotations[:, 0] = quat_multiply(rotations[:, 0], turn)
    rotations[:, below] = quat_multiply(back, rotations[:, below])
    offsets[below] = quat_rotate(back, offsets[below])
    rig = dataclasses.replace(walk, skeleton=dataclasses.replace(skeleton, offsets=offsets), rotations=rotations)
    np.testing.assert_allclose(end_effectors(rig).local, end_effectors(walk).local, atol=1e-12)


def test_toes_are_in_contact_during_their_half_of_the_phase():
    clip, labels = synthesise("neutral", np.zeros(400), np.full(400, 1.2))
    right, left = toe_contacts(clip).T
    middle_right, middle_left = (np.abs(labels.phase - centre) < 0.4 for centre in (0.5 * np.pi, 1.5 * np.pi))
    assert right[middle_right].mean() > 0.95 and right[middle_left].mean() < 0.05
    assert left[middle_left].mean() > 0.95 and left[middle_right].mean() < 0.05


def test_contacts_do_not_change_with_the_height_of_the_floor(walk):
    ends = end_effectors(walk)
    raised = dataclasses.replace(ends, world=ends.world + [0.0, 0.4, 0.0])
    np.testing.assert_array_equal(toe_contacts(raised), toe_contacts(ends))


def test_contacts_need_both_height_and_speed():
    points = np.zeros((120, 3))
    points[40:60, 1] = 0.05  # held still above the ground
    points[80:, 0] = np.cumsum(np.full(40, 0.01))  # slides at 0.6 m/s
    contact = contact_source(points, FPS)
    assert contact[:38].all() and not contact[42:58].any() and contact[62:78].all() and not contact[82:].any()
    loose = contact_source(points, FPS, LocalPhaseConfig(max_height=0.1, max_speed=1.0))
    assert loose[62:].all()


def test_the_majority_filter_removes_short_gaps():
    points = np.zeros((120, 3))
    points[60:62, 1] = 0.05
    assert not contact_source(points, FPS).all()
    assert contact_source(points, FPS, LocalPhaseConfig(majority_seconds=5 / 60)).all()


def test_a_foot_without_contacts_uses_its_movement_as_source(walk):
    """As in hopping on one leg: the other foot swings but never touches the ground."""
    ends = end_effectors(walk)
    world = ends.world.copy()
    world[:, LEFT_TOE, 0] += 0.02 * np.arange(len(world))  # never slow
    hop = dataclasses.replace(ends, world=world)
    axes = fit_axes([hop])
    sources = source_functions(hop, axes)
    assert set(np.unique(sources[:, RIGHT_TOE])) == {0.0, 1.0}
    np.testing.assert_allclose(
        sources[:, LEFT_TOE], (ends.local[:, LEFT_TOE] - axes.means[LEFT_TOE]) @ axes.directions[LEFT_TOE]
    )
    assert np.linalg.norm(clip_local_phases(hop)[:, LEFT_TOE], axis=-1).mean() > 0.5


def test_tips_are_end_sites_where_there_are_any(walk):
    roles = walk.skeleton.roles
    assert roles is not None
    with_site = dataclasses.replace(walk.skeleton, end_sites=((roles.left_hand, np.array([0.1, 0.0, 0.0])),))
    without = dataclasses.replace(walk.skeleton, end_sites=())
    one, other = (end_effectors(dataclasses.replace(walk, skeleton=s)).world for s in (with_site, without))
    np.testing.assert_allclose(np.linalg.norm(one - other, axis=-1)[0], [0.1, 0, 0, 0], atol=1e-12)


def test_a_skeleton_without_roles_is_refused(walk):
    skeleton = dataclasses.replace(walk.skeleton, roles=None)
    assert_refused(lambda: clip_local_phases(dataclasses.replace(walk, skeleton=skeleton)), place="skeleton")


@pytest.mark.parametrize("setting", [{"max_height": 0.0}, {"max_speed": -1.0}, {"majority_seconds": -0.1}])
def test_settings_are_checked(setting):
    with pytest.raises(ValueError, match="LocalPhaseConfig"):
        LocalPhaseConfig(**setting)


def test_axes_belong_to_the_four_bones(walk):
    axes = fit_axes([walk])
    assert isinstance(axes, PrincipalAxes)
    assert axes.directions.shape == axes.means.shape == (4, 3)
    assert (axes.directions[:, 2] > 0.5).all()  # in a walk everything swings forwards and back


def test_speeds_of_a_single_frame_are_zero():
    assert speeds(np.ones((1, 3)), FPS).tolist() == [0.0]


@pytest.fixture(scope="module")
def angry(mocap) -> MotionClip:
    return load_clip(next(file for file in list_clips(mocap / "100style") if file.style.lower() == "angry"))


def test_toes_of_a_real_walk_are_near_phase_zero_at_contact(angry):
    phases, contacts = clip_local_phases(angry), toe_contacts(angry)
    for bone, contact in ((RIGHT_TOE, contacts[:, 0]), (LEFT_TOE, contacts[:, 1])):
        onsets = np.flatnonzero(np.diff(contact.astype(int)) == 1) + 1
        # clear onsets: a tenth of a second without contact, then a tenth of a second of it
        clear = [i for i in onsets if not contact[max(i - 6, 0) : i].any() and contact[i : i + 6].all()]
        mean = np.exp(1j * angle(phases[clear, bone])).mean()
        assert len(clear) > 50
        assert 0.0 < np.angle(mean) < 0.4 and np.abs(mean) > 0.95  # 0.2 to 0.3 in what the authors' network makes


def test_phases_of_a_recorded_walk_increase_without_jumps(angry):
    phases = clip_local_phases(angry)
    length, step = np.linalg.norm(phases, axis=-1), wrap_angle(np.diff(angle(phases), axis=0))
    clear = length[1:] > 0.5 * np.median(length, axis=0)
    for bone in range(4):
        assert (step[clear[:, bone], bone] < 0).mean() < 0.01
        assert np.abs(step[clear[:, bone], bone]).max() < 0.45  # 4 Hz, the fastest fit, is 0.42 a frame
        assert 0.9 < np.median(step[:, bone]) * FPS / (2 * np.pi) < 1.5  # strides a second


def test_lengths_of_real_walks_and_runs_are_like_the_published_statistics(mocap, reference):
    published = np.fromfile(reference / "lpn" / "GT_Xstd.bin", "<f4")
    files = [file for file in list_clips(mocap / "100style") if file.content != "idle"]
    spread = [clip_local_phases(load_clip(file)).reshape(-1, 8).std(axis=0) for file in files]
    # theirs are over 95 styles: a slow and an angry walk and a run lie on both sides of them
    assert (np.min(spread, axis=0) < published).all() and (np.max(spread, axis=0) > published).all()
    assert (np.mean(spread, axis=0) / published < 1.5).all() and (np.mean(spread, axis=0) / published > 0.5).all()
