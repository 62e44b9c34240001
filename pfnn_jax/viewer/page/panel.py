"""The panels of a tab: controls, readouts, uploads and downloads."""

from __future__ import annotations

import contextlib
import math
import queue
import threading
import time
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from pfnn_jax.errors import InputError
from pfnn_jax.viewer.draw.palette import BUTTON, HEEL, LEFT, RIGHT, TOE, rgb
from pfnn_jax.viewer.page import background, widgets
from pfnn_jax.viewer.page.character import Character
from pfnn_jax.viewer.page.downloads import Downloads
from pfnn_jax.viewer.page.drive_input import parse_message
from pfnn_jax.viewer.page.frame_scheduler import SILENCE
from pfnn_jax.viewer.page.framing import Framing
from pfnn_jax.viewer.page.restyle_panel import RestylePanel
from pfnn_jax.viewer.page.run_library import RunLibrary
from pfnn_jax.viewer.page.scene import PageScene, camera_yaw
from pfnn_jax.viewer.page.style_picker import StylePicker
from pfnn_jax.viewer.page.uploads import ACCEPTED, NICENESS, LearnedUpload
from pfnn_jax.viewer.page.view import View
from pfnn_jax.viewer.page.wear_panel import WearPanel
from pfnn_jax.viewer.page.widgets import CONTACT_SECONDS, FieldChanges, Timeline
from pfnn_jax.workflows.samples import sample_clips

if TYPE_CHECKING:
    import viser

DRIVE = "Stick and keys"
"""Label of the text field through which the page's script sends its messages; the script finds it by the label."""

TIMEOUT = 1.0
"""Seconds without a message after which everything counts as released: the script sends five messages a second while
something is held."""

CANNOT_STRAFE = "cannot sidestep. It was not trained on side steps: commanded to, it turns and walks ahead."

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
        wake: set whenever a person does something, to end a pause of the tab.
    """

    def __init__(self, client: viser.ClientHandle, library: RunLibrary, character: Character, scene: PageScene) -> None:
        self._client, self._gui = client, client.gui
        self._library, self._character, self._scene = library, character, scene
        self.clicks: queue.Queue[Any] = queue.Queue(QUEUED)
        self.rate = 0.0
        self.wake = threading.Event()
        self._held, self._heard, self._said = "", -math.inf, -math.inf
        self._visible, self._touched = True, True
        self._look: float | None = None
        self._outcome, self._mine = 0, ""
        self._trying: threading.Thread | None = None
        self._values = FieldChanges()
        self._framing = Framing(client)
        self._build_readouts()
        self._drive()
        with self._gui.add_folder("Style"):
            self._picker = StylePicker(self._gui, library, character)
            self._picker.on_manage(self._queued)
        self._files()
        self.wear = WearPanel(client, scene, self.clicks, self.wake)
        self.restyle = RestylePanel(client)
        self._gait()
        self._camera()
        self._commands()

    def serve(self, now: float) -> None:
        """Applies everything pressed and chosen since the last call; `now` in seconds of the character's clock."""
        self._picker.refresh()
        self._show_learning()
        for _ in range(QUEUED):
            try:
                self.clicks.get_nowait()()
                self._touched = True
            except queue.Empty:
                break
            except InputError as error:
                self.show_message("bad", str(error))
        self._read_stick(now)
        try:
            self._read_fields(now)
            self._framing.update()
        except (InputError, ValueError) as error:  # a browser can send values that its page does not offer
            self.show_message("bad", str(error))

    def visible(self, now: float) -> bool:
        """Returns whether the browser shows the tab; it counts as shown until the page's script has spoken once."""
        return self._said == -math.inf or (self._visible and now - self._said < SILENCE)

    def take_touched(self) -> bool:
        """Returns whether the person has done anything since the last call: pressed, chosen, or turned the camera."""
        moved = self._values.changed("inputs", (self._character.run, self._character.shares, self._camera_moment()))
        touched, self._touched = self._touched or moved, False
        return touched

    def show(self, view: View, now: float, drawn: float) -> None:
        """Updates the readouts.

        Args:
            view: the moment.
            now: seconds of the character's clock.
            drawn: pictures per second.
        """
        self._readout.content = widgets.readout(view)
        self._details.content = widgets.details(view, drawn, self.rate)
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

    def learning(self, active: bool) -> None:
        """Notes whether this tab learns a style; meanwhile it takes no other clip."""
        self.upload.disabled = active
        self.samples.visible = not active  # viser cannot disable these buttons

    def take_name(self) -> str:
        """Returns the name that was entered for the next style, and empties its field; "" for that of the file."""
        name, self._name.value = str(self._name.value).strip(), ""
        return name

    def return_name(self, name: str) -> None:
        """Puts the name of a style that could not be learned back, unless another has been entered meanwhile."""
        self._name.value = self._name.value or name

    def learned(self, run: str, learned: LearnedUpload) -> None:
        """Changes the character to a style that was learned for it, unless another run has been chosen meanwhile.

        Args:
            run: the run that has learned it.
            learned: the style.
        """
        self._picker.refresh()
        if self._character.run == self._picker.run == run:
            self._picker.select(run, learned.style)
            self._mine = learned.style
        if learned.warnings:
            self.notify(f"{learned.style} may look poor", "The message under Clips says why.", "yellow")

    def _show_learning(self) -> None:
        """Shows what any tab learns, and the last outcome, also in a tab that was opened or loaded again since."""
        jobs = [(job.name, job.run, job.share, job.waiting, left) for job, left in self._library.learning.jobs()]
        self._jobs.content = "".join(widgets.learning_note(*job) for job in jobs)
        outcome = self._library.learning.outcome()
        if outcome is None or outcome.number == self._outcome:
            return
        self._outcome, learned = outcome.number, outcome.learned
        if learned is None:
            self.show_message("bad", outcome.error)
            return
        if self._character.run != outcome.run:
            then = ". Choose that run to see it."
        elif learned.style in (self._mine, *self._character.shares):
            then = "; it is selected."
        else:
            then = "; choose it in the list of styles."
        kind, said = ("warning", "") if learned.warnings else ("good", "is learned and ")
        lines = [f"{learned.style} {said}is now a style of {outcome.run}{then}"]
        lines += [f"Warning: {line}." for line in learned.warnings]
        lines += [f"Note: {line}." for line in learned.notes]
        self.show_message(kind, "\n".join(lines))

    # Building

    def _drive(self) -> None:
        with self._gui.add_folder("Drive"):
            self._gui.add_html(widgets.pad())
            self._channel = self._gui.add_text(DRIVE, "")
            self._channel.on_update(self._woken())
            self._gui.add_button("Reset", color=rgb(BUTTON)).on_click(self._queued(self._reset))

    def _gait(self) -> None:
        with self._gui.add_folder("Speed and sidestep", expand_by_default=False):
            self._own = self._gui.add_checkbox("Natural speed", True, hint="Walk at the style's natural speed.")
            self._speed = self._gui.add_slider("Speed", *SPEEDS, step=0.05, initial_value=1.2, disabled=True)
            self._strafe = self._gui.add_checkbox("Sidestep", False, hint="Keep facing ahead while walking sideways.")
            self._cannot = self._gui.add_html("")

    def _build_readouts(self) -> None:
        """Builds the panel of the readouts."""
        panel = self._gui.add_panel()
        with panel.add_tab("Character"):
            self._readout = self._gui.add_html("")
            self._dial = self._gui.add_html("")
            self._timeline = Timeline(self._gui)
            self._gui.add_html(widgets.legend(FEET, f"last {CONTACT_SECONDS:.0f} s"))
            with self._gui.add_folder("Details", expand_by_default=False):
                self._details = self._gui.add_html("")
        panel.float(x=15, y=15, width=widgets.READOUT_WIDTH)

    def _files(self) -> None:
        with self._gui.add_folder("Clips"):
            self._record = self._gui.add_button("Record", color=rgb(BUTTON), hint="Record the motion to download it.")
            self._record.on_click(self._queued(self._record_or_stop))
            self.upload = self._gui.add_upload_button("Upload a clip", mime_type=ACCEPTED)
            hint = "Learn the style of a clip that comes with the package."
            self.samples = self._gui.add_button_group("Try a sample", tuple(sample_clips()), hint=hint)
            named = "Of the style that is learned next; empty: as the file is called."
            self._name = self._gui.add_text("Name", "", hint=named)
            self._downloads = Downloads(self._client, self._scene, self.show_message)
            self._jobs = self._gui.add_html("")
            note = "Upload a walk of a few seconds to learn its style, or try a sample. Name it first if you like."
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
            self.wake.set()
            try:
                self.clicks.put_nowait(action)
            except queue.Full:
                pass  # more than anybody can press between two pictures

        return put

    def _woken(self) -> Any:
        async def wake(_: Any) -> None:
            self.wake.set()

        return wake

    def _read_stick(self, now: float) -> None:
        text = self._channel.value
        if text != self._held:
            self._held, self._heard = text, now
            message = parse_message(text)
            if message is not None:
                self._character.set_stick(*message.stick)
                self.rate, self._visible, self._said = message.rate, message.visible, now
                self._touched |= any(message.stick) or self._values.changed("visible", message.visible)
        elif now - self._heard > TIMEOUT:
            self._heard = math.inf
            self._character.set_stick(0.0, 0.0)

    def _read_fields(self, now: float) -> None:
        own, speed = self._own.value, float(self._speed.value)
        camera = (self._follow.value, self._turn.value)
        self._touched |= self._values.changed("fields", (own, speed, self._strafe.value, camera))
        if self._values.changed("speed", (own, speed)):
            self._speed.disabled = own
            self._character.set_speed(None if own else speed)
        self._show_abilities()
        strafe = self._strafe.value and not self._strafe.disabled
        if self._values.changed("strafe", strafe):
            self._character.set_strafe(strafe)
        self._scene.follow, self._scene.turn = camera
        self._read_camera()
        self._picker.apply_changes(now)

    def _show_abilities(self) -> None:
        """Greys out sidestepping, with the reason, where one of the character's styles cannot."""
        run, library = self._character.run, self._library
        known = {style: library.strafes(run, style) for style in self._character.shares}
        unknown = next((style for style, strafes in known.items() if strafes is None), None)
        if unknown is not None:
            self._try_strafe(run, unknown)
            return
        cannot = [style for style, strafes in known.items() if not strafes]
        self._strafe.disabled = bool(cannot)
        self._cannot.content = widgets.note(f"{cannot[0]} of {run}: {CANNOT_STRAFE}") if cannot else ""

    def _try_strafe(self, run: str, style: str) -> None:
        """Finds out in the background whether a style can sidestep."""
        if self._trying is not None and self._trying.is_alive():
            return

        def find() -> None:
            with contextlib.suppress(InputError):  # deleted meanwhile
                background.do(partial(self._library.try_strafe, run, style), niceness=NICENESS)

        self._trying = threading.Thread(target=find, name="abilities", daemon=True)
        self._trying.start()

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

    def _camera_moment(self) -> float:
        """Returns when the camera was moved last."""
        try:
            return float(self._client.camera.update_timestamp)
        except AssertionError:  # the browser has not said where it is
            return 0.0

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
        self._framing.apply()
