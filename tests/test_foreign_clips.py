"""The full pipeline on foreign clips: each is learned on the base network from its file, and walks circles upright."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.motion.bvh import read_bvh, write_bvh
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.kinematics import forward_kinematics, quat_rotate
from pfnn_jax.motion.paths import circle
from pfnn_jax.motion.retargeting.body import humanoid_of
from pfnn_jax.motion.retargeting.reference import reference_pose
from pfnn_jax.motion.skeleton import Skeleton, need_roles
from pfnn_jax.run import Run, load_run
from pfnn_jax.run_config import style_note
from pfnn_jax.workflows.base import base_run
from pfnn_jax.workflows.generate import generate_walk
from pfnn_jax.workflows.learn import learn_style
from tests.motion.headsets import rooted_at_head, without_arms

CLIPS = {
    "mixamo": "field/mixamorig_colon.bvh",
    "z up": "field/sway.bvh",
    "headset root": "field/cgspeed_daz.bvh",  # written with its head as root
    "headset root without arms": "field/cgspeed_daz.bvh",
}

MARKS = {name: pytest.mark.slow for name in CLIPS if name != "headset root"}
"""One clip is learned in every run of the tests, the furthest from the network's own data."""

RADIUS = 2.0
"""Metres; a walk of 1.2 m/s turns by 34 degrees per second."""

SECONDS = 10.0
"""Of each walk."""

EDGE = 1.5
"""Seconds at both ends of a walk that are not measured: the character starts and stops there."""

CYCLE = 1.0
"""Seconds over which velocities of a walk are means, about a cycle of the gait: hips sway."""

STEP = 0.25
"""Seconds over which velocities of a recorded clip are means: one of them turns back after a second."""

LOWEST = 0.8
"""Least height of the hips over that of the standing body: a crouch has 0.85, a fall less than 0.5."""

HEAD = 0.25
"""Metres that the head is at least above the hips; on an upright body 0.5 to 0.6."""

BONE = 1e-4
"""Metres by which a leg's bones may differ from the skeleton's: rounding of float32."""

SPEED = 0.2
"""Relative error of the speed, against the style's recorded speed, and of that against the actor's own."""

TURN = 0.15
"""Relative error of the angle walked, against the length walked over the radius. A character that pursues a point
ahead on its path cuts circles: by 8 % at this radius and 1.3 m/s."""


@dataclass(frozen=True)
class Walk:
    """A walk as points [T, J, 3] in metres, with the skeleton."""

    points: np.ndarray
    skeleton: Skeleton
    fps: float

    def height(self, joint: int) -> np.ndarray:
        return self.points[:, joint, 1]

    def velocity(self, window: float) -> np.ndarray:
        """Returns the velocity [T', 2] of the hips on the ground (x, z), means over a window in seconds."""
        hips, span = humanoid_of(self.skeleton).hips, round(window * self.fps)
        ground = self.points[:, hips][:, [0, 2]]
        return (ground[span:] - ground[:-span]) * self.fps / span

    def without_ends(self) -> Walk:
        edge = round(EDGE * self.fps)
        return replace(self, points=self.points[edge:-edge])


def walk_of(clip: MotionClip) -> Walk:
    return Walk(forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0], clip.skeleton, clip.fps)


def speed_of(walk: Walk, window: float) -> float:
    return float(np.median(np.linalg.norm(walk.velocity(window), axis=-1)))


def standing_hips(skeleton: Skeleton) -> float:
    """Returns the height in metres of the hips over the lowest joint of the standing body."""
    body = humanoid_of(skeleton)
    turns, points = reference_pose(skeleton, body), np.zeros((skeleton.num_joints, 3))
    for joint in range(1, skeleton.num_joints):
        parent = skeleton.parents[joint]
        points[joint] = points[parent] + quat_rotate(turns[parent], skeleton.offsets[joint])
    return float(points[body.hips, 1] - points[:, 1].min())


@pytest.fixture(scope="module", params=[pytest.param(name, marks=MARKS.get(name, ())) for name in sorted(CLIPS)])
def learned(request: pytest.FixtureRequest, mocap: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Path]:
    """The base network with a style `mine`, and the file that it was learned from."""
    file, folder = mocap / CLIPS[request.param], tmp_path_factory.mktemp("foreign_clips")
    if request.param.startswith("headset"):
        clip = read_bvh(file)
        clip = without_arms(clip) if request.param.endswith("arms") else clip
        write_bvh(folder / "headset.bvh", rooted_at_head(clip))
        file = folder / "headset.bvh"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_DATA_HOME", str(folder / "home"))
        run = load_run(base_run())
    (folder / "mine.bvh").write_bytes(file.read_bytes())
    learn_style(run, folder / "mine.bvh")
    return run, file


@pytest.fixture(scope="module")
def walks(learned: tuple[Run, Path]) -> dict[float, Walk]:
    """Walks on a circle to the left (positive radius) and on one to the right, in the learned style."""
    run, _ = learned
    return {
        radius: walk_of(generate_walk(run, "mine", circle(radius), seconds=SECONDS).clip)
        for radius in (RADIUS, -RADIUS)
    }


def recorded_speed(run: Run) -> float:
    return style_note(run.path, "mine")["info"]["speed"]


def test_rooting_at_the_head_keeps_the_motion(mocap: Path):
    clip = read_bvh(mocap / CLIPS["headset root"])
    moved = rooted_at_head(clip)
    points, new = (walk_of(each).points for each in (clip, moved))
    same = [moved.skeleton.names.index(name) for name in clip.skeleton.names]
    np.testing.assert_allclose(new[:, same], points, atol=BONE)
    assert moved.skeleton.parents[moved.skeleton.names.index(clip.skeleton.names[0])] > 0


def test_the_style_has_the_speed_of_the_actor_in_leg_lengths(learned: tuple[Run, Path]):
    run, file = learned
    clip = read_bvh(file)
    legs = [leg_length_of(each, humanoid_of(each)) for each in (clip.skeleton, run.skeleton)]
    assert recorded_speed(run) / legs[1] == pytest.approx(speed_of(walk_of(clip), STEP) / legs[0], rel=SPEED)


def test_it_walks_upright(walks: dict[float, Walk]):
    for walk in walks.values():
        roles = need_roles(walk.skeleton)
        hips = walk.height(roles.hips)
        assert hips.min() >= LOWEST * standing_hips(walk.skeleton)
        assert (walk.height(roles.head) - hips).min() >= HEAD


def test_its_legs_have_the_length_of_the_skeletons(walks: dict[float, Walk]):
    for walk in walks.values():
        body = humanoid_of(walk.skeleton)
        for joint in (body.left_shin, body.right_shin, body.left_foot, body.right_foot):
            assert joint is not None
            bone = np.linalg.norm(walk.points[:, joint] - walk.points[:, walk.skeleton.parents[joint]], axis=-1)
            np.testing.assert_allclose(bone, np.linalg.norm(walk.skeleton.offsets[joint]), atol=BONE)


def test_it_walks_at_the_recorded_speed(learned: tuple[Run, Path], walks: dict[float, Walk]):
    for walk in walks.values():
        assert speed_of(walk.without_ends(), CYCLE) == pytest.approx(recorded_speed(learned[0]), rel=SPEED)


def test_it_walks_the_circle_to_the_side_that_was_asked(walks: dict[float, Walk]):
    for radius, walk in walks.items():
        velocity = walk.without_ends().velocity(CYCLE)
        yaw = np.unwrap(np.arctan2(velocity[:, 0], velocity[:, 1]))
        length = np.linalg.norm(velocity, axis=-1)[:-1].sum() / walk.fps
        assert yaw[-1] - yaw[0] == pytest.approx(length / radius, rel=TURN)
