"""Drives characters along the paths of real takes, all takes at once, so that walks can be compared with the actor's.

`follow_takes` uses the published loop, which shows what a network does by itself; `track_takes` the controller, which
is what a user sees. Both return a `Walk` for each take, and the actor's own motion is one too. All that is compared is
found in the joints by the same functions, whatever the layout: facing, gait phase, contacts, place on the path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.controller import Controller, Embodiment
from pfnn_jax.control.generation import fill_up, starting_row, track_paths, walking_state_from
from pfnn_jax.control.loop.pursuit import TimedPath, make_timed_path
from pfnn_jax.control.loop.rollout import follow_path
from pfnn_jax.control.loop.state import contacts_of_output, place_state
from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.actor_test import (
    LEAD_SECONDS,
    LEAST_HEIGHT,
    LEAST_SPEED,
    MOST_HEIGHT,
    MOST_SECONDS,
    path_of,
    progress_along,
)
from pfnn_jax.inference.predictor import Predictor, evaluate
from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.datasets.clip_rows import match_skeleton
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.labels.contacts import foot_contacts
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.phase import PhaseLabels, cut_phase, label_phase
from pfnn_jax.motion.paths import Path
from pfnn_jax.motion.skeleton import Roles, Skeleton, need_roles
from pfnn_jax.motion.trajectory import Root, relative_to_root, root_motion
from pfnn_jax.motion.world_motion import WorldMotion, world_motion

DRIVEN_SECONDS = LEAD_SECONDS + MOST_SECONDS / LEAST_SPEED + 1.0
"""Length of every walk: enough for the longest take at the least speed that counts as following a command."""

MARGIN_SECONDS = 1.0
"""Seconds of a walk that are kept before and after the take's part of the path: about a cycle, in which the pose of a
phase is looked for."""

ROUND_UP_TAKES = 6
"""The number of takes is filled up to a multiple of this, so that styles with about as many takes compile once."""


@dataclass(frozen=True, eq=False)
class Walk:
    """What a body did along the path of a take: a character, or the actor.

    Attributes:
        joints: [T, J, 3] metres in the world.
        root: of the T frames, found in the joints.
        place: [T] metres along the path, never decreasing.
        phase: [T] radians, found in the motion; NaN in frames without a label.
        contacts: [T, 4] bool, found in the motion: left heel, left toe, right heel, right toe.
        first, last: frames at which the take's part of the path begins and ends.
        network_phase: [T] radians, of the network, if it has one.
        network_contacts: [T, 4] bool, predicted, if the network predicts them.
        faults: why the walk counts as failed; empty if it does not.
    """

    joints: np.ndarray
    root: Root
    place: np.ndarray
    phase: np.ndarray
    contacts: np.ndarray
    first: int
    last: int
    network_phase: np.ndarray | None = None
    network_contacts: np.ndarray | None = None
    faults: tuple[str, ...] = ()

    @cached_property
    def poses(self) -> np.ndarray:
        """Joint positions [T, J, 3] in metres relative to the root on the ground."""
        return relative_to_root(self.joints, self.root)

    @property
    def part(self) -> slice:
        """The frames of the take's part of the path."""
        return slice(self.first, self.last + 1)


@dataclass(frozen=True, eq=False)
class DrivenTake:
    """A real take on a network's skeleton, and how to drive a character along it.

    Attributes:
        name: of its file.
        skeleton, fps: of all walks along it.
        path: the actor's, with straight pieces before and after it (`actor_test.path_of`).
        begin, end: metres along the path at which the take begins and ends.
        speed: metres per second, the actor's mean.
        actor: what the actor did.
    """

    name: str
    skeleton: Skeleton
    fps: float
    path: Path
    begin: float
    end: float
    speed: float
    actor: Walk

    @property
    def roles(self) -> Roles:
        """Roles of the skeleton."""
        return need_roles(self.skeleton, self.name)


def make_driven_take(labelled: LabelledClip, body: Embodiment) -> DrivenTake:
    """Returns the first `MOST_SECONDS` of a labelled take, on the skeleton of a network, as characters are driven.

    Args:
        labelled: a take that travels, at the frame rate of the layout.
        body: layout and skeleton of the network.

    Raises:
        NoGaitError: if it has no steps.
        InputError: for another frame rate, or a skeleton without a humanoid map that is not the network's.
    """
    fps, source = labelled.clip.fps, labelled.clip.source or "clip"
    if fps != body.layout.fps:
        raise InputError(source, "frame rate", fps, f"must be {body.layout.fps:g}: load the clip at the layout's rate")
    matched = match_skeleton(labelled, body.skeleton)
    stop = min(matched.clip.num_frames, round(MOST_SECONDS * fps))
    whole = world_motion(matched.world or matched.clip)
    world = WorldMotion(cut(whole.clip, 0, stop), whole.positions[:stop], whole.rotations[:stop])
    labels = cut_phase(labelled.labels, 0, stop) if labelled.labels.labelled.any() else label_phase(world)
    path, begin, end, speed = path_of(world)
    root = root_motion(world.positions, world.roles, fps)
    actor = Walk(
        joints=world.positions,
        root=root,
        place=_places(root.positions, path, begin),
        phase=_phase_of(labels),
        contacts=foot_contacts(world.positions, world.roles, fps),
        first=0,
        last=stop - 1,
    )
    return DrivenTake(source, body.skeleton, fps, path, begin, end, speed, actor)


def follow_takes(predictor: Predictor, body: Embodiment, takes: Sequence[DrivenTake]) -> list[Walk]:
    """Returns walks of the published loop along takes, from a warmed-up stride on, without tracking and foot locking.

    Args:
        predictor: network and style. Networks and styles of the same sizes compile once.
        body: layout, skeleton and normaliser of the network.
        takes: at least one.
    """
    layout, track, points, yaws = body.layout, *_commands(takes)
    rows = [starting_row(layout, body.normaliser, speed) for speed in track.speed]
    x, gating = (jnp.stack(leaves) for leaves in zip(*rows, strict=True))
    outcome = _follow(predictor, layout, x, gating, track, points, yaws, _num_frames(layout))
    joints, phase, outputs = (np.asarray(values) for values in outcome)
    contacts = contacts_of_output(layout, outputs)
    return [
        _walk_along(take, joints[i], _global(layout, phase[i]), None if contacts is None else contacts[i])
        for i, take in enumerate(takes)
    ]


def track_takes(
    controller: Controller, weights: np.ndarray, body: Embodiment, takes: Sequence[DrivenTake]
) -> list[Walk]:
    """Returns walks of a controlled character along takes, from standing on.

    Args:
        controller: of the character. Controllers of networks, and of as many styles, of the same sizes compile once.
        weights: [C] of its style.
        body: layout, skeleton and normaliser of the network.
        takes: at least one.
    """
    paths, speeds = [take.path for take in takes], [take.speed for take in takes]
    number = _num_frames(body.layout)
    tracked = track_paths(controller, [weights] * len(takes), paths, speeds, number, lanes=ROUND_UP_TAKES)
    return [
        _walk_along(take, walk.joints, _global(body.layout, walk.phase), walk.contacts)
        for take, walk in zip(takes, tracked, strict=True)
    ]


def walk_of_joints(
    take: DrivenTake,
    joints: np.ndarray,
    network_phase: np.ndarray | None = None,
    network_contacts: np.ndarray | None = None,
) -> Walk:
    """Returns the walk of a body along a take, however it was made, cut to the take's part and `MARGIN_SECONDS`.

    Args:
        take: along whose path the body went.
        joints: [T, J, 3] metres in the world, from at most `begin` along the path on, at the take's frame rate.
        network_phase: [T] radians, of the network.
        network_contacts: [T, 4] bool, predicted.
    """
    joints = np.asarray(joints, np.float64)
    if not np.isfinite(joints).all():
        return _failed(take, joints, "not finite")
    place = _places(joints[:, take.roles.hips][:, [0, 2]], take.path)
    first, last = (int(np.searchsorted(place, limit)) for limit in (take.begin, take.end))
    if last >= len(joints):
        return _failed(take, joints, "does not get to the end")
    margin = round(MARGIN_SECONDS * take.fps)
    kept = slice(max(first - margin, 0), last + margin + 1)
    joints, place, first, last = joints[kept], place[kept], first - kept.start, last - kept.start
    heights = [part[:, take.roles.hips, 1].mean() for part in (joints[first : last + 1], take.actor.joints)]
    relative = float(heights[0] / heights[1])
    off = not LEAST_HEIGHT <= relative <= MOST_HEIGHT
    return Walk(
        joints=joints,
        root=root_motion(joints, take.roles, take.fps),
        place=place,
        phase=_found_phase(take, joints),
        contacts=foot_contacts(joints, take.roles, take.fps),
        first=first,
        last=last,
        network_phase=None if network_phase is None else network_phase[kept],
        network_contacts=None if network_contacts is None else network_contacts[kept],
        faults=(f"hips at {relative:.2f} of their height",) if off else (),
    )


def _walk_along(take: DrivenTake, joints: np.ndarray, phase: np.ndarray | None, contacts: np.ndarray | None) -> Walk:
    return walk_of_joints(take, joints, phase, None if contacts is None else contacts > 0.5)


def _failed(take: DrivenTake, joints: np.ndarray, fault: str) -> Walk:
    """Returns a walk of which only the fault matters."""
    frames, still = len(joints), np.nan_to_num(joints, posinf=0.0, neginf=0.0)
    root = Root(np.zeros((frames, 2)), np.zeros((frames, 2)))
    none = np.full(frames, np.nan)
    return Walk(still, root, np.zeros(frames), none, np.zeros((frames, 4), bool), 0, frames - 1, faults=(fault,))


def _places(roots: np.ndarray, path: Path, begin: float = 0.0) -> np.ndarray:
    """Returns the places [T] in metres along a path of roots [T, 2], the first of which is near `begin`.

    The nearest point of `progress_along` is refined by the root's place along the path's direction there.
    """
    index = progress_along(roots, path, int(begin / path.spacing))
    tangent = np.gradient(path.points, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-9)
    ahead = ((roots - path.points[index]) * tangent[index]).sum(axis=-1)
    return np.maximum.accumulate(index * path.spacing + np.clip(ahead, -path.spacing, path.spacing))


def _found_phase(take: DrivenTake, joints: np.ndarray) -> np.ndarray:
    """Returns the phase [T] of joints, labelled as that of real clips is; NaN without a label, or without steps."""
    rotations = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*joints.shape[:2], 4))  # labels read positions alone
    clip = MotionClip(take.skeleton, take.fps, joints[:, 0], rotations)
    try:
        return _phase_of(label_phase(WorldMotion(clip, joints, rotations)))
    except NoGaitError:
        return np.full(len(joints), np.nan)


def _phase_of(labels: PhaseLabels) -> np.ndarray:
    return np.where(labels.labelled, labels.phase, np.nan)


def _global(layout: FrameLayout, phase: np.ndarray) -> np.ndarray | None:
    return phase if layout.phase_kind == "global" else None


def _num_frames(layout: FrameLayout) -> int:
    return round(DRIVEN_SECONDS * layout.fps)


def _commands(takes: Sequence[DrivenTake]) -> tuple[TimedPath, jax.Array, jax.Array]:
    """Returns the paths with speeds, their first points [N, 2] and their first yaws [N], N a multiple of
    `ROUND_UP_TAKES`."""
    filled = fill_up(takes, ROUND_UP_TAKES)
    tracks = [make_timed_path(take.path, take.speed) for take in filled]
    points = jnp.asarray(np.stack([take.path.points[0] for take in filled]), jnp.float32)
    yaws = jnp.asarray([take.path.start_yaw for take in filled], jnp.float32)
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *tracks), points, yaws


@partial(jax.jit, static_argnames=("layout", "num_frames"))
def _follow(predictor: Predictor, layout: FrameLayout, x, gating, track: TimedPath, points, yaws, num_frames: int):
    """Returns joints [N, T, J, 3], phases and outputs of the published loop, for arguments with a leading axis N."""

    def one(x, gating, track, point, yaw):
        state = walking_state_from(evaluate, predictor, layout, x, gating, track.speed)
        frames = follow_path(evaluate, predictor, layout, place_state(state, point, yaw), track, num_frames)
        return frames.joint_positions, frames.phase, frames.outputs

    return jax.vmap(one)(x, gating, track, points, yaws)
