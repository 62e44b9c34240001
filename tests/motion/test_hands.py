"""Hand ends as joints: the 25 joints of 100STYLE, and no change where a hand has no end."""

from __future__ import annotations

import dataclasses

import numpy as np

from pfnn_jax.motion.bvh import read_bvh, write_bvh
from pfnn_jax.motion.clip import mirror_clip
from pfnn_jax.motion.datasets.labelled import load_clip
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.datasets.target_skeleton import ends_in_hand_sites
from pfnn_jax.motion.features.layout import layout_for
from pfnn_jax.motion.hands import extend_hands
from pfnn_jax.motion.kinematics import forward_kinematics, quat_rotate
from pfnn_jax.motion.roles import find_roles
from tests.motion.skeletons import BODY, body, body_clip
from tests.raising import assert_refused

EXACT = 1e-12  # metres: float64 of numbers of order one
FILE = 1e-5  # metres: six decimals of a degree and of a centimetre in the file

JOINTS = (
    "Hips Chest Chest2 Chest3 Chest4 Neck Head RightCollar RightShoulder RightElbow RightWrist RightWristSite "
    "LeftCollar LeftShoulder LeftElbow LeftWrist LeftWristSite RightHip RightKnee RightAnkle RightToe LeftHip LeftKnee "
    "LeftAnkle LeftToe"
).split()
PARENTS = [-1, 0, 1, 2, 3, 4, 5, 4, 7, 8, 9, 10, 4, 12, 13, 14, 15, 0, 17, 18, 19, 0, 21, 22, 23]


def positions(clip):
    return forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)


def test_100style_has_the_25_joints_of_the_published_weights(mocap):
    clip = extend_hands(read_bvh(mocap / "100style" / "Neutral_ID.bvh"))
    assert list(clip.skeleton.names) == JOINTS and clip.skeleton.parents.tolist() == PARENTS
    assert layout_for("mason2022", clip.skeleton).ends == (16, 11, 24, 20)
    assert {joint for joint, _ in clip.skeleton.end_sites} == {6, 20, 24}


def test_bandai_has_no_hand_ends(mocap):
    clip = load_clip(list_clips(mocap / "bandai-namco-2")[0])
    assert extend_hands(clip) is clip and clip.skeleton.num_joints == 21


def test_hand_ends_are_at_the_end_sites():
    clip = body_clip()
    longer = extend_hands(clip)
    old, turns = positions(clip)
    new, _ = positions(longer)
    kept = [joint for joint, name in enumerate(longer.skeleton.names) if not name.endswith("Site")]
    np.testing.assert_allclose(new[:, kept], old, atol=EXACT)
    sites = dict(clip.skeleton.end_sites)
    for hand in (7, 11):
        joint = longer.skeleton.names.index(f"{BODY[hand][0]}Site")
        assert (
            longer.skeleton.names[joint - 1] == longer.skeleton.names[longer.skeleton.parents[joint]] == BODY[hand][0]
        )
        np.testing.assert_allclose(new[:, joint], old[:, hand] + quat_rotate(turns[:, hand], sites[hand]), atol=EXACT)


def test_roles_partners_and_other_end_sites_follow_their_joints():
    clip = body_clip()
    old, new = clip.skeleton, extend_hands(clip).skeleton
    assert new.roles == dataclasses.replace(
        find_roles(new), left_hand=new.names.index("l_handSite"), right_hand=new.names.index("r_handSite")
    )
    partners = {new.names[joint]: new.names[partner] for joint, partner in enumerate(new.mirror)}
    assert partners["l_handSite"] == "r_handSite" and partners["r_handSite"] == "l_handSite"
    assert {name: partners[name] for name in old.names} == dict(
        zip(old.names, (old.names[partner] for partner in old.mirror), strict=True)
    )
    assert [new.names[joint] for joint, _ in new.end_sites] == ["head", "l_toe", "r_toe"]


def test_extending_twice_or_a_mirrored_clip_changes_nothing():
    clip = body_clip()
    once = extend_hands(clip)
    again = extend_hands(once)
    assert again.skeleton.names == once.skeleton.names and again.skeleton.roles == once.skeleton.roles
    here, there = positions(extend_hands(mirror_clip(clip))), positions(mirror_clip(once))
    np.testing.assert_allclose(here[0], there[0], atol=EXACT)


def test_a_written_clip_reads_back_with_its_hands(tmp_path):
    clip = extend_hands(body_clip())
    write_bvh(tmp_path / "a.bvh", clip)
    back = read_bvh(tmp_path / "a.bvh", unit=0.01)
    extended = extend_hands(back)
    assert extended.skeleton.num_joints == clip.skeleton.num_joints and extended.skeleton.roles == clip.skeleton.roles
    np.testing.assert_allclose(positions(extended)[0], positions(clip)[0], atol=FILE)


def test_both_hand_ends_and_roles_are_needed():
    clip = body_clip()
    sites = tuple(site for site in clip.skeleton.end_sites if site[0] != 11)
    one = dataclasses.replace(clip, skeleton=dataclasses.replace(clip.skeleton, end_sites=sites))
    assert extend_hands(one) is one
    assert_refused(lambda: extend_hands(dataclasses.replace(clip, skeleton=body())), place="skeleton")


def test_hand_ends_are_recognised_by_structure_not_by_name():
    clip = body_clip()
    called = {"l_hand": "l_handSite", "r_hand": "r_handSite"}
    names = tuple(called.get(name, name) for name in clip.skeleton.names)
    assert not ends_in_hand_sites(dataclasses.replace(clip.skeleton, names=names))
    longer = extend_hands(clip).skeleton
    assert ends_in_hand_sites(longer) and not ends_in_hand_sites(clip.skeleton)
    names = tuple(name.replace("Site", "End") for name in longer.names)
    assert ends_in_hand_sites(dataclasses.replace(longer, names=names))
