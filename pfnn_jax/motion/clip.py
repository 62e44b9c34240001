"""One take of motion: the record, and operations on all of it (cut, resample, mirror)."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.kinematics import quat_multiply, quat_slerp, quat_to_matrix
from pfnn_jax.motion.reading import Reading
from pfnn_jax.motion.skeleton import Skeleton

ON_FRAME = 1e-6  # of a frame: a new frame this close to an old one takes its values exactly
ASYMMETRY = 0.1  # share of a joint's bone lengths by which left and right may differ in real skeletons
REFLECTIONS = np.array([[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0], [-1.0, -1.0, -1.0]])
WORLD_REFLECTION = REFLECTIONS[0]  # x to -x


@dataclass(frozen=True, eq=False)
class MotionClip:
    """One take of motion on one skeleton.

    Attributes:
        skeleton: the joints.
        fps: frames per second.
        root_positions: [T, 3] metres, world position of joint 0.
        rotations: [T, J, 4] wxyz, each joint's rotation in its parent's frame (joint 0: in the world).
        style: name of the style, such as `angry`.
        content: what the character does, such as `walk`.
        mirrored: whether left and right have been exchanged.
        source: file that the clip was read from, for messages.
        reading: how that file was read; None if the clip comes from no file.
    """

    skeleton: Skeleton
    fps: float
    root_positions: np.ndarray
    rotations: np.ndarray
    style: str = "unknown"
    content: str = ""
    mirrored: bool = False
    source: str = ""
    reading: Reading | None = None

    @property
    def num_frames(self) -> int:
        """T."""
        return len(self.root_positions)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed about the clip's file and may be wrong, and what was repaired; one line each."""
        return () if self.reading is None else self.reading.notes


def cut(clip: MotionClip, start: int, stop: int) -> MotionClip:
    """Returns frames start to stop (exclusive) of a clip.

    Raises:
        InputError: unless 0 <= start < stop <= number of frames.
    """
    if not 0 <= start < stop <= clip.num_frames:
        rule = f"must lie within the clip's {clip.num_frames} frames and contain at least one"
        raise InputError(clip.source or "clip", "cut", f"frames {start} to {stop}", rule)
    positions, rotations, reading = clip.root_positions[start:stop], clip.rotations[start:stop], clip.reading
    if reading is not None and clip.fps == reading.fps:  # frames are the file's own
        reading = replace(reading, first_frame=reading.first_frame + start)
    return replace(clip, root_positions=positions, rotations=rotations, reading=reading)


def resample(clip: MotionClip, fps: float) -> MotionClip:
    """Resamples a clip to another frame rate, from its first frame to the last new frame within it.

    Positions are interpolated linearly and rotations along the shorter great arc (slerp). A new frame that coincides
    with an old one equals it exactly, so that resampling from 120 to 60 fps keeps every second frame.

    Raises:
        InputError: if the rate is not positive and finite.
    """
    if not (np.isfinite(fps) and fps > 0):
        raise InputError(clip.source or "clip", "frame rate", fps, "must be positive and finite")
    if abs(fps - clip.fps) <= ON_FRAME * fps or clip.num_frames < 2:
        return replace(clip, fps=float(fps))
    times = np.arange(int(np.floor((clip.num_frames - 1) * fps / clip.fps + ON_FRAME)) + 1) * (clip.fps / fps)
    nearest = np.rint(times)
    times = np.where(np.abs(times - nearest) <= ON_FRAME, nearest, times)
    before = np.minimum(times.astype(int), clip.num_frames - 1)
    after, fraction = np.minimum(before + 1, clip.num_frames - 1), times - before
    between = np.flatnonzero(fraction > 0)
    positions, rotations = clip.root_positions[before].copy(), clip.rotations[before].copy()
    weight = fraction[between, None]
    first, second = before[between], after[between]
    positions[between] += weight * (clip.root_positions[second] - clip.root_positions[first])
    rotations[between] = quat_slerp(clip.rotations[first], clip.rotations[second], weight)
    return replace(clip, fps=float(fps), root_positions=positions, rotations=rotations)


def mirror_clip(clip: MotionClip, signs: np.ndarray | None = None) -> MotionClip:
    """Mirrors a clip across the plane x = 0, exchanging left and right, on the same skeleton.

    Each joint takes its partner's reflected rotation. Since a reflection is not a rotation, every joint also has a
    reflection S of its own frame, which maps its bones to its partner's bones: x to -x in skeletons whose zero pose is
    symmetric, other axes where bones lie along local X, as in the Bandai-Namco files. Where bones do not determine S,
    it is chosen to keep the mirrored poses closest to the clip's own. Bone lengths remain the skeleton's: where left
    and right differ, mirrored positions differ from reflected ones by as much. Mirroring twice is the identity.

    Args:
        clip: the motion.
        signs: [J, 3] as `frame_reflections` returns them; None computes them.
    """
    signs = frame_reflections(clip) if signs is None else signs
    partner, parents = clip.skeleton.mirror, clip.skeleton.parents
    # local: S_parent r_partner S; the root's parent is the world, reflected across x
    outer = np.where(parents[:, None] >= 0, signs[parents], WORLD_REFLECTION)
    rotations = reflect_rotations(clip.rotations[:, partner], outer, signs)
    return replace(
        clip,
        root_positions=clip.root_positions * WORLD_REFLECTION,
        rotations=rotations,
        mirrored=not clip.mirrored,
        content=swap_sides(clip.content),
    )


def swap_sides(content: str) -> str:
    """Exchanges the words left and right in a content's name: walk-turn-left becomes walk-turn-right."""
    return re.sub(r"left|right", lambda word: "right" if word[0] == "left" else "left", content)


def reflect_rotations(q: np.ndarray, outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """Returns quaternions [T, J, 4] of O R I, for diagonal reflections O (outer) and I (inner) given by signs [J, 3].

    Each reflection's signs have product -1. With O = -A and I = -B for half turns (or identities) A and B about an
    axis, O R I = A R B. This permutes the quaternion's components and changes their signs; applying it to the four unit
    quaternions shows how.
    """
    units = np.eye(4)[:, None]
    outer = np.broadcast_to(outer, inner.shape)
    images = quat_multiply(quat_multiply(_half_turn(outer), units), _half_turn(inner))  # [4, J, 4]
    source = np.argmax(np.abs(images), axis=0)  # [J, 4] part of q that each part of the result comes from
    sign = np.take_along_axis(images, source[None], axis=0)[0]
    if (source == np.arange(4)).all():  # where outer and inner are equal, as in symmetric zero poses
        return q * sign
    return np.take_along_axis(q, source[None], axis=-1) * sign


def _half_turn(signs: np.ndarray) -> np.ndarray:
    """Returns quaternions [J, 4] of the rotation -S: a half turn about the axis that S reflects, or the identity."""
    turn = np.concatenate((np.zeros((len(signs), 1)), (signs < 0).astype(float)), axis=1)
    turn[np.all(signs < 0, axis=1)] = (1.0, 0.0, 0.0, 0.0)
    return turn


def frame_reflections(clip: MotionClip) -> np.ndarray:
    """Returns the signs [J, 3] of the reflection of each joint's frame, equal for both joints of a pair."""
    skeleton = clip.skeleton
    misfit, length = _bone_misfit(skeleton)
    fits = misfit <= misfit.min(axis=1, keepdims=True) + ASYMMETRY * length[:, None]
    if np.all(fits[:, 0]):
        # the zero pose is symmetric, so every frame mirrors as the world does
        return np.tile(WORLD_REFLECTION, (skeleton.num_joints, 1))
    mean = quat_to_matrix(clip.rotations[:: max(1, clip.num_frames // 100)]).mean(axis=0)
    chosen = np.zeros(skeleton.num_joints, dtype=int)
    for joint in range(skeleton.num_joints):
        partner, parent = skeleton.mirror[joint], skeleton.parents[joint]
        if partner < joint:
            chosen[joint] = chosen[partner]
        elif parent < 0:  # of the root's axes only the vertical one does not depend on the clip's heading
            chosen[joint] = _best(fits[joint], (mean[joint][1] ** 2 * REFLECTIONS).sum(axis=1))
        else:
            mirrored = REFLECTIONS[chosen[parent]][:, None] * mean[partner]
            closeness = [float(np.sum(mean[joint] * mirrored * signs)) for signs in REFLECTIONS]
            chosen[joint] = _best(fits[joint], np.array(closeness))
    return REFLECTIONS[chosen]


def _best(fits: np.ndarray, closeness: np.ndarray) -> int:
    return int(np.argmax(np.where(fits, closeness, -np.inf)))


def _bone_misfit(skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Returns how far each reflection misses the partner's bones [J, 4], and the length of each joint's bones [J]."""
    misfit, length = np.zeros((skeleton.num_joints, len(REFLECTIONS))), np.zeros(skeleton.num_joints)
    for joint in range(1, skeleton.num_joints):
        parent, partner = skeleton.parents[joint], skeleton.mirror[joint]
        offset, other = skeleton.offsets[joint], skeleton.offsets[partner]
        misfit[parent] += np.linalg.norm(REFLECTIONS * offset - other, axis=1)
        length[parent] += np.linalg.norm(offset)
    both = skeleton.mirror
    return misfit + misfit[both], length + length[both]
