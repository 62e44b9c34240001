"""The text of BVH files: hierarchy and rows of numbers, checked, before any geometry."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError

LIMIT = 1e7  # no length or angle of a person comes near; far below where squares overflow
CHANNELS = {f"{axis}{kind}": f"{kind[0]}{axis}" for axis in "XYZ" for kind in ("POSITION", "ROTATION")}
LONGEST_FRAME, SHORTEST_FRAME = 10.0, 1e-5  # seconds


@dataclass
class BvhJoint:
    """One joint as the hierarchy states it; channels as `PX` for Xposition, `RZ` for Zrotation."""

    name: str
    parent: int
    line: int
    offset: np.ndarray | None = None
    channels: list[str] | None = None
    end_sites: list[np.ndarray] = field(default_factory=list)
    num_children: int = 0


@dataclass(frozen=True)
class BvhText:
    """What a BVH file says.

    Attributes:
        joints: depth first, so that an only child follows its parent.
        frame_time: seconds.
        values: [T, C] one number per frame and channel, channels in the joints' order.
    """

    joints: list[BvhJoint]
    frame_time: float
    values: np.ndarray


def parse_bvh(path: Path) -> BvhText:
    """Read and check the text of a BVH file.

    Raises:
        InputError: naming the file, the line, the value found and the rule.
    """
    text = _read_text(path)
    hierarchy, frames, frame_time, first_line, numbers = _split(path, text)
    joints = _parse_hierarchy(path, hierarchy)
    columns = sum(len(joint.channels or ()) for joint in joints)
    return BvhText(joints, frame_time, _parse_frames(path, numbers, first_line, frames, columns))


class _Tokens:
    """The words of a hierarchy with their line numbers."""

    def __init__(self, path: Path, text: str):
        self.path = path
        self.names: set[str] = set()
        self.words = [
            (word, number)
            for number, line in enumerate(text.split("\n"), start=1)
            for word in re.findall(r"[{}]|[^\s{}]+", line)
        ]
        self.next = 0

    def fail(self, value: object, rule: str) -> InputError:
        line = self.words[min(max(self.next - 1, 0), len(self.words) - 1)][1] if self.words else 1
        return InputError(self.path, f"line {line}", shorten(value), rule)

    def peek(self) -> str:
        return self.words[self.next][0] if self.next < len(self.words) else ""

    def take(self, rule: str, expected: str | None = None) -> str:
        word = self.peek()
        self.next += 1
        if not word:
            raise self.fail("end of file", rule)
        if expected is not None and word.upper() != expected:
            raise self.fail(word, rule)
        return word

    def number(self, what: str) -> float:
        word = self.take(f"{what} must be a number")
        try:
            value = float(word)
        except ValueError:
            raise self.fail(word, f"{what} must be a number") from None
        if not abs(value) <= LIMIT:
            raise self.fail(word, f"{what} must be finite and within ±{LIMIT:g}")
        return value

    def vector(self, what: str) -> np.ndarray:
        return np.array([self.number(what) for _ in range(3)])

    def rest_of_line(self, rule: str) -> str:
        """The words up to an opening brace on the same line: names may hold spaces."""
        line, words = self.words[self.next - 1][1], []
        while self.next < len(self.words) and self.words[self.next][1] == line and self.peek() != "{":
            words.append(self.take(rule))
        if not words:
            raise self.fail("no name", rule)
        return " ".join(words)


def shorten(value: object) -> str:
    """A value fit for a one-line message, however long or unprintable it is."""
    text = str(value)
    text = text if text.isprintable() else ascii(text)
    return text if len(text) <= 40 else text[:37] + "..."


def _read_text(path: Path) -> str:
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(path, "file", error.strerror or error, "must be a readable BVH file") from None
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")  # joint names in older encodings
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _split(path: Path, text: str) -> tuple[str, int, float, int, str]:
    """(hierarchy text, number of frames, frame time in seconds, line number of the first frame, rows of numbers)."""
    if not re.match(r"\s*HIERARCHY\b", text, re.IGNORECASE):
        raise InputError(
            path,
            "line 1",
            shorten(text.strip()[:80].split("\n")[0] or "empty file"),
            "a BVH file starts with HIERARCHY",
        )
    motion = re.search(r"^[ \t]*MOTION[ \t]*$|(?<=\})\s*MOTION\b", text, re.IGNORECASE | re.MULTILINE)
    if motion is None:
        raise InputError(path, f"line {text.count(chr(10)) + 1}", "end of file", "MOTION must follow the hierarchy")
    head = re.compile(r"\s*Frames\s*:[ \t]*(\S*)\s+Frame\s+Time\s*:[ \t]*(\S*)[^\S\n]*\n?", re.IGNORECASE)
    match = head.match(text, motion.end())
    line = text.count("\n", 0, motion.end()) + 1
    if match is None:
        after = shorten(text[motion.end() : motion.end() + 40].strip() or "end of file")
        raise InputError(path, f"line {line}", after, "MOTION is followed by `Frames: N` and `Frame Time: SECONDS`")
    first_line = text.count("\n", 0, match.end()) + 1
    frames_line, time_line = (f"line {text.count(chr(10), 0, match.start(group)) + 1}" for group in (1, 2))
    try:
        frames = int(match[1])
    except ValueError:
        raise InputError(path, frames_line, f"Frames: {shorten(match[1])}", "must be a whole number") from None
    if frames < 1:
        raise InputError(path, frames_line, f"Frames: {frames}", "there must be at least one frame")
    try:
        seconds = float(match[2])
    except ValueError:
        seconds = float("nan")
    if not SHORTEST_FRAME <= seconds <= LONGEST_FRAME:
        rule = f"must be a number of seconds between {SHORTEST_FRAME:g} and {LONGEST_FRAME:g}"
        raise InputError(path, time_line, f"Frame Time: {shorten(match[2])}", rule)
    return text[: motion.start()], frames, seconds, first_line, text[match.end() :]


def _parse_hierarchy(path: Path, text: str) -> list[BvhJoint]:
    tokens = _Tokens(path, text)
    tokens.take("a BVH file starts with HIERARCHY", "HIERARCHY")
    tokens.take("HIERARCHY is followed by ROOT", "ROOT")
    joints: list[BvhJoint] = []
    open_joints: list[int] = []
    _open_joint(tokens, joints, open_joints)
    while open_joints:
        joint = joints[open_joints[-1]]
        word = tokens.take(f"joint {shorten(joint.name)} is not closed by a brace")
        match word.upper():
            case "OFFSET" if joint.offset is None:
                joint.offset = tokens.vector(f"OFFSET of {shorten(joint.name)}")
            case "CHANNELS" if joint.channels is None:
                joint.channels = _parse_channels(tokens, joint)
            case "JOINT":
                joint.num_children += 1
                _open_joint(tokens, joints, open_joints)
            case "END":
                joint.end_sites.append(_parse_end_site(tokens))
            case "}":
                _close_joint(tokens, joint)
                open_joints.pop()
            case _:
                raise tokens.fail(word, "a joint holds one OFFSET, one CHANNELS, then JOINT or End Site, and a brace")
    if tokens.peek():
        tokens.next += 1
        raise tokens.fail(tokens.words[tokens.next - 1][0], "one ROOT, then MOTION")
    return joints


def _open_joint(tokens: _Tokens, joints: list[BvhJoint], open_joints: list[int]) -> None:
    line = tokens.words[tokens.next - 1][1]
    name = tokens.rest_of_line("a joint needs a name")
    if name in tokens.names:
        raise tokens.fail(name, "joint names must differ")
    tokens.take(f"joint {shorten(name)} opens with a brace", "{")
    tokens.names.add(name)
    joints.append(BvhJoint(name, open_joints[-1] if open_joints else -1, line))
    open_joints.append(len(joints) - 1)


def _close_joint(tokens: _Tokens, joint: BvhJoint) -> None:
    if joint.offset is None or joint.channels is None:
        missing = "OFFSET" if joint.offset is None else "CHANNELS"
        raise tokens.fail(f"joint {shorten(joint.name)} without {missing}", "every joint has OFFSET and CHANNELS")
    if joint.num_children == 0 and not joint.end_sites:
        raise tokens.fail(f"joint {shorten(joint.name)} without End Site", "a joint without children has an End Site")


def _parse_channels(tokens: _Tokens, joint: BvhJoint) -> list[str]:
    """Channels as two letters, `PX` for Xposition and `RZ` for Zrotation."""
    count = tokens.number("the count of CHANNELS")
    if count not in range(7):
        raise tokens.fail(tokens.words[tokens.next - 1][0], "a joint has 0 to 6 channels")
    channels: list[str] = []
    for _ in range(int(count)):
        word = tokens.take("the stated count of channels must follow")
        channel = CHANNELS.get(word.upper())
        if channel is None or channel in channels:
            rule = f"joint {shorten(joint.name)} states {int(count)} different channels, as Xposition or Zrotation"
            raise tokens.fail(word, rule)
        channels.append(channel)
    return channels


def _parse_end_site(tokens: _Tokens) -> np.ndarray:
    rule = "an end is written `End Site { OFFSET x y z }`"
    tokens.take(rule, "SITE")
    if tokens.peek() != "{":
        tokens.rest_of_line(rule)  # some exporters name their end sites
    tokens.take(rule, "{")
    tokens.take(rule, "OFFSET")
    offset = tokens.vector("OFFSET of End Site")
    tokens.take(rule, "}")
    return offset


def _parse_frames(path: Path, numbers: str, first_line: int, frames: int, columns: int) -> np.ndarray:
    """[T, columns] numbers, refused unless every row has one finite number per channel."""
    if columns == 0:
        raise InputError(path, "hierarchy", "no channels", "at least one joint must move")
    values = None
    if not numbers.isspace() and numbers:
        try:
            values = np.loadtxt(io.StringIO(numbers), dtype=float, comments=None, ndmin=2)
        except ValueError:
            values = None
    if values is None or values.shape != (frames, columns) or not np.abs(values).max() <= LIMIT:
        raise _frames_error(path, numbers, first_line, frames, columns)
    return values


def _frames_error(path: Path, numbers: str, first_line: int, frames: int, columns: int) -> InputError:
    """What is wrong with the rows, found line by line since speed no longer matters."""
    rows, last = 0, first_line
    for line, text in enumerate(numbers.split("\n"), start=first_line):
        words = text.split()
        if not words:
            continue
        rows, last = rows + 1, line
        for column, word in enumerate(words, start=1):
            try:
                good = abs(float(word)) <= LIMIT and word.isascii() and "_" not in word
            except ValueError:
                good = False
            if not good:
                rule = f"must be a finite number within ±{LIMIT:g}"
                return InputError(path, f"line {line}", f"value {column} is {shorten(word)}", rule)
        if len(words) != columns:
            rule = f"the hierarchy's channels need {columns}"
            return InputError(path, f"line {line}", f"{len(words)} numbers", rule)
    return InputError(path, f"line {last}", f"{rows} frames", f"`Frames:` states {frames}")
