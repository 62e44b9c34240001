"""One take of motion: the record, and operations on all of it (cut, resample, mirror)."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.kinematics import quat_multiply, quat_rotate, quat_slerp
from pfnn_jax.motion.reading import Reading
from pfnn_jax.motion.reflection import WORLD_REFLECTION, WORLD_TURN, frame_reflections, reflect_rotations
from pfnn_jax.motion.skeleton import Skeleton

ON_FRAME = 1e-6  # of a frame: a new frame this close to an old one takes its values exactly


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


def move_clip(clip: MotionClip, rotation: np.ndarray, translation: np.ndarray) -> MotionClip:
    """Returns a clip rotated about the origin, then translated.

    Args:
        clip: the motion.
        rotation: [4] wxyz.
        translation: [3] metres.
    """
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat_multiply(rotation, rotations[:, 0])
    return replace(clip, root_positions=quat_rotate(rotation, clip.root_positions) + translation, rotations=rotations)


def mirror_clip(clip: MotionClip, turns: np.ndarray | None = None) -> MotionClip:
    """Mirrors a clip across the plane x = 0, exchanging left and right, on the same skeleton.

    Each joint takes its partner's reflected rotation. Since a reflection is not a rotation, every joint also has a
    reflection of its own frame, which maps its bones to its partner's bones; see `frame_reflections`. Bone lengths
    remain the skeleton's: where left and right differ, mirrored positions differ from reflected ones by as much.
    Mirroring twice is the identity.

    Args:
        clip: the motion.
        turns: [J, 4] as `frame_reflections` returns them; None computes them.
    """
    skeleton = clip.skeleton
    turns = frame_reflections(skeleton, clip.rotations) if turns is None else turns
    # the root's parent is the world, which is reflected across x
    outer = np.where(skeleton.parents[:, None] >= 0, turns[skeleton.parents], WORLD_TURN)
    rotations = reflect_rotations(clip.rotations[:, skeleton.mirror], outer, turns)
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
