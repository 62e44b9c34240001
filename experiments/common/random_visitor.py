"""What people and broken programs do on the page at random: drive, choose, press, type, upload, rename, mislead."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from random import Random
from typing import Any

import msgspec

from experiments.common.page_tab import CAMERA, Control, PageTab

NEW_NAME, STYLE = "New name", "Style"
"""Labels of controls that this file uses by name."""

TEXTS = (
    "",
    "a",
    "50 30 20",
    "0 0 0",
    "nan nan nan",
    "style",
    "../../etc/passwd",
    "x" * 5000,
    "ä ß 中",
    "\n\0",
    "CON",
    ".",
)
"""What is typed into fields."""

WRONG: tuple[Any, ...] = (
    None,
    True,
    -1,
    2**63,
    1e308,
    float("nan"),
    "",
    "no such option",
    [],
    [1, 2],
    {"a": 1},
    b"\0",
)
"""Values that no control offers."""

LEARNED = "depressed", "neutral", "proud"
"""Styles that the run has from the beginning; they are not renamed or deleted."""

Act = Callable[[PageTab, Random], Awaitable[None]]


async def drive(tab: PageTab, random: Random) -> None:
    """Moves the stick, or releases it; sometimes the tab is hidden."""
    ahead, left, turn = (random.uniform(-0.7, 0.7) * random.choice((0, 1)) for _ in range(3))
    rate, visible = random.choice((0, 10, 30, 60)), random.random() < 0.7
    number, faster = random.randrange(10**9), bool(random.randrange(2))
    await tab.drive(number, (ahead, left, turn), faster=faster, rate=rate, visible=visible)


async def choose(tab: PageTab, random: Random) -> None:
    """Changes a list, a slider or a box to a value that it offers."""
    controls = [control for control in tab.controls.values() if control.kind in ("Dropdown", "Slider", "Checkbox")]
    control = random.choice([control for control in controls if control.usable])
    await tab.set(control, offered(control, random))


def offered(control: Control, random: Random) -> Any:
    """Returns one of the values that a control offers."""
    if control.kind == "Dropdown":
        return random.choice(list(control.props["options"]))
    if control.kind == "Checkbox":
        return random.random() < 0.5
    return random.uniform(control.props["min"], control.props["max"])


async def press(tab: PageTab, random: Random) -> None:
    """Presses a button, of whatever panel."""
    buttons = [control for control in tab.controls.values() if control.kind == "Button" and control.usable]
    await tab.set(random.choice(buttons), True)


async def enter(tab: PageTab, random: Random) -> None:
    """Types into a field."""
    fields = [control for control in tab.controls.values() if control.kind == "Text"]
    await tab.set(random.choice(fields), random.choice(TEXTS))


async def manage(tab: PageTab, random: Random) -> None:
    """Chooses a style that was learned, and renames it, deletes it or restores the last one deleted."""
    styles = tab.find(STYLE, "Dropdown")
    learned = [style for style in styles.props["options"] if style not in LEARNED and ":" not in style]
    if learned:
        await tab.set(styles, random.choice(learned))
    if random.random() < 0.3:
        await tab.set(tab.find(NEW_NAME), f"name {random.randrange(1000)}")
        await tab.press("Rename")
    elif len(learned) > 3 or random.random() < 0.5:
        await tab.press("Delete")
    else:
        undo = [control for control in tab.controls.values() if control.label.startswith("Undo")]
        await tab.set(undo[0], True)


async def try_sample(tab: PageTab, random: Random) -> None:
    """Learns a style from a clip of the package."""
    samples = tab.find("Try a sample")
    await tab.set(samples, random.choice(list(samples.props["options"])))


async def command(tab: PageTab, random: Random) -> None:
    """Presses a key of a page whose script does not run."""
    await tab.trigger(random.choice(tab.commands))


async def turn_camera(tab: PageTab, random: Random) -> None:
    """Looks from elsewhere, in a window of another size."""
    position = tuple(random.uniform(-5, 5) for _ in range(3))
    size = {"image_width": random.choice((0, 320, 1280)), "image_height": random.choice((0, 400, 720))}
    await tab.send({**CAMERA, "position": position, **size})


async def mislead(tab: PageTab, random: Random) -> None:
    """Sends a message that is one of viser's, with values that no page sends."""
    control = random.choice(list(tab.controls.values()))
    choice = random.randrange(6)
    if choice == 0:
        await tab.set(control, random.choice(WRONG))
    elif choice == 1:
        updates = {random.choice(("value", "visible", "update_cb", "nothing")): random.choice(WRONG)}
        await tab.send({"type": "GuiUpdateMessage", "uuid": control.uuid, "updates": updates})
    elif choice == 2:
        await tab.send({"type": "GuiUpdateMessage", "uuid": "unknown", "updates": {"value": 1}})
    elif choice == 3:
        part = {"transfer_uuid": "unknown", "part_index": 0, "content": b"0" * 1000}
        await tab.send({"type": "FileTransferPart", "source_component_uuid": control.uuid, **part})
    elif choice == 4:
        await tab.send({**CAMERA, "position": (float("nan"),) * 3, "image_width": 10**9})
    else:
        await tab.send({"type": random.choice(("ShareUrlRequest", "GuiFormDirtyMessage")), "uuid": "a" * 1000})


async def send_garbage(tab: PageTab, random: Random) -> None:
    """Sends frames that are not messages: the server must close the connection."""
    frame: bytes | str = random.choice(
        (b"", "text", random.randbytes(200), b"\x91" * 50_000, msgspec.msgpack.encode({"type": "Nothing"}))
    )
    await tab.connection.send(frame)


def uploader(files: tuple[Path, ...]) -> Act:
    """Returns an act that uploads a file with any of the upload buttons, sometimes cut or under another name."""

    async def upload(tab: PageTab, random: Random) -> None:
        file = random.choice(files)
        data = file.read_bytes()
        if random.random() < 0.2:
            data = data[: random.randrange(len(data) + 1)]
        suffix = random.choice((".bvh", ".glb", ".exe")) if random.random() < 0.1 else file.suffix
        buttons = [control.label for control in tab.controls.values() if control.kind == "UploadButton"]
        await tab.upload(random.choice(buttons), file.stem + suffix, data)

    return upload


def acts(files: tuple[Path, ...]) -> dict[str, tuple[Act, float]]:
    """Returns what is done, each with its share.

    Args:
        files: that are uploaded; none if empty.
    """
    found: dict[str, tuple[Act, float]] = {
        "drive": (drive, 40.0),
        "choose": (choose, 15.0),
        "press": (press, 15.0),
        "enter": (enter, 6.0),
        "manage": (manage, 6.0),
        "sample": (try_sample, 0.7),
        "command": (command, 5.0),
        "camera": (turn_camera, 5.0),
        "mislead": (mislead, 3.0),
        "garbage": (send_garbage, 1.0),
    }
    return {**found, "upload": (uploader(files), 3.0)} if files else found
