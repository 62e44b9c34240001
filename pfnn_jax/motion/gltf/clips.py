"""Reads a clip of a glTF file as a motion clip on the skeleton of its character."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.assumptions import decide_up
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.gltf.animations import Sampled, choose_clip, read_tracks, sample_nodes
from pfnn_jax.motion.gltf.character import Character, character_of, read_character
from pfnn_jax.motion.gltf.container import read_document
from pfnn_jax.motion.gltf.nodes import read_nodes
from pfnn_jax.motion.gltf.vrm import humanoid_nodes
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.tree import joint_tree
from pfnn_jax.motion.kinematics import forward_kinematics, joint_positions, quat_conjugate, quat_multiply
from pfnn_jax.motion.reading import Reading, ReadOptions, check_options
from pfnn_jax.motion.retargeting.body import body_joints
from pfnn_jax.motion.retargeting.reference import some_poses
from pfnn_jax.motion.roles import missing_roles, roles_of
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.up_axis import stand_up

RIG_FPS = 30.0
"""Frames per second of a character that stands for one frame."""

STRETCH = 0.05
"""Of a leg: joints that move away from where rigid bones carry them by more than this are noted."""


def read_gltf_clip(path: str | Path, options: ReadOptions, roles_file: str | Path | None = None) -> MotionClip:
    """Reads all frames of a clip of a `.glb`, `.gltf` or `.vrm` file, as `bvh.read_whole` does of a BVH file.

    Joint 0 is the hips: what moves above them (root, armature) moves them. Zero rotations are the bind pose. Scales and
    translations below the hips are left out, as bones are rigid.

    Args:
        path: file to read.
        options: what is known about the file. `clip_name` is the clip; None takes the only one that moves, or else the
            plain walk. Frames are those of the keys; `source_fps` plays them at another rate.
        roles_file: JSON object from bone or role to joint name, for joints that are found wrongly.

    Raises:
        InputError: for a malformed file, one without clip or humanoid, or a clip that is not there.
    """
    check_options(options, path)
    document = read_document(path)
    number, several = choose_clip(document, options.clip_name)
    joints: set[int] = set()
    if not document.items("skins"):  # exported without its mesh: what turns is a joint
        joints = {track.node for track in read_tracks(document, number) if track.path == "rotation"}
        joints |= set(humanoid_nodes(document).values())
        if not joints:
            raise InputError(document.path, f"animations[{number}]", "turns no node", "must animate joints")
    character = character_of(document, unit=options.metres, roles_file=roles_file, joints=joints)
    return clip_of(character, number, options, several, "" if roles_file is None else str(roles_file))


def read_gltf_rig(path: str | Path, options: ReadOptions, roles_file: str | Path | None = None) -> MotionClip:
    """Reads a character, with or without clips, as one frame of it in its bind pose.

    Joint 0 is the hips.

    Args:
        path: file to read.
        options: what is known about the file; of it the unit counts.
        roles_file: as in `read_gltf_clip`.

    Raises:
        InputError: as `read_character`.
    """
    check_options(options, path)
    character = read_character(path, unit=options.metres, roles_file=roles_file)
    skeleton, kept = below_hips(character.skeleton)
    rotations = np.zeros((1, skeleton.num_joints, 4))
    rotations[..., 0] = 1.0
    named_by = "" if roles_file is None else str(roles_file)
    reading = Reading(character.placement.scale, "y", RIG_FPS, 1, roles_file=named_by).noting(*character.notes)
    place = character.bind_positions[kept[:1]]
    return MotionClip(skeleton, RIG_FPS, place, rotations, source=str(path), reading=reading)


def clip_of(
    character: Character, number: int, options: ReadOptions | None = None, note: str = "", roles_file: str = ""
) -> MotionClip:
    """Returns a clip of a character's file.

    Args:
        character: as read from its file.
        number: of the clip.
        options: what is known about the file.
        note: on the choice of the clip.
        roles_file: name of the file that the character's map was read with.

    Raises:
        InputError: as `read_gltf_clip`.
    """
    options, document = options or ReadOptions(), character.document
    tree = read_nodes(document)
    skeleton, kept = below_hips(character.skeleton)
    tracks, place = read_tracks(document, number), f"animations[{number}]"
    sampled = sample_nodes(document, tree, tracks, character.nodes[kept].tolist(), place)
    placement = character.placement
    world = quat_multiply(
        quat_multiply(placement.rotation, sampled.rotations), quat_conjugate(character.bind_rotations[kept])
    )
    rotations = quat_multiply(quat_conjugate(world[:, skeleton.parents]), world)
    rotations[:, 0] = world[:, 0]
    positions = placement.to_ours(sampled.positions)
    fps = options.source_fps or sampled.fps
    body = skeleton.humanoid
    axis, lying = decide_up(joint_positions(skeleton, some_poses(rotations)), body, options)
    reading = Reading(placement.scale, axis, fps, len(rotations), roles_file=roles_file)
    clip = MotionClip(skeleton, fps, positions[:, 0], rotations, source=str(document.path), reading=reading)
    reading = reading.noting(note, *character.notes, lying, sampled.note, *_doubts(clip, positions, sampled))
    clip = stand_up(replace(clip, reading=reading), axis)
    return replace(clip, skeleton=replace(skeleton, poses=some_poses(clip.rotations)))


def below_hips(skeleton: Skeleton) -> tuple[Skeleton, np.ndarray]:
    """Returns the skeleton of the hips and all below them, and the indices [K] of its joints.

    Args:
        skeleton: with a humanoid map.
    """
    body = skeleton.humanoid
    assert body is not None
    if body.hips == 0:
        return skeleton, np.arange(skeleton.num_joints)
    tree = joint_tree(tuple(skeleton.parents.tolist()))
    kept = np.array(sorted({body.hips, *tree.below(body.hips)}))
    rows = {int(joint): row for row, joint in enumerate(kept)}
    body = body.move(rows.__getitem__)
    names = tuple(skeleton.names[joint] for joint in kept)
    offsets = skeleton.offsets[kept].copy()
    offsets[0] = 0.0
    part = Skeleton(
        names,
        np.array([rows.get(int(skeleton.parents[joint]), -1) for joint in kept]),
        offsets,
        tuple((rows[joint], site) for joint, site in skeleton.end_sites if joint in rows),
        np.array([rows.get(int(skeleton.mirror[joint]), rows[int(joint)]) for joint in kept]),
        roles=None if missing_roles(body) else roles_of(body, names),
        humanoid=body,
        resting_heights=skeleton.resting_heights,
    )
    return part, kept


def _doubts(clip: MotionClip, positions: np.ndarray, sampled: Sampled) -> list[str]:
    """Returns notes on what rigid bones cannot show of a clip.

    Args:
        clip: on rigid bones.
        positions: [T, J, 3] metres, of the joints in the file.
        sampled: the file's transforms.
    """
    body, skeleton = clip.skeleton.humanoid, clip.skeleton
    assert body is not None
    notes = ["the scales of joints change in the clip: they are left out"] if sampled.scaled else []
    joints = body_joints(body)
    rigid, _ = forward_kinematics(skeleton, clip.root_positions, clip.rotations)
    off = np.linalg.norm(rigid[:, joints] - positions[:, joints], axis=-1).max(axis=0)
    worst = int(np.argmax(off))
    if off[worst] > STRETCH * leg_length_of(skeleton, body):
        name = skeleton.names[joints[worst]]
        notes.append(f"bones change their lengths: with rigid ones {name} is up to {off[worst]:.2f} m off")
    return notes
