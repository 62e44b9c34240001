"""The controls with which a tab wears a character of a file, and the choice for files that hold body and motion."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip_files import CHARACTER_SUFFIXES
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.viewer.draw.palette import BUTTON, rgb
from pfnn_jax.viewer.page import background, widgets
from pfnn_jax.viewer.page.scene import PageScene
from pfnn_jax.viewer.page.uploads import NICENESS
from pfnn_jax.viewer.page.worn_character import (
    FileContent,
    WornCharacter,
    clip_bytes,
    read_content,
    read_worn_character,
)

if TYPE_CHECKING:
    import viser

WEAR = "Wear a character"
"""Label of the upload button."""

CHARACTERS = ",".join(CHARACTER_SUFFIXES)
"""What the browser's dialog offers for it."""

FIRST_NOTE = "Drop in a rigged GLB or VRM character and drive it."

CHOOSE = "Choose under Character."
"""Where to answer what is asked about a file."""

NOTICE_SECONDS = 10.0
"""After which a notice of the question goes; the question itself stays below the controls."""

NOTHING = ("", b"", FileContent("", (), False))
"""Name, bytes and content of no file."""

Learn = Callable[[str, bytes], None]
"""Learns the style of a clip, given the name and the bytes of its file."""


class WearPanel:
    """Wears characters in one tab, one at a time.

    Args:
        client: the tab; the controls are added to its present folder.
        scene: of the tab.
        clicks: of the tab's thread, which alone changes the scene.
        wake: set to end a pause of the tab.

    Attributes:
        upload: the upload button.
    """

    def __init__(
        self, client: viser.ClientHandle, scene: PageScene, clicks: queue.Queue[Any], wake: threading.Event
    ) -> None:
        self._client, self._scene, self._clicks, self._wake = client, scene, clicks, wake
        self._working = threading.Lock()
        self._learn: Learn = lambda filename, data: None
        self._refuse: Callable[[str, str], None] = self.show_message
        self._given: tuple[str, bytes, FileContent] = NOTHING
        gui = client.gui
        with gui.add_folder("Character"):
            self.upload = gui.add_upload_button(WEAR, mime_type=CHARACTERS)
            self._off = gui.add_button("Own body", visible=False, color=rgb(BUTTON))
            self._message = gui.add_html(widgets.message("plain", FIRST_NOTE))
            self._clip: Any = gui.add_dropdown("Motion", ("",), visible=False)
            self._learn_it = gui.add_button("Learn its style", visible=False, color=rgb(BUTTON))
            self._wear_it = gui.add_button("Wear it", visible=False, color=rgb(BUTTON))
        self._off.on_click(self._in_thread(self._take_off))
        self._learn_it.on_click(self._in_thread(self._learn_chosen))
        self._wear_it.on_click(self._in_thread(self._wear_given))

    def serve_learning(self, learn: Learn, refuse: Callable[[str, str], None]) -> None:
        """Sets what is done with the motion of a file, and begins to take characters.

        Args:
            learn: learns from it; returns at once.
            refuse: shows a message of a kind where clips are uploaded.
        """
        self._learn, self._refuse = learn, refuse

        async def uploaded(event: Any) -> None:
            self._act(partial(self.receive, event.target.value.name, event.target.value.content, wear=True))

        self.upload.on_upload(uploaded)

    def take_clip(self, filename: str, data: bytes) -> None:
        """Takes a file that was sent to be learned from; returns at once."""
        self._act(partial(self.receive, filename, data, wear=False), self._refuse)

    def receive(self, filename: str, data: bytes, *, wear: bool) -> None:
        """Does what is wanted of a file; asks where it holds something else, or both. Returns when it is done.

        Args:
            filename: as sent by the browser.
            data: the file's bytes.
            wear: whether it was sent to be worn, else to be learned from.

        Raises:
            InputError: for a file that cannot be taken.
        """
        content = background.do(partial(read_content, filename, data), niceness=NICENESS)
        self._given = filename, data, content
        if wear and content.body:
            self._ask(content._replace(body=False), "")
            self._wear_given()
        elif not wear and len(content.clips) == 1 and not content.body:
            self._ask(content._replace(clips=(), body=False), "")
            self._learn_given(content.clips[0])
        else:
            question = _question(content)
            self._ask(content, question)
            self._client.add_notification(question, CHOOSE, auto_close_seconds=NOTICE_SECONDS)
            if not wear:
                self._refuse("plain", CHOOSE)

    def set_skeleton(self, skeleton: Skeleton) -> None:
        """Sets the skeleton that is driven; takes a character off that its motion cannot be put onto, and says so."""
        try:
            self._scene.set_skeleton(skeleton)
        except InputError as error:
            self._off.visible = False
            self.show_message("bad", str(error))

    def show_message(self, kind: str, text: str) -> None:
        """Shows a message below the controls; `kind` is `good`, `bad` or `plain`."""
        self._message.content = widgets.message(kind, text)

    def _ask(self, content: FileContent, question: str) -> None:
        """Shows the buttons for what a file holds."""
        if content.clips:
            self._clip.options = content.clips
            self._clip.value = content.clips[0]
        self._clip.visible = len(content.clips) > 1
        self._learn_it.visible, self._wear_it.visible = bool(content.clips), content.body
        if question:
            self.show_message("plain", question)

    def _wear_given(self) -> None:
        self.show_message("plain", f"Reading {self._given[0][:80]} …")
        filename, data, _ = self._given
        worn = background.do(partial(read_worn_character, filename, data), niceness=NICENESS)
        self._wear_it.visible = False
        self._put(partial(self._wear, worn))

    def _learn_chosen(self) -> None:
        self._learn_given(self._clip.value)

    def _learn_given(self, clip: str) -> None:
        filename, data = background.do(partial(clip_bytes, *self._given, clip), niceness=NICENESS)
        self._learn(filename, data)

    def _take_off(self) -> None:
        self._put(partial(self._wear, None))

    def _wear(self, worn: WornCharacter | None) -> None:
        """Changes what the tab draws, in its thread."""
        try:
            self._scene.wear(worn)
        except InputError as error:
            self.show_message("bad", str(error))
            return
        self._off.visible = worn is not None
        if worn is None:
            self.show_message("plain", FIRST_NOTE)
        else:
            size = f"{worn.skeleton.num_joints} joints, {len(worn.mesh.faces)} triangles"
            self.show_message("good", f"{worn.name} ({size}) is worn: drive it with W, A, S and D.")

    def _put(self, action: Callable[[], None]) -> None:
        self._clicks.put(action, timeout=10.0)
        self._wake.set()

    def _in_thread(self, action: Callable[[], None]) -> Any:
        async def act(_: Any) -> None:
            self._act(action)

        return act

    def _act(self, action: Callable[[], None], say: Callable[[str, str], None] | None = None) -> None:
        """Acts in a thread of its own, because the end of the program waits for viser's; one at a time."""
        say = say or self.show_message

        def work() -> None:
            if not self._working.acquire(blocking=False):
                say("bad", "Another file is being read; try this one again afterwards.")
                return
            try:
                with background.shown_errors(partial(say, "bad")):
                    action()
            finally:
                if not (self._learn_it.visible or self._wear_it.visible):
                    self._given = NOTHING  # it can hold many megabytes
                self._working.release()

        threading.Thread(target=work, name="wear", daemon=True).start()


def _question(content: FileContent) -> str:
    """Returns what to say of a file that holds something else than was wanted, or both."""
    if not content.body:
        return f"{content.name} holds a motion and no body: learn its style?"
    if not content.clips:
        return f"{content.name} holds a character and no motion to learn from: wear it?"
    motions = "a motion" if len(content.clips) == 1 else f"{len(content.clips)} motions"
    return f"{content.name} holds a character and {motions}: wear it, or learn from it?"
