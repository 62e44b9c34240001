"""One browser tab: its character, its picture, its panel, and the thread that keeps them going."""

from __future__ import annotations

import threading
import time
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any

from pfnn_jax.errors import InputError, TrainingError
from pfnn_jax.viewer.actor import Actor
from pfnn_jax.viewer.learning import MOST_BYTES, GivenUp, learn_upload
from pfnn_jax.viewer.page_scene import PageScene
from pfnn_jax.viewer.panel import Panel
from pfnn_jax.viewer.stage import Stage

if TYPE_CHECKING:
    import viser

FRAME = 1.0 / 60.0
"""Seconds from one picture to the next; the simulation's own clock is the actor's."""

SLOWEST = 1.0 / 5.0
"""Seconds after which a picture is drawn even when steps are late."""

READOUT = 1.0 / 8.0
"""Seconds between new numbers, dials and charts."""

BUSY = 0.7
"""Share of a frame that work may take before pictures become rarer, so that steps come first."""

FAR_TOO_LARGE = 4 * MOST_BYTES
"""Bytes of an upload that are not even gathered; files between this and `MOST_BYTES` are refused with their name."""


class Tab:
    """Runs from `start` until `close`; nothing of it is left then.

    Args:
        client: the tab as viser knows it.
        stage: the runs.
    """

    def __init__(self, client: viser.ClientHandle, stage: Stage) -> None:
        self._client, self._stage = client, stage
        self._closed = threading.Event()
        self._learning = threading.Lock()
        self._drawn: deque[float] = deque(maxlen=240)
        self._thread = threading.Thread(target=self._live, name=f"tab {client.client_id}", daemon=True)

    def start(self) -> None:
        """Begins; returns at once."""
        self._thread.start()

    def close(self, wait: float = 2.0) -> None:
        """Ends the thread and waits for it at most `wait` seconds."""
        self._closed.set()
        if self._thread.ident is not None and self._thread is not threading.current_thread():
            self._thread.join(wait)

    @property
    def alive(self) -> bool:
        """Whether the thread is running."""
        return self._thread.is_alive()

    def _live(self) -> None:
        actor, scene = Actor(self._stage), PageScene(self._client.scene)
        panel = Panel(self._client, self._stage, actor, scene)

        async def uploaded(event: Any) -> None:  # not in one of viser's threads: the program's end waits for those
            work = partial(self._learn, actor, panel, event.target.value)
            threading.Thread(target=work, name="upload", daemon=True).start()

        panel.upload.on_upload(uploaded)
        view = actor.advance(time.monotonic())
        worn = ""
        drawn_at = shown_at = -1.0
        cost = 0.0
        while not self._closed.is_set():
            now = time.monotonic()
            self._refuse_large_uploads(panel)
            panel.serve(now)
            view = actor.advance(now)
            panel.add_contacts(view, now)
            stepped = time.monotonic() - now
            if now - drawn_at >= self._interval(stepped + cost, panel.rate):
                if view.skeleton_key != worn:
                    worn = view.skeleton_key
                    scene.wear(self._stage.cast(view.run).run.skeleton)
                    scene.settle(view)
                before = time.monotonic()
                with self._client.atomic():
                    scene.draw(view, min(now - drawn_at, SLOWEST))
                cost += 0.1 * (time.monotonic() - before - cost)
                drawn_at = now
                self._drawn.append(now)
            if now - shown_at >= READOUT:
                panel.show(view, now, sum(moment > now - 1.0 for moment in self._drawn))
                shown_at = now
            self._closed.wait(max(FRAME - (time.monotonic() - now), 0.001))

    def _interval(self, work: float, rate: float) -> float:
        """Seconds between pictures: no more than the browser shows, and as many as leave time for the steps.

        Args:
            work: seconds that a step and a picture take here.
            rate: pictures per second that the browser manages, 0 if that is not known.
        """
        browser = 0.9 * FRAME if rate > 50.0 else 1.0 / max(rate, 5.0) if rate else 2.0 * FRAME
        own = 0.0 if work <= BUSY * FRAME else min(3.0 * work, SLOWEST)
        return max(browser, own, 0.9 * FRAME)

    def _learn(self, actor: Actor, panel: Panel, file: viser.UploadedFile) -> None:
        """Learns the style of an uploaded clip and puts the character into it; runs beside the tab's thread."""
        if not self._learning.acquire(blocking=False):
            return
        run = actor.run
        try:
            panel.learning(True)
            style = learn_upload(self._stage, run, file.name, file.content, panel.progress)
            panel.clicks.put(lambda: panel.chosen(run, style), timeout=10.0)
            panel.tell("good", f"{style} is learned and among the styles of {run}.")
        except (InputError, TrainingError) as error:
            panel.tell("bad", str(error))
        except GivenUp:
            pass  # nobody is there to be told
        finally:
            panel.learning(False)
            self._learning.release()

    def _refuse_large_uploads(self, panel: Panel) -> None:
        """Viser gathers a file in memory before anybody sees it; what is far too large is dropped while it comes."""
        transfers = self._client.gui._current_file_upload_states
        for key, state in list(transfers.items()):
            if max(state["total_bytes"], state["transferred_bytes"]) > FAR_TOO_LARGE:
                transfers.pop(key, None)
                panel.tell("bad", f"{state['filename'][:80]}: the file is far larger than {MOST_BYTES / 1e6:g} MB")
