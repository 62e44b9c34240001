"""Local phases: the phase of each hand and foot in its own cycle of movement (Mason et al. 2022, section 4.1).

Each bone has a source function: its contacts with the ground if it has any, otherwise its displacement along the first
principal axis of its movement. The source is normalised in a window of one second and smoothed, and a sinusoid is
fitted around every frame. The sinusoid's phase at that frame is written as a vector (sin, cos) whose length is the
fitted amplitude times the speed of the bone, so that it vanishes for bones that hardly move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.filters import low_pass, moving_average
from pfnn_jax.motion.ground import facing_of, to_local
from pfnn_jax.motion.kinematics import quat_rotate
from pfnn_jax.motion.labels.sinusoid import HIGHEST, fit_sinusoids
from pfnn_jax.motion.world_motion import WorldMotion, world_motion

END_EFFECTORS = ("left hand", "right hand", "left toe", "right toe")
"""Order of the four bones in every array of local phases."""


@dataclass(frozen=True, eq=False)
class EndEffectors:
    """Positions of the tips of hands and feet, in the order of `END_EFFECTORS`.

    Attributes:
        world: [T, 4, 3] metres.
        local: [T, 4, 3] metres from the hips, in axes that turn with the facing of the hips: x left, y up, z forward.
        fps: frames per second.
    """

    world: np.ndarray
    local: np.ndarray
    fps: float


def end_effectors(clip: MotionClip | WorldMotion) -> EndEffectors:
    """Returns the tips of a clip's hands and feet: the joint's End Site if it has one, otherwise the joint.

    The local frame is at the hips and turns about the vertical with the line between the hip joints. The hip joint's
    own frame would not do: its axes differ between rigs (in the Bandai-Namco files z is not forward), and principal
    axes are oriented by the forward direction.

    Raises:
        InputError: if the skeleton's roles are not known.
    """
    motion = world_motion(clip)
    roles, positions = motion.roles, motion.positions
    joints = (roles.left_hand, roles.right_hand, roles.left_foot[1], roles.right_foot[1])
    world = np.stack([_tip(motion, joint) for joint in joints], axis=1)
    across = positions[:, roles.left_hip] - positions[:, roles.right_hip]
    yaw = np.arctan2(-across[:, 2], across[:, 0])  # across × up
    return EndEffectors(world, to_local(world - positions[:, None, roles.hips], facing_of(yaw)), motion.fps)


def _tip(motion: WorldMotion, joint: int) -> np.ndarray:
    offsets = [offset for parent, offset in motion.skeleton.end_sites if parent == joint]
    if not offsets:
        return motion.positions[:, joint]
    farthest = max(offsets, key=lambda offset: float(np.linalg.norm(offset)))
    return motion.positions[:, joint] + quat_rotate(motion.rotations[:, joint], farthest)


WINDOW_SECONDS = 1.0
"""Window in which sources are normalised and speeds averaged."""

FIT_SECONDS = 0.5
"""Window of the sinusoid fit: 31 frames at 60 fps."""

REST_PERCENTILE = 25.0  # of the heights of a toe in the frames in which it is slow: its height at rest
CONSTANT_SOURCE = 1e-6  # share of a source's range below which its std in a window is only rounding
ALWAYS = 0.98  # share of frames in contact, or out of it, from which on a foot has no cycle of contacts


@dataclass(frozen=True)
class LocalPhaseConfig:
    """Settings of the extraction of local phases.

    Attributes:
        max_height: metres above its resting height up to which a toe counts as on the ground.
        max_speed: metres per second below which a toe counts as on the ground.
        majority_seconds: half-width of a majority filter of the contacts (5 frames at 60 fps in the published code,
            absent from the paper); 0 for none.
    """

    max_height: float = 0.01
    max_speed: float = 0.15
    majority_seconds: float = 0.0

    def __post_init__(self) -> None:
        if not (self.max_height > 0 and self.max_speed > 0 and self.majority_seconds >= 0):
            raise ValueError(
                "LocalPhaseConfig.max_height and max_speed must be positive, majority_seconds not negative, "
                f"got {self.max_height:g}, {self.max_speed:g} and {self.majority_seconds:g}."
            )


@dataclass(frozen=True, eq=False)
class PrincipalAxes:
    """First principal axis of each bone's movement, in the order of `END_EFFECTORS`.

    Attributes:
        directions: [4, 3] unit vectors, oriented forward.
        means: [4, 3] metres, mean positions from the hips.
    """

    directions: np.ndarray
    means: np.ndarray


def principal_axis(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the direction of greatest variance of points [N, 3], and their mean.

    The direction is oriented towards positive z (positive x if z is 0), so that bones that move forward together have
    equal phases, and bones that alternate have opposite ones.
    """
    mean = points.mean(axis=0)
    centred = points - mean
    axis = np.linalg.eigh(centred.T @ centred)[1][:, -1]
    return (-axis if (axis[2] or axis[0]) < 0 else axis), mean


def fit_axes(clips: Sequence[MotionClip | WorldMotion | EndEffectors]) -> PrincipalAxes:
    """Fits the principal axes of the bones over all takes of one style and gait."""
    local = np.concatenate([_ends(clip).local for clip in clips])
    axes = [principal_axis(local[:, bone]) for bone in range(local.shape[1])]
    return PrincipalAxes(np.stack([axis for axis, _ in axes]), np.stack([mean for _, mean in axes]))


def contact_source(points: np.ndarray, fps: float, config: LocalPhaseConfig | None = None) -> np.ndarray:
    """Returns in which frames [T] bool a point with world positions [T, 3] is on the ground: low and slow.

    Height is measured from the point's own resting height in the clip, as floors of recorded files are not at zero.
    """
    config = config or LocalPhaseConfig()
    speed = speeds(points, fps)
    slow = speed < config.max_speed
    rest = np.percentile(points[slow, 1], REST_PERCENTILE) if slow.any() else points[:, 1].min()
    contact = slow & (points[:, 1] < rest + config.max_height)
    around = round(config.majority_seconds * fps)
    if around == 0:
        return contact
    return moving_average(contact.astype(float), 2 * around + 1) > 0.5


def toe_contacts(clip: MotionClip | WorldMotion | EndEffectors, config: LocalPhaseConfig | None = None) -> np.ndarray:
    """Returns contacts [T, 2] bool of the right and the left toe with the ground."""
    ends = _ends(clip)
    return np.stack([contact_source(ends.world[:, bone], ends.fps, config) for bone in (3, 2)], axis=1)


def speeds(points: np.ndarray, fps: float) -> np.ndarray:
    """Returns speeds [T, ...] in metres per second of points [T, ..., 3] by central differences."""
    if len(points) < 2:
        return np.zeros(points.shape[:-1])
    return np.linalg.norm(np.gradient(points, 1 / fps, axis=0), axis=-1)


def local_phases(source: np.ndarray, speed: np.ndarray, fps: float) -> np.ndarray:
    """Returns phase vectors: amplitude times speed times (sin φ, cos φ) (Mason et al. 2022, Eq. 1).

    The speed is the root mean square over a window of one second. The paper writes the norm of the velocity over that
    window; of mean, root mean square and maximum, the root mean square reproduces the spread of the published
    statistics and the lengths that the authors' network predicts for real walks.

    The vectors are smoothed like the source. Where neighbouring fits disagree, their vectors cancel: the phase changes
    without a jump, and a short vector marks it as uncertain. Frames within a quarter of a second of an end take their
    phase from the sinusoid of the outermost whole window.

    Args:
        source: [T] or [T, B] source functions; scale and offset do not matter.
        speed: of the same shape, metres per second of the bones relative to the hips.
        fps: frames per second.

    Returns:
        [T, 2] or [T, B, 2] metres per second, with φ increasing in time; zero for clips shorter than five frames.
    """
    if source.ndim == 1:
        return local_phases(source[:, None], speed[:, None], fps)[:, 0]
    frames, bones = source.shape
    half = min(round(FIT_SECONDS * fps / 2), (frames - 1) // 2)
    if half < 2:
        return np.zeros((frames, bones, 2))
    wave = _smooth(normalise_source(source, fps), fps)
    windows = np.lib.stride_tricks.sliding_window_view(wave, 2 * half + 1, axis=0)
    fit = fit_sinusoids(windows.reshape(-1, 2 * half + 1), fps)  # all bones at once
    nearest = np.clip(np.arange(frames), half, frames - 1 - half)
    amplitude, frequency, phase = (
        values.reshape(-1, bones)[nearest - half] for values in (fit.amplitude, fit.frequency, fit.phase)
    )
    phase = phase + 2 * np.pi * frequency * ((np.arange(frames) - nearest) / fps)[:, None]
    around = 2 * round(WINDOW_SECONDS * fps / 2) + 1
    square = moving_average(speed**2, around)  # a running sum, which may round zero to below zero
    length = amplitude * np.sqrt(np.maximum(square, 0.0))
    return _smooth(length[..., None] * np.stack([np.sin(phase), np.cos(phase)], axis=-1), fps)


def clip_local_phases(
    clip: MotionClip | WorldMotion | EndEffectors,
    *,
    axes: PrincipalAxes | None = None,
    config: LocalPhaseConfig | None = None,
) -> np.ndarray:
    """Returns the local phases [T, 4, 2] of a clip as (sin, cos), for left hand, right hand, left toe, right toe.

    Args:
        clip: the motion, or its `WorldMotion` or `end_effectors` if these are known already.
        axes: principal axes of the clip's style and gait; fitted on this clip by default.
        config: thresholds of the contacts.

    Raises:
        InputError: if the skeleton's roles are not known.
    """
    ends = _ends(clip)
    axes = axes or fit_axes([ends])
    sources = source_functions(ends, axes, config)
    return local_phases(sources, speeds(ends.local, ends.fps), ends.fps)


def source_functions(ends: EndEffectors, axes: PrincipalAxes, config: LocalPhaseConfig | None = None) -> np.ndarray:
    """Returns sources [T, 4]: contacts (0 or 1) of toes that have any, else metres along the bone's principal axis."""
    sources = np.einsum("tbi,bi->tb", ends.local - axes.means, axes.directions)
    contacts = toe_contacts(ends, config)
    stepping = np.flatnonzero(goes_by_contacts(contacts))
    sources[:, stepping] = contacts[:, ::-1][:, stepping - 2]
    return sources


def goes_by_contacts(contacts: np.ndarray) -> np.ndarray:
    """Returns which of the four bones use contacts as their source: toes that are sometimes, but not always, down.

    Args:
        contacts: [T, 2] of right and left toe, as `toe_contacts` returns them.

    Returns:
        [4] bool.
    """
    share = contacts[:, ::-1].mean(axis=0)
    return np.concatenate([[False, False], (share > 1 - ALWAYS) & (share < ALWAYS)])


def smooth_sources(ends: EndEffectors, axes: PrincipalAxes, config: LocalPhaseConfig | None = None) -> np.ndarray:
    """Returns the sources [T, 4] to which sinusoids are fitted: normalised in a window of a second, and smoothed."""
    return _smooth(normalise_source(source_functions(ends, axes, config), ends.fps), ends.fps)


def mirror_local_phases(phases: np.ndarray) -> np.ndarray:
    """Returns the local phases [..., 4, 2] of the mirrored clip: left and right are exchanged."""
    return phases[..., [1, 0, 3, 2], :]


def _ends(clip: MotionClip | WorldMotion | EndEffectors) -> EndEffectors:
    return clip if isinstance(clip, EndEffectors) else end_effectors(clip)


def normalise_source(source: np.ndarray, fps: float) -> np.ndarray:
    """Normalises sources [T, ...] by their mean and std in the second around each frame; constant ones become zero.

    At the ends of the clip the window is shorter.
    """
    source = source - source.mean(axis=0)
    largest = np.abs(source).max(axis=0)
    source, half = source / np.where(largest > 0, largest, 1.0), round(WINDOW_SECONDS * fps / 2)
    frames = np.arange(len(source))
    first, last = np.maximum(frames - half, 0), np.minimum(frames + half + 1, len(source))
    count = (last - first).reshape(-1, *[1] * (source.ndim - 1))
    zero = np.zeros_like(source[:1])
    sums, squares = (np.cumsum(np.concatenate([zero, values]), axis=0) for values in (source, source**2))
    mean = (sums[last] - sums[first]) / count
    std = np.sqrt(np.maximum((squares[last] - squares[first]) / count - mean**2, 0.0))
    return (source - mean) / np.where(std > CONSTANT_SOURCE, std, 1.0)


def _smooth(values: np.ndarray, fps: float) -> np.ndarray:
    """Removes what is faster than the highest frequency of a local phase."""
    return low_pass(values, HIGHEST, fps)
