"""From the rows that a method returns to a clip on the content's own skeleton, blended with the content, feet held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pfnn_jax.control.ik.fix_feet import fix_feet
from pfnn_jax.errors import InputError
from pfnn_jax.motion.blending import Parts, blend_clips, part_weights
from pfnn_jax.motion.body_points import find_body_points
from pfnn_jax.motion.clip import MotionClip, resample
from pfnn_jax.motion.joint_rotations import rotations_from_positions
from pfnn_jax.motion.kinematics import (
    forward_kinematics,
    quat_conjugate,
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
)
from pfnn_jax.motion.labels.contacts import foot_contacts, foot_joints
from pfnn_jax.motion.retargeting.body import humanoid_of
from pfnn_jax.motion.retargeting.retarget import retarget
from pfnn_jax.motion.skeleton import Skeleton, need_roles
from pfnn_jax.motion.trajectory import Root
from pfnn_jax.transfer.clip_rows import clip_root, decode_rows, floor_height, prepare_clip
from pfnn_jax.transfer.layout import ClipLayout

MAX_STRENGTH = 1.5
"""Largest strength: half as much again as the result."""


def finish_clip(
    rows: np.ndarray,
    content: MotionClip,
    skeleton: Skeleton,
    layout: ClipLayout,
    *,
    strength: float = 1.0,
    parts: Parts = "all",
    foot_ik: bool = True,
) -> MotionClip:
    """Returns the content moved as rows say, on its own skeleton, at its own frame rate and with as many frames.

    What rows change on the run's skeleton is applied to the content's own rotations, so that what neither rows nor the
    run's skeleton show (fingers, twist, more joints) is kept, and rows of the content give back the content. Feet are
    then held where the content's are in contact.

    Args:
        rows: [T', D] in layout units, of the frames of `prepare_clip(content, skeleton)`; more frames are cut off.
        content: T frames of any humanoid.
        skeleton: of the run that the rows come from.
        layout: of the rows.
        strength: 0 is the content exactly, 1 the result, up to `MAX_STRENGTH` more than that.
        parts: of the body that change.
        foot_ik: whether feet are held.

    Raises:
        InputError: if strength, parts or the number of rows are out of range, rows are not finite, or a skeleton has no
            roles.
    """
    source = content.source or "clip"
    if not 0.0 <= strength <= MAX_STRENGTH:
        raise InputError(source, "strength", strength, f"must be from 0 to {MAX_STRENGTH:g}")
    weights, root_weight = part_weights(content.skeleton, parts, source)
    if strength == 0.0:
        return content
    result = clip_from_rows(rows, prepare_clip(content, skeleton), layout)
    moved = carry_over(content, prepare_clip(content, skeleton), result)
    blended = blend_clips(content, moved, strength * weights, strength * root_weight)
    return hold_feet(blended, content) if foot_ik and root_weight else blended


def clip_from_rows(rows: np.ndarray, content: MotionClip, layout: ClipLayout) -> MotionClip:
    """Returns the motion that rows describe, with rigid bones, beginning at the content's first root.

    Args:
        rows: [T, D] or more, in layout units.
        content: T frames at 60 fps on the run's skeleton: it decides what positions do not show.
        layout: of the rows.

    Raises:
        InputError: if there are fewer rows than frames, or a value is not finite.
    """
    source, count = content.source or "clip", content.num_frames
    if rows.ndim != 2 or len(rows) < count or rows.shape[1] != layout.size:
        raise InputError(source, "rows", f"shape {rows.shape}", f"must be at least {count} of {layout.size} numbers")
    if not np.isfinite(rows).all():
        raise InputError(source, "rows", "not finite", "must be finite numbers; the transfer diverged")
    before = clip_root(content)
    positions, root = decode_rows(np.asarray(rows[:count], float), layout, before)
    positions[..., 1] += floor_height(content)
    initial = _follow_root(content, before, root)
    points = find_body_points(content.skeleton, source)
    return rotations_from_positions(content.skeleton, points, positions, initial)


def carry_over(content: MotionClip, before: MotionClip, after: MotionClip) -> MotionClip:
    """Applies what changed between two motions on another skeleton to the content.

    Args:
        content: T frames on its own skeleton, at its own frame rate.
        before: the content on the other skeleton, at another frame rate.
        after: what became of it there.
    """
    old, new = (_as_content(clip, content) for clip in (before, after))
    hips = humanoid_of(content.skeleton).hips
    (old_joints, old_world), (new_joints, new_world), (joints, world) = (
        forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations) for clip in (old, new, content)
    )
    turned = quat_multiply(quat_multiply(new_world, quat_conjugate(old_world)), world)
    local = turned.copy()
    local[:, 1:] = quat_multiply(quat_conjugate(turned[:, content.skeleton.parents[1:]]), turned[:, 1:])
    local = np.where(np.sum(local * content.rotations, axis=-1, keepdims=True) < 0, -local, local)
    at_origin, _ = forward_kinematics(content.skeleton, np.zeros_like(content.root_positions), local)
    place = joints[:, hips] + new_joints[:, hips] - old_joints[:, hips]
    return replace(content, root_positions=place - at_origin[:, hips], rotations=local)


def hold_feet(clip: MotionClip, content: MotionClip) -> MotionClip:
    """Returns the clip with feet that do not slide where the content's are in contact.

    Args:
        clip: T frames.
        content: T frames on the same skeleton.
    """
    roles = need_roles(content.skeleton, content.source or "clip")
    positions, _ = forward_kinematics(content.skeleton, content.root_positions, content.rotations)
    contacts = foot_contacts(positions, roles, content.fps)
    floor = np.array([0.0, positions[:, foot_joints(roles), 1].min(), 0.0])
    held = fix_feet(replace(clip, root_positions=clip.root_positions - floor), contacts)
    return replace(held, root_positions=held.root_positions + floor)


def _follow_root(clip: MotionClip, before: Root, after: Root) -> MotionClip:
    """Returns a clip turned and moved on the ground in every frame as its root is."""
    turn = quat_from_yaw(after.yaw - before.yaw)
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat_multiply(turn, rotations[:, 0])
    offset = clip.root_positions.copy()
    offset[:, [0, 2]] -= before.positions
    positions = quat_rotate(turn, offset)
    positions[:, [0, 2]] += after.positions
    return replace(clip, root_positions=positions, rotations=rotations)


def _as_content(clip: MotionClip, content: MotionClip) -> MotionClip:
    """Returns a clip on the content's skeleton, at its frame rate and with as many frames; the last one is repeated."""
    moved = resample(retarget(clip, content.skeleton).clip, content.fps)
    frames = np.minimum(np.arange(content.num_frames), moved.num_frames - 1)
    return replace(moved, root_positions=moved.root_positions[frames], rotations=moved.rotations[frames])
