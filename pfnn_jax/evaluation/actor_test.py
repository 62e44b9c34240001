"""Compares what a run generates with what an actor did, in centimetres on the actor's own skeleton.

The character walks along the actor's path at the actor's speed. Its motion is put back onto the actor's skeleton, so
that sizes are the actor's, and the mean gait cycles of both are compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pfnn_jax.control.controller import Controller
from pfnn_jax.control.generation import track_path
from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.gait_cycle import cycle_distance, mean_cycle
from pfnn_jax.evaluation.metrics import foot_skating, path_error, planted_heights
from pfnn_jax.inference.predictor import Predictor
from pfnn_jax.inference.rows import evaluate_rows
from pfnn_jax.motion.body_poses import body_joints, root_poses
from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.datasets.clip_rows import labelled_features, match_skeleton
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.features.encode import Features
from pfnn_jax.motion.filters import gaussian_filter
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.phase import PhaseLabels, label_phase
from pfnn_jax.motion.paths import Path, resample_path
from pfnn_jax.motion.retargeting.body import humanoid_of
from pfnn_jax.motion.retargeting.retarget import retarget
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.world_motion import WorldMotion, world_motion
from pfnn_jax.run import Run

LEAD_SECONDS = 2.0
"""Seconds of straight walking before the actor's path: a character starts standing, and needs a step or two."""

MOST_SECONDS = 6.0
"""Longest take; all walks have the same number of frames, so that they are compiled once."""

PATH_POINTS = 512
"""Points of every path, for the same reason."""

SWAY_SECONDS = 0.3
"""Standard deviation of the filter that takes the sway of the hips out of an actor's path."""

REACH = 0.5
"""Metres ahead in which a character's place on its path is looked for."""

LEAST_HEIGHT, MOST_HEIGHT = 0.75, 1.25
"""Height of the hips, relative to the actor's, outside which a walk counts as diverged."""

MOST_LEAN = 60.0
"""Degrees between the trunk and the actor's beyond which a walk counts as diverged. The trunks of two styles of the
procedural walkers differ by up to 43°."""

LEAST_SPEED, MOST_SPEED = 0.5, 1.5
"""Speed, relative to the actor's, outside which a character does not follow its command."""

MOST_PATH_ERROR = 0.5
"""Mean distance in metres from the path beyond which a character does not follow its command."""


@dataclass(frozen=True, eq=False)
class Actor:
    """A real take, on the actor's skeleton and on the run's.

    Attributes:
        world: T frames on the actor's skeleton.
        labels: phase of the T frames.
        cycle: [P, J, 3] its mean gait cycle.
        on_run: the same take on the run's skeleton.
        rows: of `on_run`.
        scale: leg length of the run's skeleton over that of the actor's.
    """

    world: WorldMotion
    labels: PhaseLabels
    cycle: np.ndarray
    on_run: MotionClip
    rows: Features
    scale: float

    @property
    def skeleton(self) -> Skeleton:
        """The actor's skeleton."""
        return self.world.skeleton


@dataclass(frozen=True, eq=False)
class ActorWalk:
    """What a character did along an actor's path, on the actor's skeleton.

    Attributes:
        clip: the frames between both ends of the path.
        speed: achieved over commanded.
        path_error: mean distance from the path in metres.
    """

    clip: MotionClip
    speed: float
    path_error: float


def make_actor(labelled: LabelledClip, run: Run) -> Actor:
    """Returns a labelled take with what walks of a run are compared with.

    Raises:
        NoGaitError: if its labels cover less than a whole gait cycle.
        InputError: if its skeleton is not a humanoid.
    """
    world = world_motion(labelled.world or labelled.clip)
    labels = labelled.labels if labelled.labels.labelled.any() else label_phase(world)
    on_run = match_skeleton(labelled, run.skeleton)
    legs = [leg_length_of(skeleton, humanoid_of(skeleton)) for skeleton in (world.skeleton, run.skeleton)]
    rows = labelled_features(on_run, run.layout)[0]
    return Actor(world, labels, mean_cycle(world, labels), on_run.clip, rows, legs[1] / legs[0])


def follow_actor(controller: Controller, weights: np.ndarray, run: Run, actor: Actor) -> ActorWalk:
    """Returns what a character does along an actor's path at the actor's speed; arguments as of `follow_clip`."""
    return follow_clip(controller, weights, run, actor.on_run, actor.skeleton, actor.scale)


def follow_clip(
    controller: Controller, weights: np.ndarray, run: Run, clip: MotionClip, skeleton: Skeleton, scale: float
) -> ActorWalk:
    """Returns what a character does along the path of a clip at the clip's speed, put onto another skeleton.

    Args:
        controller: of the run.
        weights: [C] of the style.
        run: the run.
        clip: on the run's skeleton, of at most `MOST_SECONDS`.
        skeleton: of the result.
        scale: leg length of the run's skeleton over that of `skeleton`.

    Raises:
        InputError: if the motion is not finite, or the character does not get to the clip's path.
    """
    path, begin, end, speed = path_of(world_motion(clip))
    seconds = LEAD_SECONDS + MOST_SECONDS + 1.0
    walk = track_path(controller, weights, path, run, speed=speed, seconds=seconds).clip
    roots = world_motion(walk).positions[:, run.skeleton.roles.hips if run.skeleton.roles else 0][:, [0, 2]]
    along = path.spacing * progress_along(roots, path)
    there = np.flatnonzero(along >= begin)
    first = int(there[0]) if len(there) else walk.num_frames
    last = min(first + round((end - begin) / speed * walk.fps), walk.num_frames - 1)
    if last - first < walk.fps:
        raise InputError(run.path, "motion", "does not get to the path", "the network cannot walk in this style")
    moved = (along[last] - along[first]) * walk.fps / (last - first)
    back = retarget(cut(walk, first, last + 1), skeleton).clip
    return ActorWalk(back, float(moved / speed), path_error(roots[first:last], path.points).mean / scale)


def path_of(world: WorldMotion) -> tuple[Path, float, float, float]:
    """Returns the path of a take with straight pieces before and after it, and how to walk it.

    Returns:
        The path of `PATH_POINTS` points; the distances in metres from its start at which the take begins and ends; and
        the take's mean speed in metres per second.

    Raises:
        ValueError: for a take that stays in place.
    """
    root = world.positions[:, world.roles.hips][:, [0, 2]]
    smooth = without_sway(root, world.fps)
    length = float(np.linalg.norm(np.diff(smooth, axis=0), axis=-1).sum())
    speed = length * world.fps / (len(smooth) - 1)
    if speed == 0:
        raise ValueError("`world` must travel.")
    before, after = (_direction(part) for part in (smooth[: len(smooth) // 4 + 2], smooth[-len(smooth) // 4 - 2 :]))
    lead, trail = LEAD_SECONDS * speed, (MOST_SECONDS + 2.0) * speed
    points = np.concatenate([smooth[:1] - lead * before, smooth, smooth[-1:] + trail * after])
    return resample_path(points, False, PATH_POINTS), lead, lead + length, speed


def progress_along(roots: np.ndarray, path: Path, start: int = 0) -> np.ndarray:
    """Returns the index [T] of the path's point that each root [T, 2] has got to: the nearest one, never going back.

    Only points within `REACH` ahead are tried, so that a path may come near itself. The search begins at point `start`.
    """
    reach, current, found = max(round(REACH / path.spacing), 1), start, []
    for root in roots:
        ahead = path.points[current : current + reach + 1]
        current += int(np.argmin(np.linalg.norm(ahead - root, axis=-1)))
        found.append(current)
    return np.array(found)


def without_sway(root: np.ndarray, fps: float) -> np.ndarray:
    """Returns positions [T, 2] smoothed over `SWAY_SECONDS`; both ends are continued, so that no length is lost."""
    pad = min(round(3 * SWAY_SECONDS * fps), len(root) - 1)
    longer = np.pad(root, ((pad, pad), (0, 0)), mode="reflect", reflect_type="odd")
    return gaussian_filter(longer, SWAY_SECONDS * fps)[pad : pad + len(root)]


def compare_walk(actor: Actor, walk: ActorWalk) -> dict[str, Any]:
    """Returns how a generated walk differs from the actor's.

    Returns:
        `distance`, between the mean gait cycles, over all joints of the body, and `trunk`, `arms` and `legs`, in
        centimetres; `skating` in cm/s; `floating`, how many centimetres higher the feet rest than the actor's;
        `height`, of the hips over the actor's; `lean`, degrees between the trunks; `speed` and `path_error` of the
        walk, the latter in centimetres; and `faults`, why the walk counts as failed. Values that cannot be measured are
        None.
    """
    world = world_motion(walk.clip)
    resting = planted_heights(feet_of(world)) - planted_heights(feet_of(actor.world))
    poses, true = root_poses(world), root_poses(actor.world)
    height = float(poses[:, world.roles.hips, 1].mean() / true[:, world.roles.hips, 1].mean())
    lean = _angle(trunk_of(poses, world), trunk_of(true, actor.world))
    faults = list_faults(height, lean, walk)
    distances: dict[str, float | None] = dict.fromkeys(("distance", "trunk", "arms", "legs"))
    try:
        distances |= by_part(cycle_distance(actor.cycle, mean_cycle(world, label_phase(world))), actor.skeleton)
    except NoGaitError:
        faults.append("no steps")
    return {
        **distances,
        "skating": skating_of(world),
        "floating": float(100 * resting.mean()),
        "height": height,
        "lean": lean,
        "speed": walk.speed,
        "path_error": 100 * walk.path_error,
        "faults": faults,
    }


def list_faults(height: float, lean: float, walk: ActorWalk) -> list[str]:
    """Returns why a walk counts as failed: it diverged, or does not follow its command; empty if it does neither."""
    faults = []
    if not LEAST_HEIGHT <= height <= MOST_HEIGHT:
        faults.append(f"hips at {height:.2f} of their height")
    if not lean <= MOST_LEAN:
        faults.append(f"trunk off by {lean:.0f}°")
    if not LEAST_SPEED <= walk.speed <= MOST_SPEED:
        faults.append(f"{walk.speed:.2f} of the speed")
    if not walk.path_error <= MOST_PATH_ERROR:
        faults.append(f"{walk.path_error:.2f} m off the path")
    return faults


def by_part(distances: np.ndarray, skeleton: Skeleton) -> dict[str, float]:
    """Returns the mean of distances [J] in metres over the joints of the body and of its parts, in centimetres."""
    body = humanoid_of(skeleton)
    groups: dict[str, list[int]] = {"trunk": [body.hips, *body.spine, *body.neck], "arms": [], "legs": []}
    for name, joint in body.joints().items():
        if isinstance(joint, int) and name.startswith(("left", "right")):
            leg = name.endswith(("thigh", "shin", "foot", "toe"))
            groups["legs" if leg else "arms"].append(joint)
    if body.head is not None:
        groups["trunk"].append(body.head)
    parts = {name: float(100 * distances[joints].mean()) for name, joints in groups.items() if joints}
    return {"distance": float(100 * distances[body_joints(skeleton)].mean()), **parts}


def retargeting_distance(actor: Actor, run: Run) -> float:
    """Returns the distance in centimetres between a take's mean gait cycle and itself, to the run's skeleton and back.

    No walk of the run can be expected to be nearer than what retargeting alone changes.
    """
    back = world_motion(retarget(retarget(actor.world.clip, run.skeleton).clip, actor.skeleton).clip)
    return by_part(cycle_distance(actor.cycle, mean_cycle(back, actor.labels)), actor.skeleton)["distance"]


def actor_distance(actor: Actor, other: Actor) -> float | None:
    """Returns the distance in centimetres between two takes of one actor, None if their skeletons differ in joints."""
    if actor.skeleton.names != other.skeleton.names:
        return None
    return by_part(cycle_distance(actor.cycle, other.cycle), actor.skeleton)["distance"]


def one_step_distance(predictor: Predictor, actor: Actor, run: Run) -> float:
    """Returns the mean distance in centimetres, at the actor's size, between predicted and true joints, one step ahead.

    The network reads the true pose in every frame, and no foot is locked.
    """
    predicted = evaluate_rows(predictor, actor.rows.x, actor.rows.phase)
    return _joint_distance(predicted[:, run.layout.output_slice("joint_position")], actor, run)


def holding_distance(actor: Actor, run: Run) -> float:
    """Returns what `one_step_distance` is for a prediction that repeats the pose before, the error of doing nothing."""
    return _joint_distance(actor.rows.x[:, run.layout.input_slice("joint_position")], actor, run)


def _joint_distance(columns: np.ndarray, actor: Actor, run: Run) -> float:
    true = actor.rows.y[:, run.layout.output_slice("joint_position")]
    apart = (columns - true).reshape(len(true), run.layout.num_joints, 3)
    joints = body_joints(run.skeleton)
    return float(100 * run.layout.length_unit / actor.scale * np.linalg.norm(apart[:, joints], axis=-1).mean())


def trunk_of(poses: np.ndarray, world: WorldMotion) -> np.ndarray:
    """Returns the mean direction [3] from the hips to the middle of the shoulders, relative to the root."""
    roles = world.roles
    middle = (poses[:, roles.left_shoulder] + poses[:, roles.right_shoulder]) / 2
    return _direction(np.stack([poses[:, roles.hips].mean(axis=0), middle.mean(axis=0)]))


def skating_of(world: WorldMotion) -> float:
    """Returns how fast feet slide near the height at which they rest in the same motion, in cm/s (`foot_skating`)."""
    return skating_of_feet(feet_of(world), world.fps)


def skating_of_feet(feet: np.ndarray, fps: float) -> float:
    """Returns how fast feet [T, 4, 3] slide near the height at which they rest in the same motion, in cm/s."""
    return 100 * foot_skating(feet, fps, planted_heights(feet))


def feet_of(world: WorldMotion) -> np.ndarray:
    """Returns the heels and toes [T, 4, 3] of a motion, in metres."""
    return world.positions[:, [*world.roles.left_foot, *world.roles.right_foot]]


def _direction(points: np.ndarray) -> np.ndarray:
    """Returns the unit vector from the first point to the last."""
    along = points[-1] - points[0]
    return along / max(float(np.linalg.norm(along)), 1e-9)


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    """Returns the angle between two unit vectors in degrees."""
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
