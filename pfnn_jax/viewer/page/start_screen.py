"""What a tab shows until its character can move: the ground, the standing body, and how long the start takes.

Nothing here compiles anything. The body stands in the mean pose of the run's data, which its normaliser holds.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pfnn_jax.motion.features.layout import FrameLayout, layout_for
from pfnn_jax.motion.features.normaliser import Normaliser, load_normaliser
from pfnn_jax.motion.kinematics import quat_exp, quat_from_forward_up
from pfnn_jax.motion.retargeting.retarget import place_joints
from pfnn_jax.motion.skeleton import Skeleton, skeleton_from_json
from pfnn_jax.run_config import load_config
from pfnn_jax.viewer.page import widgets
from pfnn_jax.viewer.page.framing import Framing
from pfnn_jax.viewer.page.scene import PageScene
from pfnn_jax.viewer.page.view import View

if TYPE_CHECKING:
    import viser


@dataclass(frozen=True, eq=False)
class StandingBody:
    """A standing body.

    Attributes:
        run: name of the run, for the page's title.
        skeleton: of the run.
        view: the moment that is shown.
    """

    run: str
    skeleton: Skeleton
    view: View


def standing_body(run: str | Path, name: str) -> StandingBody:
    """Returns the body of a run as it stands before the run is loaded.

    Args:
        run: the run directory.
        name: of the run on the page.

    Raises:
        InputError: if its configuration or normaliser cannot be read.
    """
    path = Path(run)
    config = load_config(path)
    skeleton = skeleton_from_json(config.skeleton, path / "config.json")
    layout = layout_for(config.layout, skeleton)
    joints, rotations = mean_pose(layout, load_normaliser(path / "normaliser"), skeleton)
    return StandingBody(name, skeleton, _standing_view(name, joints, rotations))


def mean_pose(layout: FrameLayout, normaliser: Normaliser, skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Returns positions [J, 3] in metres and world rotations [J, 4] of the mean pose of the data, feet on the ground.

    Args:
        layout: of the normaliser's rows.
        normaliser: statistics of the data.
        skeleton: with the layout's joints.
    """
    mean, std = np.asarray(normaliser.outputs.mean, float), np.asarray(normaliser.outputs.std, float)

    def block(values: np.ndarray, name: str) -> np.ndarray:
        return values[layout.output_slice(name)].reshape(-1, 3)

    if layout.has_output("joint_rotation"):
        rotations = np.asarray(quat_exp(block(mean, "joint_rotation")))
    else:
        rotations = np.asarray(quat_from_forward_up(block(mean, "joint_forward"), block(mean, "joint_up")))
    joints = place_joints(skeleton, block(mean, "joint_position")[0] * layout.length_unit, rotations)
    if skeleton.roles is not None:
        feet = [*skeleton.roles.left_foot, *skeleton.roles.right_foot]
        # In most frames of any gait a foot is near the ground, about one standard deviation below its mean height.
        heights = (block(mean, "joint_position") - block(std, "joint_position"))[feet, 1] * layout.length_unit
        joints[:, 1] -= np.min(joints[feet, 1] - heights)
    return joints, rotations


def _standing_view(run: str, joints: np.ndarray, rotations: np.ndarray) -> View:
    here, ahead = np.zeros((1, 2)), np.array([[0.0, 1.0]])
    return View(
        run=run,
        frame=0,
        joints=joints,
        world_rotations=rotations,
        root=here[0],
        facing=ahead[0],
        past_positions=here,
        past_directions=ahead,
        future_positions=here,
        future_directions=ahead,
        contacts=np.ones(4),
    )


class StartProgress:
    """How far the start of the page is. Safe to use from several threads.

    Args:
        expected: seconds that it took the last time on this machine; None if unknown.
        clock: returns seconds.
    """

    def __init__(self, expected: float | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._began, self._what = clock, clock(), "Starting"
        self.expected = expected

    def report(self, what: str) -> None:
        """Notes what is being done now."""
        self._what = what

    @property
    def seconds(self) -> float:
        """Seconds since the beginning."""
        return self._clock() - self._began

    def html(self) -> str:
        """Returns what is being done, how long it has taken, and about how long it still takes, if that is known."""
        return widgets.start_note(self._what, self.seconds, self.expected)


class WaitingTab:
    """A tab whose runs are still being loaded: it shows the standing body.

    Args:
        client: the tab.
        body: the standing body; None shows nothing.

    Attributes:
        scene: of the tab, which its character takes over; None without a body.
    """

    def __init__(self, client: viser.ClientHandle, body: StandingBody | None) -> None:
        self.client, self.scene = client, None if body is None else PageScene(client.scene)
        self._framing = Framing(client)
        if body is not None and self.scene is not None:
            with client.atomic():
                self.scene.set_skeleton(body.skeleton)
                self.scene.jump_to(body.view)
                self.scene.draw(body.view, 1.0)

    def update(self) -> None:
        """Puts the body where it can be seen, in a window of any shape."""
        if self.scene is not None:
            self._framing.update()


class Ticker:
    """Calls a function once a second in a thread of its own, until it is stopped."""

    def __init__(self, action: Callable[[], None], seconds: float = 1.0) -> None:
        self._action, self._seconds, self._stopped = action, seconds, threading.Event()
        threading.Thread(target=self._run, name="start", daemon=True).start()

    def stop(self) -> None:
        """Ends the calls; one may still be running."""
        self._stopped.set()

    def _run(self) -> None:
        while not self._stopped.wait(self._seconds):
            self._action()
