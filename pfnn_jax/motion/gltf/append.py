"""Appends animations to a glTF file and touches nothing else: what the file holds besides keeps its meaning and its
bytes. Credits and licences (`asset.copyright`, `asset.extras`), which several libraries drop, stay in the file.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.gltf.container import Document, read_uri
from pfnn_jax.motion.kinematics import quat_align

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
    path: Literal["rotation", "translation"]
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
        InputError: if there is nothing to animate, or a key is not finite.
    """
    for animation in animations:
        _check_keys(document, animation.channels, animation.fps)
    data, binary = pack(document)
    animated = {channel.node for animation in animations for channel in animation.channels}
    data["nodes"] = _as_trs(data["nodes"], animated)
    for animation in animations:
        data, binary = _append(data, binary, animation)
    return glb(data, binary)


def _append(data: dict[str, Any], binary: bytes, animation: Animation) -> tuple[dict[str, Any], bytes]:
    """Returns the JSON and the binary chunk of a packed file with one more animation."""
    keys, accessors = _keys(animation.channels, animation.fps)
    views, before, old = (data.get(name, []) for name in ("bufferViews", "accessors", "animations"))
    name = _unused_name(animation.name, [each.get("name") for each in old])
    view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(keys)}
    binary += keys
    changed = {
        "buffers": [{**_first(data.get("buffers")), "byteLength": len(binary)}, *data.get("buffers", [])[1:]],
        "bufferViews": [*views, view],
        "accessors": [*before, *({"bufferView": len(views), **accessor} for accessor in accessors)],
        "animations": [*old, _animation(animation.channels, len(before), name)],
    }
    return {**data, **changed}, binary


def glb(data: dict[str, Any], binary: bytes) -> bytes:
    """Returns the bytes of a GLB file of a JSON text and one binary chunk, which must fill whole words of 4 bytes."""
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), _JSON_CHUNK) + text
    if binary:
        chunks += struct.pack("<I4s", len(binary), _BIN_CHUNK) + binary
    return struct.pack("<4sII", _MAGIC, 2, 12 + len(chunks)) + chunks


def pack(document: Document) -> tuple[dict[str, Any], bytes]:
    """Returns the JSON of a document whose data all lie in one binary chunk, and that chunk, in whole words of 4 bytes.

    A GLB file without other files is already packed: its JSON is returned as it is.
    """
    data, binary = dict(document.json), document.binary
    buffers = data.get("buffers", [])
    if any("uri" in buffer for buffer in buffers):
        data, binary = _pack_buffers(data, document)
    elif buffers:
        binary = binary[: buffers[0]["byteLength"]]
    for number, image in enumerate(data.get("images", [])):
        uri = image.get("uri", "data:")
        if not uri.startswith("data:"):
            binary = _words(binary)
            data, binary = _pack_image(data, binary, number, read_uri(document, uri))
    return data, _words(binary)


def _pack_buffers(data: dict[str, Any], document: Document) -> tuple[dict[str, Any], bytes]:
    starts, binary = [], b""
    for content, buffer in zip(document.buffers, data["buffers"], strict=True):
        starts.append(len(binary))
        binary = _words(binary + content[: buffer["byteLength"]])
    views = [
        {**view, "buffer": 0, "byteOffset": starts[view["buffer"]] + view.get("byteOffset", 0)}
        for view in data.get("bufferViews", [])
    ]
    kept = {key: value for key, value in data["buffers"][0].items() if key != "uri"}
    return {**data, "buffers": [{**kept, "byteLength": len(binary)}], "bufferViews": views}, binary


def _pack_image(data: dict[str, Any], binary: bytes, number: int, content: bytes) -> tuple[dict[str, Any], bytes]:
    """Returns the JSON and the binary chunk with one image inside."""
    views = data.get("bufferViews", [])
    image = {key: value for key, value in data["images"][number].items() if key != "uri"}
    kind = next((mime for start, mime in _SIGNATURES.items() if content.startswith(start)), "image/png")
    images = list(data["images"])
    images[number] = {**image, "mimeType": image.get("mimeType", kind), "bufferView": len(views)}
    view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(content)}
    size = {**_first(data.get("buffers")), "byteLength": len(binary) + len(content)}
    changed = {"images": images, "bufferViews": [*views, view], "buffers": [size]}
    return {**data, **changed}, binary + content


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
        if not np.all(np.isfinite(channel.values)):
            frame = int(np.argwhere(~np.isfinite(channel.values))[0][0])
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


def _unused_name(name: str, used: Sequence[str | None]) -> str:
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
        if "matrix" in node:
            matrix = np.reshape(node["matrix"], (4, 4)).T
            translation, rotation, scale = decompose(matrix)
            kept = {key: value for key, value in node.items() if key != "matrix"}
            trs = {"translation": translation, "rotation": np.roll(rotation, -1), "scale": scale}
            changed[number] = {**kept, **{key: value.tolist() for key, value in trs.items()}}
    return changed
