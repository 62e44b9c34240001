"""One browser tab: its character, its picture, its panel, and the thread that keeps them going."""

from __future__ import annotations

import threading
import time
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any

from pfnn_jax.errors import InputError, TrainingError
from pfnn_jax.viewer.page.character import Character
from pfnn_jax.viewer.page.panel import Panel
from pfnn_jax.viewer.page.run_library import RunLibrary
from pfnn_jax.viewer.page.scene import PageScene
from pfnn_jax.viewer.page.uploads import GivenUp, drop_large, learn_upload

if TYPE_CHECKING:
    import viser

FRAME = 1.0 / 60.0
"""Seconds from one picture to the next; the simulation's own clock is the character's."""

SLOWEST = 1.0 / 5.0
"""Seconds after which a picture is drawn even when steps are late."""

READOUT = 1.0 / 8.0
"""Seconds between new numbers, dials and charts."""

MOST_TOLD = 300
"""Characters of an error that nobody has expected."""

BUSY = 0.7
"""Share of a frame that work may take before pictures become rarer, so that steps come first."""


class Tab:
    """Runs from `start` until `close`; nothing of it is left then.

    Args:
        client: the tab as viser knows it.
        library: the runs.
    """

    def __init__(self, client: viser.ClientHandle, library: RunLibrary) -> None:
        self._client, self._library = client, library
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
        try:
            self._play()
        except Exception as error:
            if self._closed.is_set():  # nobody is there to be told
                return
            text = f"{type(error).__name__}: {error}"[:MOST_TOLD]
            self._client.add_notification("The character has stopped: load the page anew", text, color="red")
            raise

    def _play(self) -> None:
        character, scene = Character(self._library), PageScene(self._client.scene)
        panel = Panel(self._client, self._library, character, scene)

        async def uploaded(event: Any) -> None:  # not in one of viser's threads: the program's end waits for those
            work = partial(self._learn, character, panel, event.target.value)
            threading.Thread(target=work, name="upload", daemon=True).start()

        panel.upload.on_upload(uploaded)
        view = character.advance(time.monotonic())
        worn = ""
        drawn_at = shown_at = -1.0
        cost = 0.0
        while not self._closed.is_set():
            now = time.monotonic()
            for refusal in drop_large(self._client.gui._current_file_upload_states):
                panel.tell("bad", refusal)
            panel.serve(now)
            view = character.advance(now)
            panel.add_contacts(view, now)
            stepped = time.monotonic() - now
            if now - drawn_at >= self._interval(stepped + cost, panel.rate):
                if view.run != worn:
                    worn = view.run
                    scene.wear(self._library.get(view.run).run.skeleton)
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

    def _learn(self, character: Character, panel: Panel, file: viser.UploadedFile) -> None:
        """Learns the style of an uploaded clip and puts the character into it; runs beside the tab's thread."""
        if not self._learning.acquire(blocking=False):
            panel.notify(
                f"{file.name[:80]} is not learned", "Another file is being learned: upload it again after that."
            )
            return
        run = character.run
        try:
            panel.learning(True)
            style = learn_upload(self._library, run, file.name, file.content, panel.progress)
            panel.clicks.put(lambda: panel.learned(run, style), timeout=10.0)
        except (InputError, TrainingError) as error:
            panel.tell("bad", str(error))
        except GivenUp:
            pass  # nobody is there to be told
        except Exception as error:  # whoever waits for a style must hear that it does not come
            panel.tell("bad", f"{file.name[:80]}: {type(error).__name__}: {error}"[:MOST_TOLD])
            raise
        finally:
            panel.learning(False)
            self._learning.release()
