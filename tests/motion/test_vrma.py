"""Laws of VRM animations."""

from __future__ import annotations

import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.cycles import cut_cycle
from pfnn_jax.motion.gltf.vrma import REQUIRED, vrm_skeleton, vrma_bytes
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.retargeting.retarget import retarget
from pfnn_jax.motion.skeleton import rest_pose
from pfnn_jax.motion.synthetic.walks import synthesise
from tests.raising import assert_refused

SINGLE = 1e-5
"""Metres and quaternion components: keys are stored in single precision."""

LEVEL = np.deg2rad(15.0)
"""Arms of a T-pose are within this of the horizontal, whatever the clavicles do."""


@pytest.fixture(scope="module")
def walk() -> MotionClip:
    return synthesise("neutral", np.full(90, 0.3), np.full(90, 1.2))[0]


def parse(content: bytes) -> tuple[dict, bytes]:
    length = struct.unpack_from("<I", content, 12)[0]
    return json.loads(content[20 : 20 + length]), content[28 + length :]


def keys(data: dict, binary: bytes, node: int, path: str) -> np.ndarray:
    """Returns the keys of a node, [T, 3] or [T, 4] with w last."""
    (animation,) = data["animations"]
    (channel,) = (c for c in animation["channels"] if c["target"] == {"node": node, "path": path})
    accessor = data["accessors"][animation["samplers"][channel["sampler"]]["output"]]
    view, size = data["bufferViews"][accessor["bufferView"]], 4 if path == "rotation" else 3
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    return np.frombuffer(binary, "<f4", accessor["count"] * size, start).reshape(-1, size)


def test_every_bone_of_a_vrm_humanoid_is_named_and_keyed(walk: MotionClip):
    data, binary = parse(vrma_bytes(walk, "walk"))
    bones = data["extensions"]["VRMC_vrm_animation"]["humanoid"]["humanBones"]
    assert {*REQUIRED} <= {*bones}
    for bone in bones.values():
        assert len(keys(data, binary, bone["node"], "rotation")) == walk.num_frames


def test_bones_stand_in_a_t_pose(walk: MotionClip):
    skeleton, height = vrm_skeleton(walk.skeleton)
    places = dict(zip(skeleton.names, rest_pose(skeleton), strict=True))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        arm = places[f"{side}Hand"] - places[f"{side}UpperArm"]
        assert sign * arm[0] > np.cos(LEVEL) * np.linalg.norm(arm)
        leg = places[f"{side}Foot"] - places[f"{side}UpperLeg"]
        assert leg[1] < -np.cos(LEVEL) * np.linalg.norm(leg)
        assert places[f"{side}Toes"][2] > places[f"{side}Foot"][2]
    assert height > -places["leftFoot"][1]


def test_played_keys_are_the_retargeted_motion(walk: MotionClip):
    data, binary = parse(vrma_bytes(walk, "walk", root_motion=True))
    skeleton, _ = vrm_skeleton(walk.skeleton)
    turned = np.stack(
        [np.roll(keys(data, binary, bone, "rotation"), 1, axis=1) for bone in range(skeleton.num_joints)], axis=1
    )
    moved = retarget(walk, skeleton).clip
    played = forward_kinematics(skeleton, keys(data, binary, 0, "translation"), turned.astype(float))[0]
    wanted = forward_kinematics(skeleton, moved.root_positions, moved.rotations)[0]
    assert np.abs(played - wanted).max() < SINGLE


def test_a_cycle_stays_closed():
    cycle = cut_cycle(synthesise("neutral", np.full(180, 0.3), np.full(180, 1.2))[0])
    data, binary = parse(vrma_bytes(cycle, "walk"))
    assert np.abs(np.diff(keys(data, binary, 0, "translation")[[0, -1]], axis=0)).max() < SINGLE
    for bone in data["extensions"]["VRMC_vrm_animation"]["humanoid"]["humanBones"].values():
        first, last = keys(data, binary, bone["node"], "rotation")[[0, -1]]
        assert abs(abs(float(first @ last)) - 1.0) < SINGLE


def test_without_root_motion_the_hips_stay(walk: MotionClip):
    data, binary = parse(vrma_bytes(walk, "walk"))
    assert np.abs(keys(data, binary, 0, "translation")[:, [0, 2]]).max() < 0.2


def test_a_body_without_arms_is_refused(walk: MotionClip):
    body = walk.skeleton.humanoid
    assert body is not None
    none = {f"{side}_{part}": None for side in ("left", "right") for part in ("upper_arm", "lower_arm", "hand")}
    armless = replace(walk, skeleton=replace(walk.skeleton, humanoid=replace(body, **none)))
    assert_refused(lambda: vrma_bytes(armless, "walk"), place="skeleton", rule_mentions="VRM")
