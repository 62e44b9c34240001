"""Changes files at random, as a damaged disk, a broken exporter or an attacker would."""

from __future__ import annotations

import copy
import json
import re
import struct
from random import Random
from typing import Any

NUMBERS = (
    b"0", b"-1", b"1", b"999999999", b"-999999999", b"4294967296", b"18446744073709551616", b"1e308", b"-1e308",
    b"1e999", b"1e-320", b"nan", b"inf", b"0x10", b"1_0", b"1,5", b"", b"9" * 5000, "٣".encode(), b"[]",
)  # fmt: skip
"""What stands in place of a number: out of range, not finite, of another kind, of other scripts."""

VALUES: tuple[Any, ...] = (
    None, True, [], {}, "", "\ud800", "../../etc/passwd", 0, -1, 1, 2**31, 2**63, 10**30, -(10**30), 1e300, 0.5,
    [0, 0, 0], [1e6] * 3, [0] * 17, [[[]]], "data:application/octet-stream;base64,AAAA", 5126, 999_999_999,
)  # fmt: skip
"""What stands in place of a value of JSON."""

NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w.])")

LONGEST = 4_000_000
"""Bytes of the largest file that is made."""


def mutated(data: bytes, kind: str, random: Random) -> bytes:
    """Returns a file with one to four changes.

    Args:
        data: the file.
        kind: `text`, `bvh`, `json`, `glb`, `safetensors` or `binary`, which allows more kinds of changes.
        random: draws them.
    """
    changes = [*_BYTES, *_KINDS[kind] * 3]
    for _ in range(random.choice((1, 1, 2, 4))):
        data = random.choice(changes)(data, random)[:LONGEST]
    return data


def glb(text: bytes, binary: bytes) -> bytes:
    """Returns a GLB file of a JSON text and a binary chunk."""
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    size = 12 + 8 + len(text) + (8 + len(binary) if binary else 0)
    head = struct.pack("<4sII", b"glTF", 2, size) + struct.pack("<I4s", len(text), b"JSON") + text
    return head + (struct.pack("<I4s", len(binary), b"BIN\0") + binary if binary else b"")


def _flip(data: bytes, random: Random) -> bytes:
    changed = bytearray(data)
    for _ in range(random.choice((1, 2, 8)) if data else 0):
        changed[random.randrange(len(changed))] ^= 1 << random.randrange(8)
    return bytes(changed)


def _overwrite(data: bytes, random: Random) -> bytes:
    start = random.randrange(len(data) + 1)
    new = random.choice((b"\0", b"\xff", b" ", random.randbytes(1))) * random.choice((1, 4, 64))
    return data[:start] + new + data[start + len(new) :]


def _truncate(data: bytes, random: Random) -> bytes:
    return data[: random.randrange(len(data) + 1)]


def _block(data: bytes, random: Random) -> tuple[int, int]:
    start = random.randrange(len(data) + 1)
    return start, min(start + random.choice((1, 16, 256, 4096)), len(data))


def _delete(data: bytes, random: Random) -> bytes:
    start, stop = _block(data, random)
    return data[:start] + data[stop:]


def _duplicate(data: bytes, random: Random) -> bytes:
    start, stop = _block(data, random)
    return data[:stop] + data[start:stop] * random.choice((1, 2, 300)) + data[stop:]


def _move(data: bytes, random: Random) -> bytes:
    start, stop = _block(data, random)
    rest = data[:start] + data[stop:]
    place = random.randrange(len(rest) + 1)
    return rest[:place] + data[start:stop] + rest[place:]


def _number(data: bytes, random: Random) -> bytes:
    """Replaces a number; those at the beginning, which are counts and sizes, as often as all others together."""
    found = list(NUMBER.finditer(data, 0, random.choice((2000, len(data)))))
    if not found:
        return data
    place = random.choice(found)
    return data[: place.start()] + random.choice(NUMBERS) + data[place.end() :]


def _lines(data: bytes, random: Random) -> bytes:
    """Repeats, removes or exchanges lines."""
    lines = data.split(b"\n")
    first, second = random.randrange(len(lines)), random.randrange(len(lines))
    choice = random.randrange(3)
    if choice == 0:
        lines[first] = lines[second]
    elif choice == 1:
        del lines[first : first + random.choice((1, 5))]
    else:
        lines[first:first] = [lines[first]] * random.choice((1, 10, 1000))
    return b"\n".join(lines)


def _frames(data: bytes, random: Random) -> bytes:
    """States another number of frames, or another time for each."""
    word = random.choice((rb"(Frames:\s*)\S+", rb"(Frame Time:\s*)\S+", rb"(CHANNELS\s+)\d+", rb"(OFFSET\s+)\S+"))
    return re.sub(word, lambda found: found[1] + random.choice(NUMBERS), data, count=random.choice((0, 1)))


def _nest(data: bytes, random: Random) -> bytes:
    """Puts a tower of joints into a joint."""
    depth = random.choice((3, 200, 3000, 20_000))
    channels = random.choice((b"", b" CHANNELS 0", b" CHANNELS 3 Zrotation Xrotation Yrotation"))
    opened = b"".join(b"JOINT j%d { OFFSET 0 1 0%s " % (index, channels) for index in range(depth))
    tower = opened + random.choice((b"End Site { OFFSET 0 1 0 } ", b"")) + b"}" * random.choice((depth, depth - 1))
    place = data.find(b"JOINT", random.randrange(len(data) + 1))
    return data[:place] + tower + b"\n" + data[place:] if place >= 0 else data


def _word(data: bytes, random: Random) -> bytes:
    words = (b"JOINT", b"End Site", b"{", b"}", b"OFFSET", b"CHANNELS", b"MOTION", b"ROOT", b"Xposition", b"Zrotation")
    old = random.choice(words)
    return data.replace(old, random.choice((*words, b"")), random.choice((1, 1, -1)))


def _value(data: bytes, random: Random) -> bytes:
    """Changes a value of JSON, removes it, or puts it at another place."""
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):
        return _number(data, random)
    _change(tree, random)
    text = json.dumps(tree).encode()
    if random.randrange(20) == 0:
        deep = random.choice((100, 5000, 200_000))
        text = text.replace(b"[", b"[" * deep, 1) if random.randrange(2) else b'{"a":' * deep + text + b"}" * deep
    return text


def _change(tree: Any, random: Random) -> None:
    place = tree
    while isinstance(place, dict | list) and place:
        key = random.choice(list(place) if isinstance(place, dict) else range(len(place)))
        if isinstance(place[key], dict | list) and place[key] and random.randrange(5):
            place = place[key]
            continue
        choice = random.randrange(8)
        if choice == 0 and isinstance(place, dict):
            del place[key]
        elif choice == 1 and isinstance(place, list):
            place[key:key] = [place[key]] * random.choice((1, 3, 2000))
        elif choice == 2 and isinstance(place[key], int) and not isinstance(place[key], bool):
            place[key] += random.choice((-1, 1, 7, 2**20))  # another index: cycles, overlaps, other accessors
        elif choice == 3 and isinstance(place, dict) and isinstance(tree, dict):
            place[key] = copy.deepcopy(tree[random.choice(list(tree))])
        else:
            place[key] = random.choice(VALUES)
        return


def _document(data: bytes, random: Random) -> bytes:
    """Changes the JSON of a GLB file, whose lengths then fit again."""
    try:
        length = struct.unpack_from("<I", data, 12)[0]
        text, binary = data[20 : 20 + length], data[28 + length :]
        json.loads(text)
    except (ValueError, RecursionError, struct.error):
        return _flip(data, random)
    return glb(_value(text, random), binary)


def _header(data: bytes, random: Random) -> bytes:
    """Changes the JSON of a safetensors file, mostly in an entry of its metadata; its size then fits again."""
    size = int.from_bytes(data[:8], "little")
    try:
        header = json.loads(data[8 : 8 + size])
        metadata = header["__metadata__"]
        key = random.choice(list(metadata))
        metadata[key] = random.choice((_value, _number))(metadata[key].encode(), random).decode(errors="replace")
        text = json.dumps(header).encode()
    except (ValueError, RecursionError, LookupError, TypeError, AttributeError):
        text = _value(data[8 : 8 + size], random)
    return len(text).to_bytes(8, "little") + text + data[8 + size :]


_BYTES = (_flip, _overwrite, _truncate, _delete, _duplicate, _move)

_KINDS = {
    "text": (_number, _lines),
    "bvh": (_number, _lines, _frames, _nest, _word),
    "json": (_value, _number),
    "glb": (_document, _document),
    "safetensors": (_header, _header),
    "binary": (_number,),
}
