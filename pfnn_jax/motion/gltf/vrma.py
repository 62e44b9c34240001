"""Writes VRM animations (`.vrma`): a motion for every VRM avatar, by the names of its humanoid bones.

The file holds no body: bones of a person in T-pose, and keys of their rotations and of the hips' place.

Source: VRMC_vrm_animation 1.0.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax import __version__
from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.gltf.append import Animation, Channel, append_clips
from pfnn_jax.motion.gltf.container import Document
from pfnn_jax.motion.humanoid.map import SIDES, HumanoidMap
from pfnn_jax.motion.humanoid.overrides import VRM_BONES, VRM_SPINE
from pfnn_jax.motion.kinematics import forward_kinematics, quat_conjugate, quat_multiply
from pfnn_jax.motion.retargeting.body import humanoid_of
from pfnn_jax.motion.retargeting.cycle import retarget_closed
from pfnn_jax.motion.retargeting.reference import reference_pose
from pfnn_jax.motion.roles import assign_roles
from pfnn_jax.motion.root_motion import in_place
from pfnn_jax.motion.skeleton import Skeleton

EXTENSION = "VRMC_vrm_animation"

REQUIRED = (
    "hips", "spine", "head",
    *(f"{side}{part}" for side in SIDES
      for part in ("UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand")),
)  # fmt: skip
"""Bones that every VRM humanoid has."""


def vrma_bytes(clip: MotionClip, name: str, *, root_motion: bool = False) -> bytes:
    """Returns a VRM animation of a clip.

    Args:
        clip: T frames on any humanoid skeleton; a cycle (`cut_cycle`) stays one.
        name: of the animation.
        root_motion: let the hips travel; otherwise the motion is in place.

    Raises:
        InputError: if the skeleton has no humanoid map, or lacks a bone that every VRM humanoid has.
    """
    skeleton, height = vrm_skeleton(clip.skeleton, clip.source or "clip")
    moved = retarget_closed(clip, skeleton).clip
    moved = moved if root_motion else in_place(moved)
    channels = [Channel(0, "translation", moved.root_positions)]
    channels += [Channel(bone, "rotation", moved.rotations[:, bone]) for bone in range(skeleton.num_joints)]
    document = Document(Path(f"{name}.vrma"), _bones(skeleton, height), b"", ())
    return append_clips(document, [Animation(name, clip.fps, channels)])


def vrm_skeleton(skeleton: Skeleton, source: str = "skeleton") -> tuple[Skeleton, float]:
    """Returns the bones of a VRM humanoid with a skeleton's proportions, and the height of the hips in metres.

    Its zero pose is the T-pose of the skeleton, its joints are called as VRM calls them.

    Args:
        skeleton: any humanoid.
        source: file it comes from, for messages.

    Raises:
        InputError: if it has no humanoid map, or lacks a bone that every VRM humanoid has.
    """
    body = humanoid_of(skeleton, source)
    joints = _vrm_bones(body)
    if missing := [bone for bone in REQUIRED if bone not in joints]:
        rule = "a VRM humanoid must have it: name its joint in a roles file"
        raise InputError(source, "skeleton", f"no {', '.join(missing)}", rule)
    joints = {bone: joints[bone] for bone in sorted(joints, key=joints.get)}  # type: ignore[arg-type]
    places = _reference_places(skeleton, body)
    names, rows = tuple(joints), list(joints.values())
    parents = np.array([_bone_above(skeleton.parents, joint, rows) for joint in rows])
    offsets = np.where((parents >= 0)[:, None], places[rows] - places[np.array(rows)[parents]], 0.0)
    bare = Skeleton(names, parents, offsets, (), np.arange(len(rows)), resting_heights=skeleton.resting_heights)
    floor = min(places[joint, 1] for bone, joint in joints.items() if "Foot" in bone or "Toes" in bone)
    rest = 0.0 if skeleton.resting_heights is None else float(skeleton.resting_heights.min())
    return assign_roles(bare, source=source), float(places[body.hips, 1] - floor + rest)


def _vrm_bones(body: HumanoidMap) -> dict[str, int]:
    """Returns VRM bone -> joint of a map; of a long spine and neck the first, middle and last joint."""
    chain = body.spine if len(body.spine) < 3 else (body.spine[0], body.spine[len(body.spine) // 2], body.spine[-1])
    found: dict[str, int | None] = {"hips": body.hips, **dict(zip(VRM_SPINE, chain, strict=False)), "head": body.head}
    if body.neck:
        found["neck"] = body.neck[0]
    found |= {bone: getattr(body, own) for bone, own in VRM_BONES.items()}
    return {bone: joint for bone, joint in found.items() if joint is not None}


def _reference_places(skeleton: Skeleton, body: HumanoidMap) -> np.ndarray:
    """Returns the places [J, 3] of the joints in the reference pose, with the root at the origin."""
    world, parents = reference_pose(skeleton, body), skeleton.parents
    local = np.where((parents >= 0)[:, None], quat_multiply(quat_conjugate(world[parents]), world), world)
    return forward_kinematics(skeleton, np.zeros((1, 3)), local[None])[0][0]


def _bone_above(parents: np.ndarray, joint: int, rows: list[int]) -> int:
    """Returns the row of the nearest joint above one that is among `rows`, or -1."""
    joint = int(parents[joint])
    while joint >= 0 and joint not in rows:
        joint = int(parents[joint])
    return rows.index(joint) if joint >= 0 else -1


def _bones(skeleton: Skeleton, height: float) -> dict[str, Any]:
    """Returns the JSON of a file of bones in T-pose whose hips are at a height in metres."""
    nodes: list[dict[str, Any]] = []
    for bone, name in enumerate(skeleton.names):
        place = np.array([0.0, height, 0.0]) if bone == 0 else skeleton.offsets[bone]
        children = np.flatnonzero(skeleton.parents == bone).tolist()
        node: dict[str, Any] = {"name": name, "translation": [float(v) for v in place]}
        nodes.append({**node, "children": children} if children else node)
    bones = {name: {"node": bone} for bone, name in enumerate(skeleton.names)}
    return {
        "asset": {"version": "2.0", "generator": f"pfnn_jax {__version__}"},
        "extensionsUsed": [EXTENSION],
        "extensions": {EXTENSION: {"specVersion": "1.0", "humanoid": {"humanBones": bones}}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
    }
