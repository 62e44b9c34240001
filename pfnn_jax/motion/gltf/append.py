"""Appends animations to a glTF file and touches nothing else: all other content keeps its meaning and its bytes.

Credits and licences (`asset.copyright`, `asset.extras`), which several libraries drop, stay in the file, as do chunks
of other types.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.gltf.container import MAX_BYTES, Document, is_index, read_uri, shown
from pfnn_jax.motion.kinematics import quat_align

Property = Literal["rotation", "translation"]
"""What is animated of a node."""

FLOAT = 5126
"""Component type of accessors of float32."""

_MAGIC, _JSON_CHUNK, _BIN_CHUNK = b"glTF", b"JSON", b"BIN\0"
_SIGNATURES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp", b"\xabKTX": "image/ktx2"}


@dataclass(frozen=True, eq=False)
class Channel:
    """The keys of one property of one node, one for each frame.

    Attributes:
        node: index in the file.
        path: what is animated.
        values: [T, 4] local rotations wxyz, or [T, 3] translations in the units of the file.
    """

    node: int
    path: Property
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class Animation:
    """Keys that play together.

    Attributes:
        name: of the clip, as engines show it.
        fps: keys per second.
        channels: with T keys each, at least one.
    """

    name: str
    fps: float
    channels: Sequence[Channel]


def append_clips(document: Document, animations: Sequence[Animation]) -> bytes:
    """Returns a GLB file with more animations.

    The keys are LINEAR, and those of one animation share one row of times, which begins at 0. Quaternions keep their
    sign from key to key. An animated node with a `matrix` is given the same pose as translation, rotation and scale,
    which glTF demands. Buffers and images that lie in other files are packed into this one. A number is added to the
    name of an animation that the file already has.

    Raises:
        InputError: if there is nothing to animate, a key is not finite, or the file's lists or images are malformed.
    """
    for animation in animations:
        _check_keys(document, animation.channels, animation.fps)
    for name in ("images", "bufferViews", "accessors", "animations"):
        document.items(name)
    data, binary = pack(document)
    animated = {channel.node for animation in animations for channel in animation.channels}
    data["nodes"] = _as_trs(data["nodes"], animated)
    for animation in animations:
        data, binary = _append(data, binary, animation)
    return glb(data, binary, document.chunks)


def _append(data: dict[str, Any], binary: bytes, animation: Animation) -> tuple[dict[str, Any], bytes]:
    """Returns the JSON and the binary chunk of a packed file with one more animation."""
    keys, accessors = _keys(animation.channels, animation.fps)
    views, before, old = (data.get(name, []) for name in ("bufferViews", "accessors", "animations"))
    name = unused_name(animation.name, old)
    view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(keys)}
    binary += keys
    changed = {
        "buffers": [{**_first(data.get("buffers")), "byteLength": len(binary)}, *data.get("buffers", [])[1:]],
        "bufferViews": [*views, view],
        "accessors": [*before, *({"bufferView": len(views), **accessor} for accessor in accessors)],
        "animations": [*old, _animation(animation.channels, len(before), name)],
    }
    return {**data, **changed}, binary


def glb(data: dict[str, Any], binary: bytes, others: Sequence[tuple[bytes, bytes]] = ()) -> bytes:
    """Returns the bytes of a GLB file.

    Args:
        data: its JSON.
        binary: its binary chunk, which must fill whole words of 4 bytes; none is written if it is empty.
        others: type and content of further chunks.
    """
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    text = text.encode("utf-8", "backslashreplace")  # half a surrogate pair stays the escape that it was in the file
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), _JSON_CHUNK) + text
    if binary:
        chunks += struct.pack("<I4s", len(binary), _BIN_CHUNK) + binary
    for kind, content in others:
        chunks += struct.pack("<I4s", len(_words(content)), kind) + _words(content)
    return struct.pack("<4sII", _MAGIC, 2, 12 + len(chunks)) + chunks


def pack(document: Document) -> tuple[dict[str, Any], bytes]:
    """Returns the JSON of a document whose data all lie in one binary chunk, and that chunk, in whole words of 4 bytes.

    A GLB file without other files is already packed: its JSON is returned as it is.

    Raises:
        InputError: if an image cannot be read, all are too large together, or a buffer view lies in no buffer.
    """
    data, binary = dict(document.json), document.binary
    buffers = data.get("buffers", [])
    if any("uri" in buffer for buffer in buffers):
        data, binary = _pack_buffers(data, document)
    elif buffers:
        binary = binary[: buffers[0]["byteLength"]]
    images = document.items("images")
    outside = [number for number, image in enumerate(images) if not _is_inside(image)]
    return _pack_images(data, _words(binary), document, outside) if outside else (data, _words(binary))


def _is_inside(image: dict[str, Any]) -> bool:
    """Returns whether an image is within the file: in its binary chunk or its JSON."""
    uri = image.get("uri")
    return uri is None or (isinstance(uri, str) and uri.startswith("data:"))


def _pack_buffers(data: dict[str, Any], document: Document) -> tuple[dict[str, Any], bytes]:
    starts, rows, end = [], [], 0
    for content in document.buffers:
        starts.append(end)
        rows.append(_words(content))
        end += len(rows[-1])
    views, binary = [], b"".join(rows)
    for number, view in enumerate(document.items("bufferViews")):
        buffer, offset = view.get("buffer"), view.get("byteOffset", 0)
        document.item("buffers", buffer, f"bufferViews[{number}].buffer")
        if not is_index(offset, MAX_BYTES):
            rule = f"must be a number of bytes below {MAX_BYTES}"
            raise InputError(document.path, f"bufferViews[{number}].byteOffset", shown(offset), rule)
        views.append({**view, "buffer": 0, "byteOffset": starts[view["buffer"]] + offset})
    kept = {key: value for key, value in data["buffers"][0].items() if key != "uri"}
    return {**data, "buffers": [{**kept, "byteLength": len(binary)}], "bufferViews": views}, binary


def _pack_images(
    data: dict[str, Any], binary: bytes, document: Document, outside: Sequence[int]
) -> tuple[dict[str, Any], bytes]:
    """Returns the JSON and the binary chunk with the images inside that lie in other files."""
    images, views, rows, end = list(data["images"]), list(data.get("bufferViews", [])), [binary], len(binary)
    for number in outside:
        content = read_uri(document, images[number]["uri"], f"images[{number}]")
        kind = next((mime for start, mime in _SIGNATURES.items() if content.startswith(start)), "image/png")
        image = {key: value for key, value in images[number].items() if key != "uri"}
        images[number] = {**image, "mimeType": image.get("mimeType", kind), "bufferView": len(views)}
        views.append({"buffer": 0, "byteOffset": end, "byteLength": len(content)})
        rows.append(_words(content))
        end += len(rows[-1])
        if end > MAX_BYTES:
            raise InputError(document.path, f"images[{number}]", "too large", f"must be at most {MAX_BYTES} in all")
    size = {**_first(data.get("buffers")), "byteLength": end}
    return {**data, "images": images, "bufferViews": views, "buffers": [size]}, b"".join(rows)


def _words(binary: bytes) -> bytes:
    return binary + b"\0" * (-len(binary) % 4)


def _first(buffers: list[dict[str, Any]] | None) -> dict[str, Any]:
    return buffers[0] if buffers else {}


def _check_keys(document: Document, channels: Sequence[Channel], fps: float) -> None:
    if not channels:
        raise InputError(document.path, "clip", "no joints to animate", "must move at least one")
    if not (np.isfinite(fps) and fps > 0):
        raise InputError(document.path, "frame rate", fps, "must be positive and finite")
    for channel in channels:
        bad = ~(np.abs(channel.values) <= np.finfo(np.float32).max)
        if bad.any():
            frame = int(np.argwhere(bad)[0][0])
            rule = "every value must be finite"
            raise InputError(document.path, f"frame {frame}", f"non-finite {channel.path} of node {channel.node}", rule)


def _keys(channels: Sequence[Channel], fps: float) -> tuple[bytes, list[dict[str, Any]]]:
    """Returns the bytes of times and keys, and an accessor for each without its buffer view: the times first."""
    times = (np.arange(len(channels[0].values)) / fps).astype("<f4")
    rows, accessors, start = [times.tobytes()], [_accessor(0, times, "SCALAR")], times.nbytes
    accessors[0] |= {"min": [float(times[0])], "max": [float(times[-1])]}
    for channel in channels:
        values = channel.values
        if channel.path == "rotation":
            values = np.roll(quat_align(values), -1, axis=-1)  # xyzw
        keys = np.ascontiguousarray(values, "<f4")
        accessors.append(_accessor(start, keys, "VEC4" if channel.path == "rotation" else "VEC3"))
        rows.append(keys.tobytes())
        start += keys.nbytes
    return b"".join(rows), accessors


def _accessor(start: int, values: np.ndarray, kind: str) -> dict[str, Any]:
    return {"byteOffset": start, "componentType": FLOAT, "count": len(values), "type": kind}


def _animation(channels: Sequence[Channel], first: int, name: str) -> dict[str, Any]:
    """Returns the animation whose times are in the accessor `first` and whose keys follow it."""
    samplers = [{"input": first, "interpolation": "LINEAR", "output": first + 1 + i} for i in range(len(channels))]
    targets = [{"node": channel.node, "path": channel.path} for channel in channels]
    rows = [{"sampler": number, "target": target} for number, target in enumerate(targets)]
    return {"name": name, "channels": rows, "samplers": samplers}


def unused_name(name: str, animations: Sequence[dict[str, Any]]) -> str:
    """Returns a name, followed by a number if one of a file's animations has it."""
    used = [each.get("name") for each in animations]
    number, free = 1, name
    while free in used:
        number += 1
        free = f"{name}_{number}"
    return free


def _as_trs(nodes: list[dict[str, Any]], animated: set[int]) -> list[dict[str, Any]]:
    """Returns the nodes with translation, rotation and scale in place of the matrix of those that are animated."""
    from pfnn_jax.motion.gltf.nodes import decompose

    changed = list(nodes)
    for number in animated:
        node = nodes[number]
        kept = changed[number] = {key: value for key, value in node.items() if key != "matrix"}
        if node.get("matrix") is not None:
            translation, rotation, scale = decompose(np.reshape(node["matrix"], (4, 4)).T)
            trs = {"translation": translation, "rotation": np.roll(rotation, -1), "scale": scale}
            changed[number] = {**kept, **{key: value.tolist() for key, value in trs.items()}}
    return changed
