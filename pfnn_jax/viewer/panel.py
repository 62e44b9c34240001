"""The panel of a tab: everything that can be pressed, chosen, dragged, read or downloaded."""

from __future__ import annotations

import math
import queue
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pfnn_jax.errors import InputError
from pfnn_jax.viewer import dials
from pfnn_jax.viewer.actor import Actor
from pfnn_jax.viewer.page_scene import PageScene, camera_yaw, look
from pfnn_jax.viewer.recording import bvh_bytes
from pfnn_jax.viewer.stage import Stage
from pfnn_jax.viewer.timeline import SECONDS, Timeline
from pfnn_jax.viewer.view import View

if TYPE_CHECKING:
    import viser

DRIVE = "Stick and keys"
"""Label of the text field through which the page's script tells what is held; the script hides it."""

SHARES = "Shares"
"""Label of the text field with the mixture's shares, in percent."""

MIXTURE = "mixture of three"
"""What the list of styles shows while the point in the triangle decides."""

SILENCE = 1.0
"""Seconds after which a stick or key held counts as let go: the script repeats itself five times a second."""

SPEEDS = (0.3, 3.0)  # metres per second
KEYS = {
    "w": "Ahead",
    "a": "Left",
    "s": "Back",
    "d": "Right",
    "q": "Turn left",
    "e": "Turn right",
}
FEET = {"left": "#3b7ae6", "right": "#e8743b", "heel": "#667082", "toe": "#b4bcc8"}
READOUT_WIDTH = 282.0  # CSS pixels
PLAIN = (84, 97, 117)  # of buttons
TURNED = math.radians(0.5)  # of a camera: less is no one's wish
QUEUED = 64  # presses and clicks that may wait


class Panel:
    """Controls and readouts.

    Clicks and keys wait in a bounded queue and values in their fields until `serve` is called, so that a tab's
    thread alone moves its character.

    Args:
        client: the tab.
        stage: the runs.
        actor: the tab's character.
        scene: its picture.

    Attributes:
        clicks: what waits to be done, functions without arguments.
        upload: the button that takes a file.
        rate: pictures per second that the browser manages, 0 while that is not known.
    """

    def __init__(self, client: viser.ClientHandle, stage: Stage, actor: Actor, scene: PageScene) -> None:
        self._client, self._gui, self._stage, self._actor, self._scene = client, client.gui, stage, actor, scene
        self.clicks: queue.Queue[Any] = queue.Queue(QUEUED)
        self.rate = 0.0
        self._held, self._heard = "", -math.inf
        self._seen_version = stage.version
        self._recording = False
        self._mixing, self._shares, self._shares_text = False, (1 / 3, 1 / 3, 1 / 3), "34 33 33"
        self._redraw_at = math.inf
        self._values: dict[str, Any] = {}
        self._character()
        self._drive()
        self._styles()
        self._files()
        self._camera()
        self._commands()
        self._gui.add_html(dials.script())

    def serve(self, now: float) -> None:
        """Carries out what has been pressed and chosen since the last call; `now` in seconds of the actor's clock."""
        self._refresh_styles()
        for _ in range(QUEUED):
            try:
                self.clicks.get_nowait()()
            except queue.Empty:
                break
            except InputError as error:
                self.tell("bad", str(error))
        self._hear_stick(now)
        try:
            self._hear_values(now)
        except (InputError, ValueError) as error:  # a browser can send what its page does not offer
            self.tell("bad", str(error))

    def show(self, view: View, now: float, drawn: float) -> None:
        """Brings the readouts up to date.

        Args:
            view: the moment.
            now: seconds of the actor's clock.
            drawn: pictures per second.
        """
        self._readout.content = dials.readout(view, drawn, self.rate)
        self._dial.content = dials.phase_dial(view.dials)
        self._timeline.show(now)
        seconds = view.recorded_seconds
        self._record.label = "Record" if seconds is None else f"Stop and download ({seconds:.1f} s)"

    def add_contacts(self, view: View, now: float) -> None:
        """One more moment for the timeline."""
        self._timeline.add(now, view.contacts)

    def tell(self, kind: str, text: str) -> None:
        """A message under the upload button: `good`, `bad` or `plain`."""
        self._message.content = dials.message(kind, text)

    def progress(self, share: float, text: str) -> None:
        """How far learning has come, 0 to 1; from any thread."""
        self._bar.value = 100.0 * min(max(share, 0.0), 1.0)
        self.tell("plain", text)

    def learning(self, active: bool) -> None:
        """Shows or hides the progress bar; no second file is taken meanwhile."""
        self._bar.visible = active
        self.upload.disabled = active

    def chosen(self, run: str, style: str) -> None:
        """Puts the character, and the list, into a style."""
        self._refresh_styles(force=True)
        self._select(run, style)

    # Building

    def _drive(self) -> None:
        with self._gui.add_folder("Drive"):
            self._gui.add_html(dials.pad())
            self._channel = self._gui.add_text(DRIVE, "")
            self._own = self._gui.add_checkbox("Own speed", True, hint="Walk as fast as the style does.")
            self._speed = self._gui.add_slider("Speed", *SPEEDS, step=0.05, initial_value=1.2, disabled=True)
            self._strafe = self._gui.add_checkbox("Sidestep", False, hint="Face ahead while stepping aside or back.")
            self._gui.add_button("Reset", color=PLAIN).on_click(self._later(self._reset))

    def _styles(self) -> None:
        runs, actor = self._stage.runs, self._actor
        names = self._names(actor.run)
        with self._gui.add_folder("Style"):
            self._run = self._gui.add_dropdown("Run", runs, initial_value=actor.run, visible=len(runs) > 1)
            self._style = self._gui.add_dropdown("Style", (*names, MIXTURE), initial_value=next(iter(actor.shares)))
            with self._gui.add_folder("Mix three", expand_by_default=len(names) > 2):
                self._triangle = self._gui.add_html("")
                first = [names[i % len(names)] for i in range(3)]
                self._corners = [
                    self._gui.add_dropdown(label, names, initial_value=name)
                    for label, name in zip(("Top", "Left", "Right"), first, strict=True)
                ]
                self._share_field = self._gui.add_text(SHARES, self._shares_text)
        self._draw_triangle()

    def _character(self) -> None:
        """A panel of its own for everything that is only read."""
        panel = self._gui.add_panel()
        with panel.add_tab("Character"):
            self._readout = self._gui.add_html("")
            self._dial = self._gui.add_html("")
            self._timeline = Timeline(self._gui)
            self._gui.add_html(dials.legend(FEET, f"last {SECONDS:.0f} s"))
        panel.float(x=15, y=15, width=READOUT_WIDTH)

    def _files(self) -> None:
        with self._gui.add_folder("Record"):
            self._record = self._gui.add_button("Record", color=PLAIN)
            self._record.on_click(self._later(self._record_or_stop))
        with self._gui.add_folder("New style from a clip"):
            self.upload = self._gui.add_upload_button("Upload a BVH file", mime_type=".bvh")
            self._bar = self._gui.add_progress_bar(0.0, animated=True, visible=False)
            note = "A walk of a few seconds; its style is learned here."
            self._message = self._gui.add_html(dials.message("plain", note))

    def _camera(self) -> None:
        with self._gui.add_folder("Camera", expand_by_default=False):
            self._follow = self._gui.add_checkbox("Follow", True)
            self._turn = self._gui.add_checkbox("Turn along", True, hint="Else W leads where you look.")
            self._gui.add_button("Behind the character", color=PLAIN).on_click(self._later(self._look_again))

    def _commands(self) -> None:
        """Keys for pages whose script is not at work; they know of presses only."""
        for key, label in KEYS.items():
            for shift in (False, True):
                command = self._gui.add_command(
                    f"{label}, running" if shift else label,
                    hotkey=key.upper(),  # type: ignore[arg-type]
                    modifier="shift" if shift else None,
                )
                command.on_trigger(self._later(lambda key=key, shift=shift: self._actor.press(key, shift)))

    # Serving

    def _later(self, action: Any) -> Any:
        async def put(_: Any) -> None:
            try:
                self.clicks.put_nowait(action)
            except queue.Full:
                pass  # more than a person can press between two pictures

        return put

    def _hear_stick(self, now: float) -> None:
        text = self._channel.value
        if text != self._held:
            self._held, self._heard = text, now
            word = word_of(text)
            if word is not None:
                self._actor.set_stick(*word.stick)
                self.rate = word.rate
        elif now - self._heard > SILENCE:
            self._heard = math.inf
            self._actor.set_stick(0.0, 0.0)

    def _hear_values(self, now: float) -> None:
        if self._changed("own", self._own.value) or self._changed("speed", self._speed.value):
            self._speed.disabled = self._own.value
            self._actor.set_speed(None if self._own.value else float(self._speed.value))
        if self._changed("strafe", self._strafe.value):
            self._actor.set_strafe(self._strafe.value)
        self._scene.follow, self._scene.turn = self._follow.value, self._turn.value
        self._hear_camera()
        if self._changed("run", self._run.value):
            self._select(self._run.value, self._names(self._run.value)[0])
        corners = tuple(corner.value for corner in self._corners)
        chosen = self._changed("style", self._style.value)
        if chosen and self._style.value != MIXTURE:
            self._select(self._run.value, self._style.value)
        moved = self._changed("corners", corners) | self._changed("shares", self._share_field.value)
        if moved or (chosen and self._style.value == MIXTURE):
            self._mix(corners, now)
        if now >= self._redraw_at:
            self._draw_triangle()

    def _hear_camera(self) -> None:
        """A camera that does not turn with the heading leads instead, whenever it is turned by hand."""
        if self._follow.value and self._turn.value:
            self._values.pop("look", None)
            return
        camera = self._client.camera
        yaw = camera_yaw(camera.position, camera.look_at)
        before = self._values.get("look")
        if yaw is not None and (before is None or abs(math.remainder(yaw - before, 2.0 * math.pi)) > TURNED):
            self._values["look"] = yaw
            self._actor.set_heading(math.remainder(yaw + self._scene.yaw, 2.0 * math.pi))

    def _changed(self, name: str, value: Any) -> bool:
        """Whether a value differs from the last time; the first time it does not."""
        before = self._values.setdefault(name, value)
        self._values[name] = value
        return before != value

    def _mix(self, corners: tuple[str, ...], now: float) -> None:
        shares = dials.shares_of(self._share_field.value)
        if shares is None:
            return  # half typed
        self._shares, self._mixing = shares, True
        self._actor.mix(corners, shares)
        self._style.value = self._values["style"] = MIXTURE
        self._redraw_at = now + 0.3  # not while the point is being dragged

    def _select(self, run: str, style: str) -> None:
        self._actor.choose(run, style)
        self._mixing = False
        self._show_options(run, style)
        self._draw_triangle()

    def _show_options(self, run: str, style: str) -> None:
        names = self._names(run)
        for place, field in enumerate((*self._corners, self._style)):
            options = names if field is not self._style else (*names, MIXTURE)
            if tuple(field.options) != options:
                kept = field.value
                field.options = options
                field.value = kept if kept in options else names[place % len(names)]
        self._run.value, self._style.value = run, style
        self._values.update(run=run, style=style, corners=tuple(corner.value for corner in self._corners))

    def _refresh_styles(self, force: bool = False) -> None:
        """Another tab may have learned a style."""
        if force or self._stage.version != self._seen_version:
            self._seen_version = self._stage.version
            self._show_options(self._actor.run, self._style.value)

    def _names(self, run: str) -> tuple[str, ...]:
        return tuple(self._stage.cast(run).styles)

    def _draw_triangle(self) -> None:
        self._redraw_at = math.inf
        names = [corner.value for corner in self._corners]
        self._triangle.content = dials.triangle(names, self._shares, self._mixing)

    def _reset(self) -> None:
        self._actor.reset()
        self._scene.settle(self._actor.advance(time.monotonic()))

    def _record_or_stop(self) -> None:
        if not self._recording:
            self._actor.start_recording()
            self._recording = True
            return
        self._recording = False
        clip = self._actor.stop_recording()
        if clip is not None:
            name = f"{'_'.join(self._actor.shares)[:60]}_{clip.num_frames}.bvh"
            self._client.send_file_download(name, bvh_bytes(clip), save_immediately=True)

    def _look_again(self) -> None:
        look(self._client)


@dataclass(frozen=True)
class Word:
    """What the page's script says.

    Attributes:
        stick: ahead, left and turn in -1..1, and whether to run.
        rate: pictures per second that the browser manages, 0 before it knows.
    """

    stick: tuple[float, float, float, bool]
    rate: float


def word_of(text: str) -> Word | None:
    """Reads a count and five numbers: ahead, left, turn, run, pictures per second; None for anything else."""
    parts = text.split()
    if len(parts) != 6 or len(text) > 100:
        return None
    try:
        ahead, left, turn, run, rate = (float(part) for part in parts[1:])
    except ValueError:
        return None
    if not all(math.isfinite(value) and abs(value) <= 1.0 for value in (ahead, left, turn, run)):
        return None
    if not 0.0 <= rate < 1e4:
        return None
    return Word((ahead, left, turn, run > 0.0), rate)
