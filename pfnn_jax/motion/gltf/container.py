"""Reads the container of a glTF file: the JSON and its buffers, from `.glb`, `.vrm` and `.gltf` files.

Everything that a file declares (lengths, indices, addresses) is checked against the file before it is used.

Source: glTF 2.0 specification, sections 3.6.1 and 4 (GLB).
"""

from __future__ import annotations

import base64
import binascii
import json
import math
import re
import struct
import urllib.parse
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, TypeGuard

from pfnn_jax.errors import InputError

MAX_BYTES = 512 * 2**20
"""Largest file, and largest sum of buffers, that is read."""

MAX_JSON = 64 * 2**20
"""Largest JSON chunk; characters have at most a few hundred kilobytes."""

MAX_DEPTH = 64
"""Deepest nesting of the JSON."""

MAX_NODES = 20_000
"""Most nodes; characters have at most a few hundred."""

MAX_CLIPS = 1_000
"""Most animations; large collections have a few hundred."""

DECODED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
"""Extensions whose data need a decoder."""

READABLE = frozenset(
    (
        "KHR_materials_unlit", "KHR_texture_transform", "KHR_mesh_quantization", "KHR_texture_basisu",
        "EXT_texture_webp", "KHR_lights_punctual", "VRM", "VRMC_vrm", "VRMC_vrm_animation",
    )
)  # fmt: skip
"""Extensions that a file may require, with those of materials: they change nothing that is read of it."""

_HEADER, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")


@dataclass(frozen=True, eq=False)
class Document:
    """A glTF file.

    Attributes:
        path: of the file.
        json: as parsed; keys that are not known are kept.
        binary: the binary chunk of a GLB; empty without one.
        buffers: the bytes of each of the JSON's buffers, cut to their declared lengths.
        chunks: type and content of the other chunks of a GLB, which extensions may bring.
    """

    path: Path
    json: dict[str, Any]
    binary: bytes
    buffers: tuple[bytes, ...]
    chunks: tuple[tuple[bytes, bytes], ...] = ()

    def items(self, name: str) -> list[Any]:
        """Returns a top-level list, such as `nodes`; empty if the file has none.

        Raises:
            InputError: if it is no list of objects.
        """
        found = self.json.get(name, [])
        if not isinstance(found, list) or not all(isinstance(item, dict) for item in found):
            raise InputError(self.path, name, type(found).__name__, "must be a list of objects")
        return found

    def item(self, name: str, index: Any, place: str) -> dict[str, Any]:
        """Returns one entry of a top-level list.

        Raises:
            InputError: unless `index`, which stands at `place`, is the number of one.
        """
        items = self.json.get(name, [])  # not `items`, which looks at all of them
        count = len(items) if isinstance(items, list) else 0
        if not is_index(index, count):
            raise InputError(self.path, place, shown(index), f"must be one of the file's {count} {name}")
        if not isinstance(items[index], dict):
            raise InputError(self.path, f"{name}[{index}]", shown(items[index]), "must be an object")
        return items[index]


def read_document(path: str | Path) -> Document:
    """Reads the JSON and the buffers of a `.glb`, `.vrm` or `.gltf` file.

    Raises:
        InputError: for a file that cannot be read, is truncated or malformed, requires an extension that needs a
            decoder or is not known, or names buffers outside its own folder.
    """
    path = Path(path)
    raw = _read_bytes(path)
    text, binary, others = _chunks(path, raw) if raw[:4] == b"glTF" else (raw, b"", ())
    document = Document(path, _parse(path, text), binary, (), others)
    _check_asset(document)
    return replace(document, buffers=_buffers(document))


def is_index(value: Any, count: int) -> TypeGuard[int]:
    """Returns whether a value of the JSON is a whole number from 0 up to `count`."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < count


def shown(value: Any) -> str:
    """Returns a value of the JSON for a message, in one short line."""
    text = ascii(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _read_bytes(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise InputError(path, "size", f"{size} bytes", f"must be at most {MAX_BYTES}")
        return path.read_bytes()
    except OSError as error:
        raise InputError(path, "file", error.strerror or "unreadable", "must be a readable glTF file") from None


def _chunks(path: Path, raw: bytes) -> tuple[bytes, bytes, tuple[tuple[bytes, bytes], ...]]:
    """Returns the JSON chunk and the binary chunk of a GLB file, and type and content of all others."""
    if len(raw) < _HEADER.size:
        raise InputError(path, "header", f"{len(raw)} bytes", "must have 12 bytes: the file is cut off")
    _, version, length = _HEADER.unpack_from(raw)
    if version != 2:
        raise InputError(path, "header", f"version {version}", "must be glTF 2")
    if length > len(raw):
        found = f"{len(raw)} of {length} bytes"
        raise InputError(path, "header", found, "must be whole: the file is cut off")
    chunks: list[tuple[bytes, bytes]] = []
    at = _HEADER.size
    while at + _CHUNK.size <= length:
        size, kind = _CHUNK.unpack_from(raw, at)
        at += _CHUNK.size
        if size > length - at:
            raise InputError(path, f"chunk {len(chunks)}", f"{size} bytes", f"only {length - at} follow in the file")
        chunks.append((kind, raw[at : at + size]))
        at += size
    if not chunks or chunks[0][0] != b"JSON":
        raise InputError(path, "chunk 0", shown(chunks[0][0]) if chunks else "missing", "must be JSON")
    binary = next((data for kind, data in chunks[1:2] if kind == b"BIN\0"), b"")
    others = tuple(chunk for chunk in chunks[1:] if chunk[0] not in (b"JSON", b"BIN\0"))
    return chunks[0][1], binary, others


def _parse(path: Path, text: bytes) -> dict[str, Any]:
    if len(text) > MAX_JSON:
        raise InputError(path, "JSON", f"{len(text)} bytes", f"must be at most {MAX_JSON}")
    try:
        content = text.decode("utf-8-sig").rstrip("\0")
        data = json.loads(content, parse_constant=_refuse_constant, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        what = "nested too deeply" if isinstance(error, RecursionError) else str(error).splitlines()[0][:80]
        raise InputError(path, "JSON", what, "must be a glTF 2 file") from None
    if not isinstance(data, dict):
        raise InputError(path, "JSON", type(data).__name__, "must be an object")
    if _deeper(data, MAX_DEPTH):
        raise InputError(path, "JSON", "nested too deeply", f"must be nested at most {MAX_DEPTH} levels deep")
    return data


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is not JSON")


def _finite(text: str) -> float:
    value = float(text)
    if math.isinf(value):
        raise ValueError(f"{text[:20]} is too large")
    return value


def _deeper(data: Any, levels: int) -> bool:
    """Returns whether JSON data is nested more than so many levels deep, without recursion."""
    row = [data]
    for _ in range(levels):
        row = [v for each in row for v in (each.values() if isinstance(each, dict) else each)]
        row = [v for v in row if isinstance(v, dict | list)]
        if not row:
            return False
    return True


def _check_asset(document: Document) -> None:
    path, data = document.path, document.json
    asset = data.get("asset")
    version = asset.get("version") if isinstance(asset, dict) else None
    if not isinstance(version, str) or not version.startswith("2"):
        raise InputError(path, "asset.version", shown(version), "must be glTF 2")
    required = data.get("extensionsRequired", [])
    if not isinstance(required, list) or not all(isinstance(name, str) for name in required):
        raise InputError(path, "extensionsRequired", shown(required), "must be a list of names")
    for name in required:
        if name in DECODED:
            rule = "its data are compressed: export the file without compression"
            raise InputError(path, "extensionsRequired", name, rule)
        if name not in READABLE and "_materials_" not in name:
            raise InputError(path, "extensionsRequired", shown(name), "is not known: export the file without it")
    for name, most in (("nodes", MAX_NODES), ("animations", MAX_CLIPS)):
        if (count := len(document.items(name))) > most:
            raise InputError(path, name, f"{count} {name}", f"must be at most {most}")


def _buffers(document: Document) -> tuple[bytes, ...]:
    """Returns the bytes of each buffer, cut to its length; a file that several name is read once."""
    found: list[bytes] = []
    known: dict[str, bytes] = {}
    total = 0
    for number, buffer in enumerate(document.items("buffers")):
        place = f"buffers[{number}]"
        uri, length = buffer.get("uri"), buffer.get("byteLength")
        if not is_index(length, MAX_BYTES + 1):
            rule = f"must be a whole number of bytes, at most {MAX_BYTES}"
            raise InputError(document.path, f"{place}.byteLength", shown(length), rule)
        if uri is None and number == 0:
            data = document.binary
        else:
            data = known[uri] if isinstance(uri, str) and uri in known else read_uri(document, uri, place)
            known[str(uri)] = data
        if len(data) < length:
            raise InputError(document.path, place, f"{len(data)} of {length} bytes", "must be whole: it is cut off")
        total += length
        if total > MAX_BYTES:
            raise InputError(document.path, "buffers", "too large", f"must be at most {MAX_BYTES} bytes together")
        found.append(data[:length])
    return tuple(found)


def read_uri(document: Document, uri: Any, place: str = "uri") -> bytes:
    """Returns the bytes of a data URI, or of a file in the folder of the document.

    Args:
        document: whose JSON names the URI.
        uri: as in the JSON.
        place: where it stands, for messages.

    Raises:
        InputError: for a URI that is absolute, on a network or outside the folder, or that cannot be read.
    """
    path = document.path
    if not isinstance(uri, str):
        raise InputError(path, f"{place}.uri", shown(uri), "must name a file or hold the data")
    if uri.startswith("data:"):
        return _decode(path, uri, place)
    return _read_bytes(_alongside(path, uri, place))


def _decode(path: Path, uri: str, place: str) -> bytes:
    head, comma, body = uri.partition(",")
    if not comma or not head.endswith(";base64"):
        raise InputError(path, f"{place}.uri", shown(head), "must be base64 data")
    try:
        return base64.b64decode(body, validate=True)
    except (binascii.Error, ValueError):
        raise InputError(path, f"{place}.uri", shown(head), "must be valid base64 data") from None


def _alongside(path: Path, uri: str, place: str) -> Path:
    """Returns the path of a file in the folder of the document, or below it."""
    name = urllib.parse.unquote(uri)
    parts = PurePosixPath(name).parts
    odd = re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", name) or "\\" in name or "\0" in name
    if odd or not parts or name.startswith("/") or ".." in parts:
        rule = "must be a file in the folder of the glTF file, or in it"
        raise InputError(path, f"{place}.uri", shown(uri), rule)
    folder = path.parent.resolve()
    try:
        target = folder.joinpath(*parts).resolve()
        there = target.is_file()
    except (OSError, UnicodeError, RuntimeError):  # too long, half a surrogate pair, links in a circle
        raise InputError(path, f"{place}.uri", shown(uri), "must be the name of a file") from None
    if not target.is_relative_to(folder):  # a link that leads elsewhere
        raise InputError(path, f"{place}.uri", shown(uri), "must not lead out of the folder of the glTF file")
    if not there:
        raise InputError(path, f"{place}.uri", shown(uri), "no such file next to the glTF file")
    return target
