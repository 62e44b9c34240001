"""A tab of the page without a browser: it speaks viser's protocol as the page's script does, and draws nothing.

It keeps what the page shows (controls with their values, messages, notices, downloads), so that a program can press,
choose, upload and read. Twenty browsers would draw in software on the cores that serve them; twenty of these cost
little.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import uuid
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from html import unescape
from typing import Any

import msgspec
import viser
import zstandard
from websockets.asyncio.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

PART = 512 * 1024
"""Bytes of a part of an upload, as viser's page sends them."""

CONNECTING = 120.0
"""Seconds within which a busy server must answer."""

COMMANDS = 12
"""Keys of a tab that viser triggers; they are the last that a tab adds."""

DRIVE = "Stick and keys"
"""Label of the field in which the page's script says how to drive."""

MESSAGE = re.compile(r'<div data-message="(\w+)"[^>]*>(.*?)</div>', re.DOTALL)
"""A message below the controls: its kind and its text."""

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, 2.0, -4.0),
    "fov": 0.8,
    "near": 0.1,
    "far": 100.0,
    "image_height": 720,
    "image_width": 1280,
    "look_at": (0.0, 1.0, 0.0),
    "up_direction": (0.0, 1.0, 0.0),
}
"""What a browser says of its camera; the server counts a tab as open once it has."""


@dataclass
class Control:
    """A control of the page.

    Attributes:
        uuid: viser's name.
        kind: of its message, such as `Button`.
        value: present value, None for those that have none.
        props: all else: label, options, whether it is visible and so on.
    """

    uuid: str
    kind: str
    value: Any
    props: dict[str, Any]

    @property
    def label(self) -> str:
        """What stands on it or next to it."""
        return str(self.props.get("label") or "")

    @property
    def usable(self) -> bool:
        """Whether a person could use it."""
        return bool(self.props.get("visible", True)) and not self.props.get("disabled")


@dataclass
class PageTab:
    """A tab of the page; see `open_tab`.

    Attributes:
        connection: to the server.
        controls: by viser's names.
        commands: names of those that keys trigger.
        notices: titles and texts.
        downloads: names and bytes of the files received.
        frames: messages of the server.
    """

    connection: ClientConnection
    controls: dict[str, Control] = field(default_factory=dict)
    commands: list[str] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    downloads: dict[str, bytes] = field(default_factory=dict)
    frames: int = 0
    _names: dict[str, str] = field(default_factory=dict)

    async def listen(self) -> None:
        """Takes what the server sends until the connection is closed."""
        decompressor = zstandard.ZstdDecompressor()
        async for frame in self.connection:
            if not isinstance(frame, bytes):
                continue
            length = int.from_bytes(frame[8:16], "little")
            window = msgspec.msgpack.decode(decompressor.decompress(frame[16 : 16 + length]))
            for message in window["messages"]:
                self.frames += 1
                self._take(message)

    def _take(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind == "GuiUpdateMessage":
            self._update(message)
        elif kind == "GuiRemoveMessage":
            self.controls.pop(message["uuid"], None)
        elif kind == "RegisterCommandMessage":
            self.commands.append(message["uuid"])
        elif kind == "NotificationShowMessage":
            self.notices.append(f"{message['props']['title']}: {message['props']['body']}")
        elif kind == "FileTransferStartDownload":
            self._names[message["transfer_uuid"]] = message["filename"]
            self.downloads[message["filename"]] = b""
        elif kind == "FileTransferPart":
            self.downloads[self._names[message["transfer_uuid"]]] += message["content"]
        elif kind.startswith("Gui") and "props" in message and "uuid" in message:
            name = kind.removeprefix("Gui").removesuffix("Message")
            self.controls[message["uuid"]] = Control(message["uuid"], name, message.get("value"), message["props"])

    def _update(self, message: dict[str, Any]) -> None:
        control = self.controls.get(message["uuid"])
        if control is not None:
            updates = dict(message["updates"])
            control.value = updates.pop("value", control.value)
            control.props.update(updates)

    def find(self, label: str, kind: str = "") -> Control:
        """Returns the control of a label, and of a kind if several share it.

        Raises:
            KeyError: if there is none.
        """
        for control in self.controls.values():
            if control.label == label and kind in ("", control.kind):
                return control
        raise KeyError(label)

    def messages(self) -> list[tuple[str, str]]:
        """Returns the kinds and texts of the messages that are shown."""
        shown = [control.props.get("content", "") for control in self.controls.values() if control.kind == "Html"]
        return [(kind, unescape(text)) for content in shown for kind, text in MESSAGE.findall(content)]

    async def send(self, message: Any) -> None:
        """Sends a message, of any content."""
        await self.connection.send(msgspec.msgpack.encode(message))

    async def set(self, control: Control, value: Any) -> None:
        """Enters a value, presses a button (True), or chooses an option."""
        control.value = value
        await self.send({"type": "GuiUpdateMessage", "uuid": control.uuid, "updates": {"value": value}})

    async def drive(
        self,
        number: int,
        stick: tuple[float, float, float],
        *,
        faster: bool = False,
        rate: float = 30,
        visible: bool = True,
    ) -> None:
        """Sends what the page's script says of the stick and of the window.

        Args:
            number: another one each time.
            stick: ahead, left and turn, -1 to 1.
            faster: whether Shift is held.
            rate: pictures per second that the browser manages, 0 before it knows.
            visible: whether the tab can be seen.
        """
        ahead, left, turn = stick
        text = f"{number} {ahead:.3f} {left:.3f} {turn:.3f} {int(faster)} {rate} {int(visible)}"
        await self.set(self.find(DRIVE), text)

    async def press(self, label: str) -> None:
        """Presses a button by its label."""
        await self.set(self.find(label, "Button"), True)

    async def trigger(self, command: str) -> None:
        """Does what a key does in a page whose script does not run."""
        await self.send({"type": "CommandTriggerMessage", "uuid": command})

    async def upload(self, label: str, name: str, data: bytes) -> None:
        """Uploads a file with the button of a label."""
        button, transfer = self.find(label, "UploadButton").uuid, str(uuid.uuid4())
        parts = [data[place : place + PART] for place in range(0, len(data), PART)]
        same = {"source_component_uuid": button, "transfer_uuid": transfer}
        start = {"type": "FileTransferStartUpload", **same, "filename": name, "mime_type": "application/octet-stream"}
        await self.send({**start, "part_count": len(parts), "size_bytes": len(data)})
        for index, part in enumerate(parts):
            await self.send({"type": "FileTransferPart", **same, "part_index": index, "content": part})

    async def until(self, what: Any, seconds: float) -> bool:
        """Waits until a condition holds; returns whether it did within some seconds."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                while not what():
                    await asyncio.sleep(0.05)
        return bool(what())


@contextlib.asynccontextmanager
async def open_tab(host: str, port: int, *, origin: str | None = None) -> AsyncIterator[PageTab]:
    """Opens a tab of the page at an address, and closes it after the block.

    Args:
        host, port: address of the page.
        origin: of the site that opens it; by default the page itself.
    """
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    async with connect(
        f"ws://{host}:{port}",
        subprotocols=[protocol],
        origin=Origin(origin or f"http://{host}:{port}"),
        open_timeout=CONNECTING,
        max_size=None,
        ping_interval=None,
    ) as connection:
        tab = PageTab(connection)
        listening = asyncio.create_task(tab.listen())
        try:
            await tab.send(CAMERA)
            yield tab
        finally:
            await connection.close()
            with contextlib.suppress(Exception):
                await listening


async def complete(tab: PageTab) -> None:
    """Waits until a tab has all of its controls; the last is a command."""
    await tab.until(lambda: len(tab.commands) >= COMMANDS, CONNECTING)
