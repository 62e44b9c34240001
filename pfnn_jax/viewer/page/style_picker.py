"""The controls that choose the run, the style, and a mixture of three styles in a triangle."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from pfnn_jax.errors import InputError
from pfnn_jax.viewer.draw.palette import BUTTON, rgb
from pfnn_jax.viewer.page import widgets
from pfnn_jax.viewer.page.character import Character
from pfnn_jax.viewer.page.run_library import RunLibrary
from pfnn_jax.viewer.page.widgets import FieldChanges

if TYPE_CHECKING:
    import viser

SHARES = "Shares"
"""Label of the text field with the shares of the mixture in percent; page.js finds the field by it."""

MIXTURE = "mixture: three"
"""Entry of the list of styles while the triangle decides. No style can have this name (see `check_style_name`): two
equal options would break the whole page."""

REDRAW_DELAY = 0.3
"""Seconds after the last change until the triangle is redrawn, so that it is not redrawn while its point is dragged."""


class StylePicker:
    """Lists of runs and styles, and the triangle.

    Args:
        gui: of the tab; the controls are added to its present folder.
        library: the runs.
        character: the tab's character.
    """

    def __init__(self, gui: viser.GuiApi, library: RunLibrary, character: Character) -> None:
        self._library, self._character = library, character
        self._version = library.version
        self._mixing, self._shares = False, (1 / 3, 1 / 3, 1 / 3)
        self._redraw_at = math.inf
        self._values = FieldChanges()
        loaded = library.get(character.run)  # one moment of it: styles are renamed and deleted meanwhile
        runs, names, first = library.runs, loaded.styles, loaded.present_style(next(iter(character.shares)))
        self._run = gui.add_dropdown("Run", runs, initial_value=character.run, visible=len(runs) > 1)
        self._style = gui.add_dropdown("Style", (*names, MIXTURE), initial_value=first)
        with gui.add_folder("Mix three", expand_by_default=len(names) > 2):
            self._triangle = gui.add_html("")
            with gui.add_folder("Corners and shares", expand_by_default=False):
                self._corners = [
                    gui.add_dropdown(label, names, initial_value=name)
                    for label, name in zip(("Top", "Left", "Right"), spread(("",) * 3, names), strict=True)
                ]
                self._share_field = gui.add_text(SHARES, " ".join(map(str, widgets.percents(self._shares))))
        self._manage = gui.add_folder("Rename or delete", expand_by_default=False)
        with self._manage:
            self._new_name = gui.add_text("New name", "")
            self._rename = gui.add_button("Rename", color=rgb(BUTTON))
            self._delete = gui.add_button("Delete", color=rgb(BUTTON))
        self._refusal = gui.add_html("", visible=False)
        self._restore = gui.add_button("Undo", color=rgb(BUTTON), visible=False)
        self._set_seen(self._run.value, self._style.value)
        self._values.set(shares=self._share_field.value)
        self._draw()
        self._show_manage()

    def on_manage(self, queued: Callable[[Callable[[], None]], Any]) -> None:
        """Lets the buttons that rename, delete and restore act.

        Args:
            queued: returns a callback of a button for an action of the tab's thread.
        """
        for button, action in (
            (self._rename, self._rename_style),
            (self._delete, self._delete_style),
            (self._restore, self._restore_style),
        ):
            button.on_click(queued(partial(self._managed, action)))

    @property
    def run(self) -> str:
        """The run chosen in the list, whether `apply_changes` has applied it or not.

        The character's where there is none of that name: viser takes any text for a choice.
        """
        chosen = self._run.value
        return chosen if chosen in self._library.runs else self._character.run

    def refresh(self) -> None:
        """Follows the styles that any tab has learned, renamed or deleted.

        Choices made meanwhile are left to `apply_changes`.
        """
        if self._library.version != self._version:
            self._version = self._library.version
            before = self._corner_names()
            self._offer(self._character.run)
            if self._corner_names() != before and not self._mixing:  # changed by the server, not by the person
                self._values.set(corners=self._corner_names())
            self._show_manage()

    def apply_changes(self, now: float) -> None:
        """Applies what has been chosen since the last call to the character; `now` in seconds of its clock.

        Raises:
            InputError: for a choice that is not in the lists.
        """
        if self._values.changed("run", self._run.value):
            self.select(self._run.value, self._names(self._run.value)[0])
        corners = self._corner_names()
        chosen = self._values.changed("style", self._style.value)
        if chosen and self._style.value != MIXTURE:
            self.select(self.run, self._style.value)
        moved = self._values.changed("corners", corners) | self._values.changed("shares", self._share_field.value)
        if moved or (chosen and self._style.value == MIXTURE):
            self._mix(corners, now)
        if self._values.changed("managed", (self._run.value, self._style.value)):
            self._refuse("")
            self._show_manage()
        if now >= self._redraw_at:
            self._draw()

    def select(self, run: str, style: str) -> None:
        """Changes the character and the lists to a style.

        Raises:
            InputError: for an unknown run or style.
        """
        self._character.choose(run, style)
        self._mixing = False
        self._offer(run)
        self._run.value, self._style.value = run, style
        self._set_seen(run, style)
        self._draw()

    def _managed(self, action: Callable[[], None]) -> None:
        """Renames, deletes or restores; a refusal is shown below the buttons until the next attempt or choice."""
        self._refuse("")
        try:
            action()
        except InputError as error:
            self._refuse(str(error))

    def _refuse(self, text: str) -> None:
        self._refusal.content, self._refusal.visible = widgets.message("bad", text), bool(text)

    def _rename_style(self) -> None:
        run, old, new = self._character.run, self._style.value, str(self._new_name.value).strip()
        if not new:
            raise InputError("page", "new name", "empty", "enter the style's new name first")
        self._library.rename_style(run, old, new)
        self._new_name.value = ""
        self.refresh()
        if old in self._character.shares:
            self.select(run, new)

    def _delete_style(self) -> None:
        run, name = self._character.run, self._style.value
        self._library.delete_style(run, name)
        self.refresh()
        if name in self._character.shares:
            self.select(run, self._library.get(run).present_style(name))

    def _restore_style(self) -> None:
        run = self._character.run
        name = self._library.restore_style(run)
        self.refresh()
        self.select(run, name)

    def _show_manage(self) -> None:
        """Offers renaming and deleting for learned styles only, and the style that can be restored."""
        run, style = self.run, self._style.value
        learned = style != MIXTURE and self._library.get(run).is_learned(style)
        self._manage.visible = learned
        deleted = self._library.deleted_style(run)
        self._restore.visible = deleted is not None
        self._restore.label = f"Undo: restore {deleted}" if deleted else "Undo"

    def _mix(self, corners: tuple[str, ...], now: float) -> None:
        shares = widgets.shares_of(self._share_field.value)
        if shares is None:
            return  # incomplete input
        self._shares, self._mixing = shares, True
        self._character.mix(corners, shares)
        self._style.value = MIXTURE
        self._values.set(style=MIXTURE)
        self._redraw_at = now + REDRAW_DELAY

    def _offer(self, run: str) -> None:
        """Offers the options of a run; fields keep their values if the run has them."""
        loaded = self._library.get(run)
        names, corners = loaded.styles, tuple(loaded.present_style(corner) for corner in self._corner_names())
        if not set(self._corner_names()) <= set(names):  # of another run, or of a style that was renamed or deleted
            corners = spread(corners, names)
        style = self._style.value
        values = (*corners, style if style == MIXTURE else loaded.present_style(style))
        for field, value in zip((*self._corners, self._style), values, strict=True):
            options = names if field is not self._style else (*names, MIXTURE)
            if tuple(field.options) != options:
                field.options = options
            if field.value != value:
                field.value = value

    def _set_seen(self, run: str, style: str) -> None:
        self._values.set(run=run, style=style, corners=self._corner_names())

    def _corner_names(self) -> tuple[str, ...]:
        return tuple(corner.value for corner in self._corners)

    def _names(self, run: str) -> tuple[str, ...]:
        return tuple(self._library.get(run).styles)

    def _draw(self) -> None:
        self._redraw_at = math.inf
        self._triangle.content = widgets.triangle(self._corner_names(), self._shares, self._mixing)


def spread(kept: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """Returns corners for a run's styles.

    Args:
        kept: present corners; those among `names` are kept, once each, and the others get unused styles.
        names: the styles. If there are fewer than corners, some styles have several.
    """
    corners = [name if name in names and name not in kept[:place] else None for place, name in enumerate(kept)]
    free = [name for name in names if name not in corners]
    found: list[str] = []
    for place, name in enumerate(corners):
        found.append(name or (free.pop(0) if free else names[place % len(names)]))
    return tuple(found)
