"""Removal of foot sliding from a whole clip, by foot locking frame by frame."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.ik.foot_lock import FootLockConfig, initial_locks, lock_feet
from pfnn_jax.control.ik.limb import reach_arms
from pfnn_jax.control.ik.pose import Pose, Rig, make_rig
from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.labels.contacts import foot_contacts
from pfnn_jax.motion.skeleton import need_roles


def fix_feet(
    clip: MotionClip,
    contacts: np.ndarray | None = None,
    *,
    config: FootLockConfig | None = None,
    joints: np.ndarray | None = None,
) -> MotionClip:
    """Returns the clip with feet that do not slide.

    Args:
        clip: T frames of a skeleton with roles.
        contacts: [T, 4] in [0, 1], left heel, left toe, right heel, right toe, as a network predicts them; by default
            the labels of `motion.labels.contacts.foot_contacts`.
        config: of the locks; its `fps` is replaced by the clip's.
        joints: [T, J, 3] metres in the world; if given, arms are laid along these positions.

    Returns:
        A clip that differs in the rotations of hips, knees and ankles (joints of the legs), the height of its root,
        and the rotations of the arms where `joints` are given.

    Raises:
        InputError: if roles are missing, a leg has no knee, or an array does not fit the clip.
    """
    rig = make_rig(clip.skeleton, clip.source or "clip")
    if contacts is None:
        positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
        contacts = foot_contacts(positions, need_roles(clip.skeleton), clip.fps)
    shapes: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {
        "contacts": (np.shape(contacts), (clip.num_frames, 4))
    }
    if joints is not None:
        shapes["joints"] = (np.shape(joints), (clip.num_frames, rig.num_joints, 3))
    for name, (found, needed) in shapes.items():
        if found != needed:
            raise InputError(clip.source or "clip", name, f"shape {found}", f"must be {needed}")
    config = replace(config or FootLockConfig(), fps=float(clip.fps))
    # Computed near the origin, where float32 has the finest resolution.
    origin = clip.root_positions[0] * np.array([1.0, 0.0, 1.0])
    given = [clip.root_positions - origin, clip.rotations, contacts, *([] if joints is None else [joints - origin])]
    pose = _fix(rig, config, *(jnp.asarray(values, jnp.float32) for values in given))
    moved = np.asarray(pose.hips, np.float64) - given[0].astype(np.float32)
    return replace(clip, root_positions=clip.root_positions + moved, rotations=np.asarray(pose.rotations, np.float64))


@partial(jax.jit, static_argnums=(0, 1))
def _fix(
    rig: Rig,
    config: FootLockConfig,
    hips: jax.Array,
    rotations: jax.Array,
    contacts: jax.Array,
    joints: jax.Array | None = None,
) -> Pose:
    def frame(locks, row):
        hips, rotations, contacts, joints = row
        pose = Pose(hips=hips, rotations=rotations)
        pose = pose if joints is None else reach_arms(rig, pose, joints)
        pose, locks = lock_feet(rig, pose, contacts, locks, config)
        return locks, pose

    return jax.lax.scan(frame, initial_locks(rig), (hips, rotations, contacts, joints))[1]
