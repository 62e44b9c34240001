"""Left-right partners, and mirroring by them, on skeletons whose rest frames are not symmetric."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.clip import MotionClip, mirror_clip
from pfnn_jax.motion.humanoid.find import find_humanoid, need_humanoid
from pfnn_jax.motion.humanoid.map import ARM, LEG
from pfnn_jax.motion.humanoid.pairs import find_mirror
from pfnn_jax.motion.kinematics import quat_conjugate, quat_multiply, quat_normalise, quat_rotate
from pfnn_jax.motion.roles import assign_roles
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.motion.world_motion import world_motion
from tests.motion.rigs import bvh_skeleton, without_names
from tests.motion.skeletons import MIRROR, body

EXACT = 1e-9  # metres: float64 chains, and the fit of rest frames
PRINTED = 1e-4  # metres: offsets of files have about six digits
REFLECTION = np.array([-1.0, 1.0, 1.0])


def with_rest_frames(clip: MotionClip, frames: np.ndarray) -> MotionClip:
    """The same motion on a skeleton whose joints have other axes.

    Args:
        clip: T frames of J joints.
        frames: [J, 4] rotation from each joint's new axes to its old ones.
    """
    parents = clip.skeleton.parents
    outer = np.where(parents[:, None] >= 0, quat_conjugate(frames[parents]), [1.0, 0.0, 0.0, 0.0])
    offsets = quat_rotate(quat_conjugate(frames[parents]), clip.skeleton.offsets)
    offsets[0] = 0.0
    rotations = quat_multiply(quat_multiply(outer, clip.rotations), frames)
    return replace(clip, skeleton=replace(clip.skeleton, offsets=offsets), rotations=rotations)


def mirror_error(clip: MotionClip) -> np.ndarray:
    """Distances [T, J] in metres from the joints of the mirrored clip to the reflected joints of the clip."""
    found = world_motion(mirror_clip(clip)).positions
    return np.linalg.norm(found - world_motion(clip).positions[:, clip.skeleton.mirror] * REFLECTION, axis=-1)


@pytest.fixture(scope="module")
def walk() -> MotionClip:
    return synthesise("proud", np.full(120, 0.4), np.full(120, 1.2), seed=3)[0]


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), spread=st.just(0.0) | st.floats(1e-3, 3.0))
def test_mirroring_is_exact_whatever_the_rest_frames_are(walk, seed, spread):
    random = np.random.default_rng(seed)
    frames = quat_normalise(random.normal(size=(walk.skeleton.num_joints, 4)) * [1.0, spread, spread, spread])
    clip = with_rest_frames(walk, frames)
    np.testing.assert_allclose(world_motion(clip).positions, world_motion(walk).positions, atol=EXACT)
    assert mirror_error(clip).max() < EXACT
    twice = world_motion(mirror_clip(mirror_clip(clip)))
    np.testing.assert_allclose(twice.positions, world_motion(clip).positions, atol=EXACT)
    np.testing.assert_allclose(
        world_motion(clip).mirror().positions, world_motion(mirror_clip(clip)).positions, atol=EXACT
    )


def test_mirrored_bones_keep_their_length_where_sides_differ(walk):
    offsets = walk.skeleton.offsets.copy()
    left = walk.skeleton.names.index("LeftLeg")
    offsets[left] *= 1.05
    clip = replace(walk, skeleton=replace(walk.skeleton, offsets=offsets))
    excess = np.linalg.norm(offsets[left]) * (1 - 1 / 1.05)
    assert mirror_error(clip).max() == pytest.approx(excess)


@pytest.mark.parametrize(
    "name",
    ["makehuman_walk_pairs", "makehuman_walk_decimetres", "slimevr_head_root", "mixamorig_colon", "sway", "dfki_walk"]
    + ["rokoko_dance", "univrm", "child5_inches", "no_namespace"],
)
def test_mirroring_recorded_skeletons_is_exact(mocap, name):
    assert mirror_error(read_bvh(mocap / "field" / f"{name}.bvh")).max() < PRINTED


def test_feet_mirror_exactly_where_only_helper_joints_differ(mocap):
    """The joints of this file's meshes lie elsewhere on the left than on the right."""
    clip = read_bvh(mocap / "field" / "mass_walk.bvh")
    humanoid = need_humanoid(clip.skeleton)
    joints = [joint for side in ("left", "right") for joint in humanoid.limb(side, LEG + ARM) if joint is not None]
    assert mirror_error(clip)[:, joints].max() < PRINTED


@pytest.mark.parametrize(
    "name", ["makehuman_walk_pairs", "mass_walk", "slimevr_head_root", "mixamorig_colon", "wham", "cgspeed_daz"]
)
def test_the_limbs_of_a_map_are_partners(mocap, name):
    skeleton = read_bvh(mocap / "field" / f"{name}.bvh").skeleton
    humanoid = need_humanoid(skeleton)
    for limb in (LEG, ARM):
        for left, right in zip(humanoid.limb("left", limb), humanoid.limb("right", limb), strict=True):
            assert left is None or skeleton.mirror[left] == right
    on_midline = {skeleton.names[j] for j in np.flatnonzero(skeleton.mirror == np.arange(skeleton.num_joints))}
    sided = ("left", "right", "_l", "_r", "l_", "r_", ".l", ".r")
    assert not [
        joint for joint in on_midline if joint.lower().startswith(sided[:2]) or joint.lower().endswith(sided[2:4])
    ]


def test_a_connecting_joint_is_not_taken_for_the_joint_below_it(mocap):
    skeleton = read_bvh(mocap / "field" / "makehuman_walk_pairs.bvh").skeleton
    partner = {name: skeleton.names[joint] for name, joint in zip(skeleton.names, skeleton.mirror, strict=True)}
    assert partner["__UpLeg_L"] == "__UpLeg_R" and partner["UpLeg_L"] == "UpLeg_R"
    assert partner["Index3_L"] == "Index3_R" and partner["Head"] == "Head"


def test_partners_are_found_by_the_map_where_names_have_no_sides():
    skeleton = assign_roles(without_names(body()))
    np.testing.assert_array_equal(skeleton.mirror, MIRROR)
    np.testing.assert_array_equal(find_mirror(without_names(body())), np.arange(20))  # without a map nothing tells


PREFIXES: dict[str, Callable[[str, int], str]] = {
    "of all": lambda name, _: f"Character1_{name}",
    "of most": lambda name, at: f"Character1_{name}" if at % 5 < 3 else name,
    "namespace of most": lambda name, at: f"rig:{name}" if at % 10 < 7 else name,
    "without separator": lambda name, _: f"mixamorig{name}",
    "of a biped": lambda name, _: f"Bip01 {name}",
}


@pytest.mark.parametrize("prefix", PREFIXES)
@pytest.mark.parametrize("name", ["makehuman_walk_pairs", "mass_walk", "wham", "kimodo_soma_elderly", "univrm"])
def test_prefixes_of_exporters_change_no_pairs(mocap, name, prefix):
    skeleton = bvh_skeleton(mocap / "field" / f"{name}.bvh")
    names = tuple(PREFIXES[prefix](each, at) for at, each in enumerate(skeleton.names))
    other = replace(skeleton, names=names)
    body, expected = find_humanoid(other), find_humanoid(skeleton)
    assert body.joints() == expected.joints()
    np.testing.assert_array_equal(find_mirror(other, body), find_mirror(skeleton, expected))
