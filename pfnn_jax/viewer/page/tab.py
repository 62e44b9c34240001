"""One browser tab: its character, its scene, its panels, and the thread that runs them."""

from __future__ import annotations

import threading
import time
from collections import deque
from functools import partial
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from pfnn_jax.errors import InputError
from pfnn_jax.viewer.page import background
from pfnn_jax.viewer.page.character import Character
from pfnn_jax.viewer.page.frame_scheduler import SLOWEST, FrameScheduler, picture_interval
from pfnn_jax.viewer.page.panel import STANDING, Panel
from pfnn_jax.viewer.page.run_library import RunLibrary
from pfnn_jax.viewer.page.scene import PageScene
from pfnn_jax.viewer.page.uploads import LONGEST_NAME, WAITING, LearningCancelled, drop_large, learn_upload
from pfnn_jax.workflows.samples import sample_clips

if TYPE_CHECKING:
    import viser

READOUT = 1.0 / 8.0
"""Seconds between updates of numbers, dials and charts."""


class Tab:
    """Runs from `start` until `close`, and leaves nothing behind.

    Args:
        client: viser's handle of the tab.
        library: the runs.
        scene: of the tab, if it has one already.
    """

    def __init__(self, client: viser.ClientHandle, library: RunLibrary, scene: PageScene | None = None) -> None:
        self._client, self._library, self._scene = client, library, scene
        self._closed = threading.Event()
        self._wake = threading.Event()  # set by input; the panel's, once there is one
        self._learning = threading.Lock()
        self._drawn: deque[float] = deque(maxlen=240)
        self._thread = threading.Thread(target=self._live, name=f"tab {client.client_id}", daemon=True)

    def start(self) -> None:
        """Starts the thread; returns at once."""
        self._thread.start()

    def close(self, wait: float = 2.0) -> None:
        """Ends the thread and waits for at most `wait` seconds."""
        self._closed.set()
        self._wake.set()
        if self._thread.ident is not None and self._thread is not threading.current_thread():
            self._thread.join(wait)

    @property
    def alive(self) -> bool:
        """Whether the thread is running."""
        return self._thread.is_alive()

    def _live(self) -> None:
        try:
            self._play()
        except Exception as error:
            if self._closed.is_set():  # the tab is closed already
                return
            title = "Simulation stopped; reload the page"
            self._client.add_notification(title, background.unexpected(error), color="red")
            raise

    def _play(self) -> None:
        character, scene = Character(self._library), self._scene or PageScene(self._client.scene)
        panel = Panel(self._client, self._library, character, scene)

        def learn(filename: str, content: bytes) -> None:
            # In a thread of its own: the end of the program waits for viser's.
            work = partial(self._learn, character, panel, filename, content)
            threading.Thread(target=work, name="upload", daemon=True).start()

        async def uploaded(event: Any) -> None:
            panel.wear.take_clip(event.target.value.name, event.target.value.content)

        async def tried(event: Any) -> None:
            path = sample_clips().get(event.target.value)
            if path is not None:  # a browser can send names that its page does not offer
                learn(path.name, path.read_bytes())

        panel.wear.serve_learning(learn, panel.show_message)
        panel.upload.on_upload(uploaded)
        panel.samples.on_click(tried)
        self._wake = panel.wake
        self._follow(character, panel, scene)

    def _follow(self, character: Character, panel: Panel, scene: PageScene) -> None:
        """Serves, steps and draws until the tab is closed; waits for input while nobody needs a picture."""
        scheduler, view = FrameScheduler(), character.advance(time.monotonic())
        run, cost, drawn_at, shown_at = "", 0.0, -1.0, -1.0
        while not self._closed.is_set():
            now = time.monotonic()
            for refusal in drop_large(self._client.gui._current_file_upload_states):
                panel.show_message("bad", refusal)
            panel.serve(now)
            moving = view.speed > STANDING or view.wanted_speed > 0.0 or view.recording
            plan = scheduler.plan(now, visible=panel.visible(now), moving=moving, touched=panel.take_touched())
            if plan.steps:
                view = character.advance(now)
                panel.add_contacts(view, now)
                stepped = time.monotonic() - now
                if now - drawn_at >= max(plan.interval, picture_interval(stepped + cost, panel.rate)):
                    if view.run != run:
                        run = view.run
                        panel.wear.set_skeleton(self._library.get(view.run).run.skeleton)
                        scene.jump_to(view)
                    before = time.monotonic()
                    with self._client.atomic():
                        scene.draw(view, min(now - drawn_at, SLOWEST))
                    cost += 0.1 * (time.monotonic() - before - cost)
                    drawn_at = now
                    self._drawn.append(now)
                if now - shown_at >= READOUT:
                    panel.show(view, now, sum(moment > now - 1.0 for moment in self._drawn))
                    shown_at = now
            panel.wake.wait(max(plan.wait - (time.monotonic() - now), 0.001))
            panel.wake.clear()

    def _learn(self, character: Character, panel: Panel, filename: str, content: bytes) -> None:
        """Learns the style of a clip and changes the character to it, outside the tab's thread.

        Args:
            character: of the tab.
            panel: of the tab.
            filename: of an upload or a sample clip.
            content: the bytes of that file.
        """
        if not self._learning.acquire(blocking=False):
            panel.notify(
                f"{filename[:80]} is not learned", "Another clip is being learned; try this one again afterwards."
            )
            return
        run, board, name = character.run, self._library.learning, panel.take_name()
        try:
            job = board.begin(run, (name or PurePath(filename).stem)[:LONGEST_NAME])
        except InputError as error:
            self._learning.release()
            panel.return_name(name)
            panel.notify(f"{filename[:80]} is not learned", str(error))
            return

        def report(share: float, what: str) -> None:
            board.report(job, share, what == WAITING)

        def fail(error: str) -> None:
            panel.return_name(name)
            board.end(job, error=error)

        try:
            panel.learning(True)
            with background.shown_errors(fail, filename[:80]):
                try:
                    learned = learn_upload(self._library, run, filename, content, report, name=name)
                except LearningCancelled:
                    board.end(job)  # the tab is closed already
                    return
                panel.clicks.put(lambda: panel.learned(run, learned), timeout=10.0)
                board.end(job, learned)
        finally:
            panel.learning(False)
            panel.wake.set()
            self._learning.release()
