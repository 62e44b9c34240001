"""The panels of a tab: controls, readouts, uploads and downloads."""

from __future__ import annotations

import math
import queue
import threading
import time
from typing import TYPE_CHECKING, Any, Literal

from pfnn_jax.errors import InputError
from pfnn_jax.viewer.draw.palette import BUTTON, HEEL, LEFT, RIGHT, TOE, rgb
from pfnn_jax.viewer.page import widgets
from pfnn_jax.viewer.page.character import Character
from pfnn_jax.viewer.page.downloads import Downloads
from pfnn_jax.viewer.page.drive_input import parse_message
from pfnn_jax.viewer.page.restyle_panel import RestylePanel
from pfnn_jax.viewer.page.run_library import RunLibrary
from pfnn_jax.viewer.page.scene import PageScene, camera_yaw, look_from_behind
from pfnn_jax.viewer.page.style_picker import StylePicker
from pfnn_jax.viewer.page.uploads import ACCEPTED, LearnedUpload
from pfnn_jax.viewer.page.view import View
from pfnn_jax.viewer.page.wardrobe import Wardrobe
from pfnn_jax.viewer.page.widgets import CONTACT_SECONDS, FieldChanges, Timeline
from pfnn_jax.workflows.samples import sample_clips

if TYPE_CHECKING:
    import viser

DRIVE = "Stick and keys"
"""Label of the text field through which the page's script sends its messages; the script finds it by the label."""

TIMEOUT = 1.0
"""Seconds without a message after which everything counts as released: the script sends five messages a second while
something is held."""

SPEEDS = (0.3, 3.0)  # metres per second
KEYS = {
    "w": "Ahead",
    "a": "Left",
    "s": "Back",
    "d": "Right",
    "q": "Turn left",
    "e": "Turn right",
}
FEET = {"left": LEFT, "right": RIGHT, "heel": HEEL, "toe": TOE}
STANDING = 0.05  # m/s; slower counts as standing
TURNED = math.radians(0.5)  # dead zone of the camera: smaller rotations are not user input
QUEUED = 64  # presses and clicks that may wait


class Panel:
    """The controls and readouts of a tab.

    Clicks and keys wait in a bounded queue, and values in their fields, until `serve` is called, so that only the tab's
    thread moves its character.

    Args:
        client: the tab.
        library: the runs.
        character: the tab's character.
        scene: the tab's scene.

    Attributes:
        clicks: pending actions, functions without arguments.
        upload: the upload button.
        samples: the buttons of the sample clips.
        restyle: the controls that restyle a clip.
        rate: pictures per second that the browser manages, 0 while unknown.
    """

    def __init__(self, client: viser.ClientHandle, library: RunLibrary, character: Character, scene: PageScene) -> None:
        self._client, self._gui, self._library, self._character, self._scene = (
            client,
            client.gui,
            library,
            character,
            scene,
        )
        self.clicks: queue.Queue[Any] = queue.Queue(QUEUED)
        self.rate = 0.0
        self.wake = threading.Event()
        self._held, self._heard = "", -math.inf
        self._look: float | None = None
        self._walked = (character.run, character.shares)
        self._values = FieldChanges()
        self._build_readouts()
        self._drive()
        with self._gui.add_folder("Style"):
            self._picker = StylePicker(self._gui, library, character)
        self._files()
        self.wardrobe = Wardrobe(client, scene, self.clicks, self.wake)
        self.restyle = RestylePanel(client)
        self._gait()
        self._camera()
        self._commands()
        self._gui.add_html(widgets.script())

    def serve(self, now: float) -> None:
        """Applies everything pressed and chosen since the last call; `now` in seconds of the character's clock."""
        self._picker.refresh()
        for _ in range(QUEUED):
            try:
                self.clicks.get_nowait()()
            except queue.Empty:
                break
            except InputError as error:
                self.show_message("bad", str(error))
        self._read_stick(now)
        try:
            self._read_fields(now)
        except (InputError, ValueError) as error:  # a browser can send values that its page does not offer
            self.show_message("bad", str(error))

    def show(self, view: View, now: float, drawn: float) -> None:
        """Updates the readouts.

        Args:
            view: the moment.
            now: seconds of the character's clock.
            drawn: pictures per second.
        """
        self._readout.content = widgets.readout(view, drawn, self.rate, widgets.UNSEEN if self._unseen(view) else "")
        self._dial.content = widgets.phase_dial(view.dials)
        self._timeline.show(now)
        self._downloads.refresh()
        seconds = view.recorded_seconds
        stop = "Stop and download" if view.recording else "Download"
        self._record.label = "Record" if seconds is None else f"{stop} ({seconds:.1f} s)"

    def add_contacts(self, view: View, now: float) -> None:
        """Appends a moment to the contact chart."""
        self._timeline.add(now, view.contacts)

    def show_message(self, kind: str, text: str) -> None:
        """Shows a message below the upload button; `kind` is `good`, `warning`, `bad` or `plain`."""
        self._message.content = widgets.message(kind, text)

    def notify(self, title: str, text: str, color: Literal["red", "yellow"] = "red") -> None:
        """Shows a notice above everything until it is closed."""
        self._client.add_notification(title, text, color=color)

    def progress(self, share: float, text: str) -> None:
        """Shows the fraction of learning that is done, 0 to 1; callable from any thread."""
        self._bar.value = 100.0 * min(max(share, 0.0), 1.0)
        self.show_message("plain", text)

    def learning(self, active: bool) -> None:
        """Shows or hides the progress bar; meanwhile no other clip can be learned."""
        self._bar.visible = active
        self.upload.disabled = active
        self.samples.visible = not active  # viser cannot disable these buttons

    def learned(self, run: str, learned: LearnedUpload) -> None:
        """Changes the character to a style that was learned for it, unless another run has been chosen meanwhile.

        Args:
            run: the run that has learned it.
            learned: the style. Its notes are shown below the message of success, its warnings in place of it, with a
                notice, as the message may be out of sight.
        """
        stays = self._character.run == self._picker.run == run
        self._picker.refresh()
        if stays:
            self._picker.select(run, learned.style)
        then = f"; it is selected: {widgets.UNSEEN}." if stays else ". Choose that run to see it."
        kind, said = ("warning", "") if learned.warnings else ("good", "is learned and ")
        lines = [f"{learned.style} {said}is now a style of {run}{then}"]
        lines += [f"Warning: {line}." for line in learned.warnings]
        lines += [f"Note: {line}." for line in learned.notes]
        self.show_message(kind, "\n".join(lines))
        if learned.warnings:
            self.notify(f"{learned.style} may look poor", "The message under Clips says why.", "yellow")

    def _unseen(self, view: View) -> bool:
        """Returns whether the style was changed while the character stands, so that it still looks as before."""
        present = (self._character.run, self._character.shares)
        if view.speed > STANDING or view.wanted_speed > 0.0:
            self._walked = present
        return present != self._walked

    # Building

    def _drive(self) -> None:
        with self._gui.add_folder("Drive"):
            self._gui.add_html(widgets.pad())
            self._channel = self._gui.add_text(DRIVE, "")
            self._gui.add_button("Reset", color=rgb(BUTTON)).on_click(self._queued(self._reset))

    def _gait(self) -> None:
        with self._gui.add_folder("Speed and sidestep", expand_by_default=False):
            self._own = self._gui.add_checkbox("Natural speed", True, hint="Walk at the style's natural speed.")
            self._speed = self._gui.add_slider("Speed", *SPEEDS, step=0.05, initial_value=1.2, disabled=True)
            self._strafe = self._gui.add_checkbox("Sidestep", False, hint="Keep facing ahead while walking sideways.")

    def _build_readouts(self) -> None:
        """Builds the panel of the readouts."""
        panel = self._gui.add_panel()
        with panel.add_tab("Character"):
            self._readout = self._gui.add_html("")
            self._dial = self._gui.add_html("")
            self._timeline = Timeline(self._gui)
            self._gui.add_html(widgets.legend(FEET, f"last {CONTACT_SECONDS:.0f} s"))
        panel.float(x=15, y=15, width=widgets.READOUT_WIDTH)

    def _files(self) -> None:
        with self._gui.add_folder("Clips"):
            self._record = self._gui.add_button("Record", color=rgb(BUTTON), hint="Record the motion to download it.")
            self._record.on_click(self._queued(self._record_or_stop))
            self._downloads = Downloads(self._client, self._scene, self.show_message)
            self.upload = self._gui.add_upload_button("Upload a clip", mime_type=ACCEPTED)
            hint = "Learn the style of a clip that comes with the package."
            self.samples = self._gui.add_button_group("Try a sample", tuple(sample_clips()), hint=hint)
            self._bar = self._gui.add_progress_bar(0.0, animated=True, visible=False)
            note = "Upload a walk of a few seconds to learn its style, or try a sample."
            self._message = self._gui.add_html(widgets.message("plain", note))

    def _camera(self) -> None:
        with self._gui.add_folder("Camera", expand_by_default=False):
            self._follow = self._gui.add_checkbox("Follow", True)
            self._turn = self._gui.add_checkbox("Turn along", True, hint="If off, W walks where the camera looks.")
            self._gui.add_button("Behind the character", color=rgb(BUTTON)).on_click(self._queued(self._look_again))

    def _commands(self) -> None:
        """Adds keys for pages whose script does not run; they report presses only."""
        for key, label in KEYS.items():
            for shift in (False, True):
                command = self._gui.add_command(
                    f"{label}, running" if shift else label,
                    hotkey=key.upper(),  # type: ignore[arg-type]
                    modifier="shift" if shift else None,
                )
                command.on_trigger(self._queued(lambda key=key, shift=shift: self._character.press(key, shift)))

    # Serving

    def _queued(self, action: Any) -> Any:
        async def put(_: Any) -> None:
            try:
                self.clicks.put_nowait(action)
            except queue.Full:
                pass  # more than anybody can press between two pictures

        return put

    def _read_stick(self, now: float) -> None:
        text = self._channel.value
        if text != self._held:
            self._held, self._heard = text, now
            message = parse_message(text)
            if message is not None:
                self._character.set_stick(*message.stick)
                self.rate = message.rate
        elif now - self._heard > TIMEOUT:
            self._heard = math.inf
            self._character.set_stick(0.0, 0.0)

    def _read_fields(self, now: float) -> None:
        own, speed = self._own.value, float(self._speed.value)
        if self._values.changed("speed", (own, speed)):
            self._speed.disabled = own
            self._character.set_speed(None if own else speed)
        if self._values.changed("strafe", self._strafe.value):
            self._character.set_strafe(self._strafe.value)
        self._scene.follow, self._scene.turn = self._follow.value, self._turn.value
        self._read_camera()
        self._picker.apply_changes(now)

    def _read_camera(self) -> None:
        """Makes a camera that is turned by hand set the heading, unless the camera turns along."""
        if self._follow.value and self._turn.value:
            self._look = None
            return
        camera = self._client.camera
        yaw, before = camera_yaw(camera.position, camera.look_at), self._look
        if yaw is not None and (before is None or abs(math.remainder(yaw - before, 2.0 * math.pi)) > TURNED):
            self._look = yaw
            self._character.set_heading(math.remainder(yaw + self._scene.yaw, 2.0 * math.pi))

    def _reset(self) -> None:
        self._character.reset()
        self._scene.jump_to(self._character.advance(time.monotonic()))

    def _record_or_stop(self) -> None:
        clip = self._character.stop_recording()
        if clip is None:
            self._character.start_recording()
            return
        self._downloads.send("_".join(self._character.shares), clip)

    def _look_again(self) -> None:
        look_from_behind(self._client)
