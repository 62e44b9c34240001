"""One browser tab: its character, its scene, its panels, and the thread that runs them."""

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
from pfnn_jax.viewer.page.uploads import LearningCancelled, drop_large, learn_upload
from pfnn_jax.workflows.samples import sample_clips

if TYPE_CHECKING:
    import viser

FRAME = 1.0 / 60.0
"""Seconds between pictures; the simulation has the character's own clock."""

SLOWEST = 1.0 / 5.0
"""Seconds after which a picture is drawn even if steps are late."""

READOUT = 1.0 / 8.0
"""Seconds between updates of numbers, dials and charts."""

LONGEST_ERROR = 300
"""Characters shown of an unexpected error."""

BUSY = 0.7
"""Fraction of a frame that computing may take before fewer pictures are drawn, so that steps are in time."""


class Tab:
    """Runs from `start` until `close`, and leaves nothing behind.

    Args:
        client: viser's handle of the tab.
        library: the runs.
    """

    def __init__(self, client: viser.ClientHandle, library: RunLibrary) -> None:
        self._client, self._library = client, library
        self._closed = threading.Event()
        self._learning = threading.Lock()
        self._drawn: deque[float] = deque(maxlen=240)
        self._thread = threading.Thread(target=self._live, name=f"tab {client.client_id}", daemon=True)

    def start(self) -> None:
        """Starts the thread; returns at once."""
        self._thread.start()

    def close(self, wait: float = 2.0) -> None:
        """Ends the thread and waits for at most `wait` seconds."""
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
            if self._closed.is_set():  # the tab is closed already
                return
            text = f"{type(error).__name__}: {error}"[:LONGEST_ERROR]
            self._client.add_notification("Simulation stopped; reload the page", text, color="red")
            raise

    def _play(self) -> None:
        character, scene = Character(self._library), PageScene(self._client.scene)
        panel = Panel(self._client, self._library, character, scene)

        def learn(filename: str, content: bytes) -> None:
            # In a thread of its own: the end of the program waits for viser's.
            work = partial(self._learn, character, panel, filename, content)
            threading.Thread(target=work, name="upload", daemon=True).start()

        async def uploaded(event: Any) -> None:
            panel.wardrobe.take_clip(event.target.value.name, event.target.value.content)

        async def tried(event: Any) -> None:
            path = sample_clips().get(event.target.value)
            if path is not None:  # a browser can send names that its page does not offer
                learn(path.name, path.read_bytes())

        panel.wardrobe.serve_learning(learn, panel.show_message)
        panel.upload.on_upload(uploaded)
        panel.samples.on_click(tried)
        view = character.advance(time.monotonic())
        run = ""
        drawn_at = shown_at = -1.0
        cost = 0.0
        while not self._closed.is_set():
            now = time.monotonic()
            for refusal in drop_large(self._client.gui._current_file_upload_states):
                panel.show_message("bad", refusal)
            panel.serve(now)
            view = character.advance(now)
            panel.add_contacts(view, now)
            stepped = time.monotonic() - now
            if now - drawn_at >= self._interval(stepped + cost, panel.rate):
                if view.run != run:
                    run = view.run
                    scene.set_skeleton(self._library.get(view.run).run.skeleton)
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
            self._closed.wait(max(FRAME - (time.monotonic() - now), 0.001))

    def _interval(self, work: float, rate: float) -> float:
        """Returns the seconds between pictures: not more than the browser can show and than the steps leave time for.

        Args:
            work: seconds that a step and a picture take.
            rate: pictures per second that the browser manages, 0 if unknown.
        """
        browser = 0.9 * FRAME if rate > 50.0 else 1.0 / max(rate, 5.0) if rate else 2.0 * FRAME
        own = 0.0 if work <= BUSY * FRAME else min(3.0 * work, SLOWEST)
        return max(browser, own, 0.9 * FRAME)

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
        run = character.run
        try:
            panel.learning(True)
            learned = learn_upload(self._library, run, filename, content, panel.progress)
            panel.clicks.put(lambda: panel.learned(run, learned), timeout=10.0)
        except (InputError, TrainingError) as error:
            panel.show_message("bad", str(error))
        except LearningCancelled:
            pass  # the tab is closed already
        except Exception as error:  # unexpected, but the page must show that no style is coming
            panel.show_message("bad", f"{filename[:80]}: {type(error).__name__}: {error}"[:LONGEST_ERROR])
            raise
        finally:
            panel.learning(False)
            self._learning.release()
