"""What does a body cost the page: bytes sent and computing time for each picture, by the number of joints?

Question  does a skinned body of many joints leave a laptop room for 30 pictures a second?
Data      a synthetic walk, with leaf joints that turn added up to 22, 67 and 141; or characters that are worn.
Expect    docs/results_appendix.md, "Bodies of the page".
Run       python -m experiments.page_bodies [--worn CHARACTER.glb ...]
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
import viser
import websockets

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import forward_kinematics, quat_from_axis_angle
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.viewer.page.scene import PageScene
from pfnn_jax.viewer.page.view import View
from pfnn_jax.viewer.page.worn_character import WornCharacter, read_worn_character

JOINTS = (22, 67, 141)

PICTURES, SPACING = 60, 0.1
"""Pictures, and seconds between them: rarer than on the page, so that each is sent by itself on a busy machine too."""


@dataclass(frozen=True)
class Config:
    """Settings.

    Attributes:
        worn: characters to wear; by default the body of the page is drawn.
    """

    worn: tuple[Path, ...] = ()


class Received:
    """Counts what a browser would receive from a server."""

    def __init__(self, port: int) -> None:
        self.count = 0
        self._url = f"ws://127.0.0.1:{port}"
        threading.Thread(target=lambda: asyncio.run(self._listen()), daemon=True).start()

    async def _listen(self) -> None:
        protocols = [websockets.Subprotocol(f"viser-v{viser.__version__}")]
        with contextlib.suppress(websockets.ConnectionClosed):
            async with websockets.connect(self._url, subprotocols=protocols, max_size=None, compression=None) as socket:
                async for message in socket:
                    self.count += len(message)


def with_joints(clip: MotionClip, count: int) -> MotionClip:
    """Returns the clip with leaf joints added, all of which turn, up to a number of joints."""
    skeleton, generator = clip.skeleton, np.random.default_rng(0)
    extra = count - skeleton.num_joints
    angles = 0.5 * np.sin(np.arange(clip.num_frames)[:, None] / 9 + generator.uniform(0, 6, extra))
    larger = replace(
        skeleton,
        names=(*skeleton.names, *(f"leaf {number}" for number in range(extra))),
        parents=np.append(skeleton.parents, generator.integers(0, skeleton.num_joints, extra)),
        offsets=np.concatenate([skeleton.offsets, np.tile([[0.0, 0.05, 0.0]], (extra, 1))]),
        mirror=np.arange(count),
    )
    turns = quat_from_axis_angle(np.array([1.0, 0.0, 0.0]), angles)
    return replace(clip, skeleton=larger, rotations=np.concatenate([clip.rotations, turns], axis=1))


def moments(clip: MotionClip) -> list[View]:
    """Returns every second step of a clip as the page draws it, with a trajectory."""
    positions, rotations = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    roots, ahead = positions[:, 0][:, [0, 2]], np.array([0.0, 1.0])
    return [
        View(
            run="run",
            frame=t,
            joints=positions[t],
            world_rotations=rotations[t],
            root=roots[t],
            facing=ahead,
            past_positions=roots[t - 60 : t + 1 : 10],
            past_directions=np.tile(ahead, (7, 1)),
            future_positions=roots[t : t + 60 : 10],
            future_directions=np.tile(ahead, (6, 1)),
            contacts=np.abs(np.sin(t / 10 + np.arange(4))),
        )
        for t in range(60, clip.num_frames - 60, 2)
    ]


def measure(clip: MotionClip, worn: WornCharacter | None = None) -> tuple[float, float]:
    """Returns kilobytes and milliseconds of computing for a picture, the median of the latter."""
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    received = Received(server.get_port())
    scene, views, times = PageScene(server.scene), moments(clip), []
    scene.set_skeleton(clip.skeleton)
    if worn is not None:
        scene.wear(worn)
    time.sleep(2.0)  # until the page is set up
    before = received.count
    for number in range(PICTURES):
        begun = time.thread_time()
        with server.atomic():
            scene.draw(views[number % len(views)], 1 / 30)
        times.append(1e3 * (time.thread_time() - begun))
        time.sleep(SPACING)
    sent = (received.count - before) / 1e3 / PICTURES
    server.stop()
    return sent, float(np.median(times))


def main(config: Config) -> None:
    """Prints a row for each body."""
    clip, _ = synthesise("zombie", np.zeros(300), np.full(300, 1.2))
    print("| body | joints | kB a picture | ms a picture |\n| --- | --- | --- | --- |")
    bodies = [read_worn_character(path.name, path.read_bytes()) for path in config.worn]
    for worn in bodies:
        sent, spent = measure(clip, worn)
        print(f"| {worn.name}, worn | {worn.skeleton.num_joints} | {sent:.1f} | {spent:.1f} |", flush=True)
    for joints in () if bodies else JOINTS:
        sent, spent = measure(with_joints(clip, joints))
        print(f"| its own | {joints} | {sent:.1f} | {spent:.1f} |", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Config))
