"""The messages that a browser may send to the page, each with its fields and their kinds.

Viser makes an object of any of its messages out of what it receives, those of servers included, and sets any attribute
of a control that an update names. The page needs five kinds of messages; only these reach viser, in the form in which
viser's own page sends them.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

from msgspec import DecodeError, Meta, Struct, ValidationError, msgpack

Index = Annotated[int, Meta(ge=0, le=2**31)]

Vector = tuple[float, float, float]


class Value(Struct, forbid_unknown_fields=True):
    """What is entered, chosen or pressed."""

    value: bool | int | float | str


class Update(Struct, tag="GuiUpdateMessage", forbid_unknown_fields=True):
    """A control was used."""

    uuid: str
    updates: Value


class Command(Struct, tag="CommandTriggerMessage", forbid_unknown_fields=True):
    """A key was pressed that the page's script does not handle."""

    uuid: str


class UploadStart(Struct, tag="FileTransferStartUpload", forbid_unknown_fields=True):
    """A file follows."""

    source_component_uuid: str
    transfer_uuid: str
    filename: str
    mime_type: str
    part_count: Index
    size_bytes: Annotated[int, Meta(ge=0)]  # of any size: what is too large is refused by a message, not here


class UploadPart(Struct, tag="FileTransferPart", forbid_unknown_fields=True):
    """A part of a file."""

    source_component_uuid: str | None
    transfer_uuid: str
    part_index: Index
    content: bytes


class Camera(Struct, tag="ViewerCameraMessage", forbid_unknown_fields=True):
    """The camera has moved, or the window has another size."""

    wxyz: tuple[float, float, float, float]
    position: Vector
    fov: float
    near: float
    far: float
    image_height: Index
    image_width: Index
    look_at: Vector
    up_direction: Vector


_decoder = msgpack.Decoder(Update | Command | UploadStart | UploadPart | Camera)


def is_browser_message(frame: bytes) -> bool:
    """Returns whether a frame is one of the messages of this file; numbers of a camera must be finite."""
    try:
        message = _decoder.decode(frame)
    except (DecodeError, ValidationError, RecursionError):
        return False
    return not isinstance(message, Camera) or _is_finite(message)


def _is_finite(camera: Camera) -> bool:
    values: list[Any] = [camera.fov, camera.near, camera.far]
    for vector in (camera.wxyz, camera.position, camera.look_at, camera.up_direction):
        values += vector
    return all(math.isfinite(value) for value in values)
