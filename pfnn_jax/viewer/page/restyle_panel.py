"""The controls that restyle a clip: two uploads, strength and parts, and the result as a player and for download."""

from __future__ import annotations

import html
import threading
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from pfnn_jax.errors import InputError
from pfnn_jax.motion.blending import PARTS
from pfnn_jax.transfer.finish import MAX_STRENGTH
from pfnn_jax.viewer.draw.palette import BUTTON, rgb
from pfnn_jax.viewer.page import background, widgets
from pfnn_jax.viewer.page.restyle import ClipUpload, Restyled, check_clip, restyle
from pfnn_jax.viewer.page.uploads import ACCEPTED, NICENESS
from pfnn_jax.workflows.samples import sample_clips

if TYPE_CHECKING:
    import viser

CONTENT, STYLE = "Upload the clip to restyle", "Upload a clip of the style"
"""Labels of the upload buttons."""

FIRST_NOTE = "Upload a clip, choose a style, and restyle it. The character walks on meanwhile."

MOST_STYLES = 8
"""Uploaded style clips that a tab keeps, the last ones; of two of one name, the later one counts."""

PLAYER_HEIGHT = 430  # pixels


class RestylePanel:
    """Restyles clips of one tab, one at a time, in a thread of its own.

    Args:
        client: the tab; the controls are added to its present folder.
    """

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client, gui = client, client.gui
        self._content: ClipUpload | None = None
        self._styles: dict[str, ClipUpload] = {}
        self._done: Restyled | None = None
        self._working, self._receiving = threading.Lock(), threading.Lock()
        samples = tuple(sample_clips())
        with gui.add_folder("Restyle a clip", expand_by_default=False):
            self.upload_content = gui.add_upload_button(CONTENT, mime_type=ACCEPTED)
            self.upload_style = gui.add_upload_button(STYLE, mime_type=ACCEPTED)
            self._style = gui.add_dropdown("Style of", samples, initial_value=samples[0])
            self._strength = gui.add_slider("Strength", 0.0, MAX_STRENGTH, step=0.05, initial_value=1.0)
            self._parts = gui.add_dropdown("Parts", PARTS, initial_value="all")
            self._begin = gui.add_button("Restyle", color=rgb(BUTTON))
            self._bar = gui.add_progress_bar(0.0, animated=True, visible=False)
            self._message = gui.add_html(widgets.message("plain", FIRST_NOTE))
            self._results = [
                gui.add_button(label, visible=False, color=rgb(BUTTON))
                for label in ("Show the result", "Download the result (BVH)", "Download the comparison (HTML)")
            ]
        for upload, take in ((self.upload_content, self._take_content), (self.upload_style, self._take_style)):
            upload.on_upload(self._receiver(take))
        actions = (self.begin, self.show, self._send_bvh, self._send_page)
        for button, action in zip((self._begin, *self._results), actions, strict=True):
            button.on_click(_in_thread(action))

    def show_message(self, kind: str, text: str) -> None:
        """Shows a message below the controls; `kind` is `good`, `bad` or `plain`."""
        self._message.content = widgets.message(kind, text)

    def begin(self) -> None:
        """Restyles the uploaded clip as chosen, and shows the result; returns when it is done."""
        if self._content is None:
            self.show_message("bad", f"Press “{CONTENT}” first.")
            return
        if not self._working.acquire(blocking=False):
            return
        try:
            self._active(True)
            with background.shown_errors(partial(self.show_message, "bad")):
                self._finish(restyle(self._content, self._chosen_style(), *self._settings(), self._progress))
        finally:
            self._active(False)
            self._working.release()

    def show(self) -> None:
        """Plays the content, the style and the result in step, above the page."""
        if self._done is None:
            return
        modal = self._client.gui.add_modal(self._done.title)
        with modal:
            self._client.gui.add_html(player_frame(self._done.page))
            self._client.gui.add_button("Close").on_click(_in_thread(modal.close))

    def _receiver(self, take: Callable[[str, bytes], None]) -> Any:
        """Returns a callback that takes an uploaded file, or shows why it is refused."""

        def work(filename: str, data: bytes) -> None:
            with self._receiving, background.shown_errors(partial(self.show_message, "bad")):
                background.do(partial(take, filename, data), niceness=NICENESS)

        async def received(event: Any) -> None:
            sent = event.target.value.name, event.target.value.content
            threading.Thread(target=work, args=sent, name="restyle", daemon=True).start()

        return received

    def _take_content(self, filename: str, data: bytes) -> None:
        self._content = check_clip(filename, data)
        self.show_message("plain", f"{self._content.name}: choose a style, and restyle it.")

    def _take_style(self, filename: str, data: bytes) -> None:
        clip = check_clip(filename, data)
        self._styles.pop(clip.name, None)
        self._styles = dict([*self._styles.items(), (clip.name, clip)][-MOST_STYLES:])
        self._style.options = tuple(dict.fromkeys((*self._styles, *sample_clips())))
        self._style.value = clip.name
        self.show_message("plain", f"The style is that of {clip.name}.")

    def _chosen_style(self) -> ClipUpload:
        """Returns the clip of the style that is chosen: an upload, or a sample.

        Raises:
            InputError: for a name that the page does not offer, which a browser can send.
        """
        name, samples = self._style.value, sample_clips()
        if name in self._styles:
            return self._styles[name]
        if name not in samples:
            raise InputError("page", "style", ascii(name)[:60], "must be one of the list")
        return ClipUpload(name, samples[name].read_bytes())

    def _settings(self) -> tuple[float, Any]:
        return float(self._strength.value), self._parts.value

    def _progress(self, share: float, what: str) -> None:
        self._bar.value = 100.0 * min(max(share, 0.0), 1.0)
        self.show_message("plain", what)

    def _active(self, active: bool) -> None:
        self._bar.visible, self._begin.disabled = active, active

    def _finish(self, done: Restyled) -> None:
        self._done = done
        for button in self._results:
            button.visible = True
        lines = [f"{done.title}: ready after {done.seconds:.1f} s.", *(f"Note: {note}." for note in done.notes)]
        self.show_message("good", "\n".join(lines))
        self.show()

    def _send_bvh(self) -> None:
        if self._done is not None:
            self._client.send_file_download(f"{self._done.name}.bvh", self._done.bvh, save_immediately=True)

    def _send_page(self) -> None:
        if self._done is not None:
            page = self._done.page.encode()
            self._client.send_file_download(f"{self._done.name}.html", page, save_immediately=True)


def player_frame(page: str) -> str:
    """Returns an iframe that holds a player's page and lets it run its script and nothing else."""
    wide = ".mantine-Modal-content{flex:0 0 min(94vw,1100px)!important;max-width:none!important}"
    return (
        f'<style>{wide}</style><iframe srcdoc="{html.escape(page, quote=True)}" sandbox="allow-scripts" title="motion" '
        f'style="width:100%;height:min({PLAYER_HEIGHT}px,70vh);border:0;display:block"></iframe>'
    )


def _in_thread(action: Callable[[], None]) -> Any:
    """Returns a callback that acts in a thread of its own: the end of the program waits for viser's."""

    async def act(_: Any) -> None:
        threading.Thread(target=action, name="restyle", daemon=True).start()

    return act
