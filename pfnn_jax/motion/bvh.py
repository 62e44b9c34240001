"""Reads and writes BVH files as motion clips.

`parse_bvh` reads and checks the text; `read_bvh` makes a clip on a rigid skeleton in metres of it. The reader takes any
channel order, position channels on any joint and any frame rate. It is as fast as pybvh 0.9, which refuses position
channels below the root: 17 ms on one core for 2428 frames and 31 joints, 38 ms with quaternions and roles.
"""

from __future__ import annotations

import functools
import io
import math
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import refuse_existing, write_whole
from pfnn_jax.motion.assumptions import decide_unit, decide_up, doubt_rate, repair
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.filters import median
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.lexicon import limb_points
from pfnn_jax.motion.humanoid.names import read_names
from pfnn_jax.motion.kinematics import (
    AXES,
    joint_positions,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    quat_to_euler,
)
from pfnn_jax.motion.length_unit import CENTIMETRE
from pfnn_jax.motion.reading import Axis, Reading, ReadOptions, Travel, Up, check_options
from pfnn_jax.motion.retargeting.reference import some_poses
from pfnn_jax.motion.roles import assign_roles, is_hips_name, is_upper_body_name, longest_chain
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.up_axis import TURNS, stand_up

LIMIT = 1e7  # far above any length or angle of a person, far below where squares overflow
CHANNELS = {f"{axis}{kind}": f"{kind[0]}{axis}" for axis in "XYZ" for kind in ("POSITION", "ROTATION")}
LONGEST_FRAME, SHORTEST_FRAME = 1.0, 1e-5  # seconds
STRETCH = 0.02  # share of the longest limb by which bones may vary and still count as rigid
MAX_BYTES = 512 * 2**20  # of a file
MAX_HIERARCHY = 4 * 2**20  # characters of a hierarchy; those of persons have some thousands
MAX_JOINTS = 2_000  # persons have at most a few hundred
MAX_POSES = 4_000_000  # joints times frames, unless there is a number for each: joints without channels are free
NO_OFFSET = 1e-4  # share of OFFSET's length up to which position channels count as zero
NUM_POSES = 20  # at most; enough to tell left from right in a walk or a run
HIERARCHY = re.compile(r"\s*HIERARCHY\b", re.IGNORECASE)
MOTION = re.compile(r"^[ \t]*MOTION[ \t]*$|(?<=\})\s*MOTION\b", re.IGNORECASE | re.MULTILINE)
# Tools that cut files may leave the old number of frames next to the new one. Possessive, because a hostile file could
# repeat what is ambiguous otherwise, and take for ever.
COUNT = re.compile(r"Frames\s*:[ \t]*+(\S*+)\s++", re.IGNORECASE)
HEAD = re.compile(rf"\s*((?:{COUNT.pattern}){{1,8}})Frame\s+Time\s*:[ \t]*(\S*)[^\S\n]*\n?", re.IGNORECASE)
RATE_STEP = 2e-4  # relative; printed frame times have few decimals: 0.008333 means 120 fps


@dataclass
class BvhJoint:
    """One joint of the hierarchy; channels are written `PX` for Xposition and `RZ` for Zrotation.

    `unmoved`: all position channels are zero in every frame although OFFSET is not, so that OFFSET holds.
    """

    name: str
    parent: int
    line: int
    offset: np.ndarray | None = None
    channels: list[str] | None = None
    end_sites: list[np.ndarray] = field(default_factory=list)
    num_children: int = 0
    unmoved: bool = False


@dataclass(frozen=True)
class BvhText:
    """The contents of a BVH file.

    Attributes:
        joints: in depth-first order, so that an only child follows its parent.
        frame_time: seconds; not a number if that was not needed and is not one.
        values: [T, C], one number per frame and channel, in the order of the joints' channels.
        counts: numbers of frames that the file states; usually one, T.
    """

    joints: list[BvhJoint]
    frame_time: float
    values: np.ndarray
    counts: tuple[int, ...]


def parse_bvh(path: Path, *, need_rate: bool = True) -> BvhText:
    """Reads and checks the text of a BVH file.

    Args:
        path: file to read.
        need_rate: whether its `Frame Time` must be usable.

    Raises:
        InputError: if the text is malformed, naming the line.
    """
    text = _read_text(path)
    hierarchy, counts, frame_time, first_line, numbers = _split(path, text, need_rate)
    joints = _parse_hierarchy(path, hierarchy)
    columns = sum(len(joint.channels or ()) for joint in joints)
    values = _parse_frames(path, numbers, first_line, counts, columns)
    if len(values) * len(joints) > max(MAX_POSES, values.size):
        rule = f"must be at most {MAX_POSES} joints times frames, where most joints have no channels"
        raise InputError(path, "frames", f"{len(values)} of {len(joints)} joints", rule)
    return BvhText(joints, frame_time, values, tuple(counts))


class _Tokens:
    """A cursor over the words of a hierarchy with their line numbers."""

    def __init__(self, path: Path, text: str):
        self.path = path
        self.names: set[str] = set()
        self.words: list[str] = []
        self.lines: list[int] = []
        for number, line in enumerate(text.replace("{", " { ").replace("}", " } ").split("\n"), start=1):
            words = line.split()
            self.words += words
            self.lines += [number] * len(words)
        self.next = 0

    def fail(self, value: str, rule: str) -> InputError:
        line = self.lines[min(max(self.next - 1, 0), len(self.words) - 1)] if self.words else 1
        return InputError(self.path, f"line {line}", shorten(value), rule)

    def peek(self) -> str:
        return self.words[self.next] if self.next < len(self.words) else ""

    def take(self, rule: str, expected: str | None = None) -> str:
        self.next += 1
        if self.next > len(self.words):
            raise self.fail("end of file", rule)
        word = self.words[self.next - 1]
        if expected is not None and word.upper() != expected:
            raise self.fail(word, rule)
        return word

    def number(self, what: str) -> float:
        word = self.take(f"{what} must be a number")
        try:
            value = _real(word)
        except ValueError:
            raise self.fail(word, f"{what} must be a number") from None
        if not abs(value) <= LIMIT:
            raise self.fail(word, f"{what} must be finite and within ±{LIMIT:g}")
        return value

    def vector(self, what: str) -> np.ndarray:
        try:
            values = [_real(word) for word in self.words[self.next : self.next + 3]]
        except ValueError:
            values = []
        if len(values) == 3 and all(abs(value) <= LIMIT for value in values):
            self.next += 3
            return np.array(values)
        return np.array([self.number(what) for _ in range(3)])  # names what is wrong

    def rest_of_line(self, rule: str) -> str:
        """Takes the words up to an opening brace on the same line: names may contain spaces."""
        line, words = self.lines[self.next - 1], []
        while self.next < len(self.words) and self.lines[self.next] == line and self.peek() != "{":
            words.append(self.take(rule))
        if not words:
            raise self.fail("no name", rule)
        return " ".join(words)


def _real(word: str) -> float:
    """Returns a word as a number; some exporters write decimal commas."""
    return float(word.rstrip(",").replace(",", ".") if "," in word else word)


@functools.lru_cache(maxsize=1024)
def shorten(value: str) -> str:
    """Returns a value as printable text of at most 40 characters, for messages of one line."""
    text = value if value.isprintable() else ascii(value)
    return text if len(text) <= 40 else text[:37] + "..."


def _read_text(path: Path) -> str:
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise InputError(path, "size", f"{size} bytes", f"must be at most {MAX_BYTES}")
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(path, "file", error.strerror or error, "must be a readable BVH file") from None
    try:
        text = raw.decode("utf-16" if raw.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) else "utf-8-sig")
    except UnicodeDecodeError:
        text = _decode_older(raw)
    text = text.rstrip("\0\x1a")  # ends of files on old systems
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _decode_older(raw: bytes) -> str:
    """Returns the text of a file whose joint names are in an older encoding: Shift JIS if it has Japanese sides."""
    with suppress(UnicodeDecodeError):
        text = raw.decode("cp932")
        if "左" in text:
            return text
    return raw.decode("latin-1")


def _split(path: Path, text: str, need_rate: bool) -> tuple[str, list[int], float, int, str]:
    """Splits a text into hierarchy, numbers of frames, frame time in seconds, line of the first frame, and numbers."""
    if not HIERARCHY.match(text):
        raise InputError(
            path,
            "line 1",
            shorten(text.strip()[:80].split("\n")[0] or "empty file"),
            "must start with HIERARCHY",
        )
    motion = _find_motion(text)
    if motion is None:
        raise InputError(path, f"line {text.count(chr(10)) + 1}", "end of file", "MOTION must follow the hierarchy")
    begin, end = motion
    match = HEAD.match(text, end)
    if match is None:
        line = text.count("\n", 0, end) + 1
        after = shorten(text[end : end + 40].strip() or "end of file")
        raise InputError(path, f"line {line}", after, "MOTION precedes `Frames: N` and `Frame Time: SECONDS`")
    first_line = text.count("\n", 0, match.end()) + 1
    counts = [_parse_count(path, text, found) for found in COUNT.finditer(text, *match.span(1))]
    seconds = _parse_frame_time(path, f"line {text.count(chr(10), 0, match.start(3)) + 1}", match[3], need_rate)
    return text[:begin], counts, seconds, first_line, text[match.end() :]


def _find_motion(text: str) -> tuple[int, int] | None:
    """Returns where the word MOTION behind the hierarchy begins and ends, or None."""
    plain = text.find("\nMOTION\n")  # in nearly all files, and found faster
    if plain >= 0:
        return plain + 1, plain + len("\nMOTION")
    found = MOTION.search(text)
    return None if found is None else found.span()


def _parse_count(path: Path, text: str, found: re.Match[str]) -> int:
    place = f"line {text.count(chr(10), 0, found.start(1)) + 1}"
    try:
        frames = int(found[1])
    except ValueError:
        raise InputError(path, place, f"Frames: {shorten(found[1])}", "must be a whole number") from None
    if frames < 1:
        raise InputError(path, place, f"Frames: {frames}", "must be at least 1")
    return frames


def _parse_frame_time(path: Path, place: str, word: str, need_rate: bool) -> float:
    """Returns the seconds of a frame; not a number if they are not usable and need not be."""
    try:
        seconds = _real(word)
    except ValueError:
        seconds = float("nan")
    if SHORTEST_FRAME <= seconds <= LONGEST_FRAME:
        return seconds
    if not need_rate:
        return float("nan")
    rule = f"must be a number of seconds between {SHORTEST_FRAME:g} and {LONGEST_FRAME:g}"
    if seconds > LONGEST_FRAME:
        meant = f"{seconds / 1000:g} for milliseconds, {1 / seconds:.6g} for frames per second"
        rule += f" ({meant}); or give the rate with `--source-fps`"
    raise InputError(path, place, f"Frame Time: {shorten(word)}", rule)


def _parse_hierarchy(path: Path, text: str) -> list[BvhJoint]:
    if len(text) > MAX_HIERARCHY:
        raise InputError(path, "hierarchy", f"{len(text)} characters", f"must be at most {MAX_HIERARCHY}")
    tokens = _Tokens(path, text)
    tokens.take("must start with HIERARCHY", "HIERARCHY")
    tokens.take("HIERARCHY must be followed by ROOT", "ROOT")
    joints: list[BvhJoint] = []
    open_joints: list[int] = []
    _open_joint(tokens, joints, open_joints)
    while open_joints:
        joint = joints[open_joints[-1]]
        word = tokens.take(f"joint {shorten(joint.name)} must be closed by a brace")
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
                rule = "a joint must hold one OFFSET, one CHANNELS, then JOINT or End Site, and a brace"
                raise tokens.fail(word, rule)
    if tokens.peek():
        tokens.next += 1
        raise tokens.fail(tokens.words[tokens.next - 1], "there must be one ROOT, then MOTION")
    return joints


def _open_joint(tokens: _Tokens, joints: list[BvhJoint], open_joints: list[int]) -> None:
    line = tokens.lines[tokens.next - 1]
    name = tokens.rest_of_line("a joint must have a name")
    if name in tokens.names:
        raise tokens.fail(name, "joint names must differ")
    tokens.take(f"joint {shorten(name)} must be opened by a brace", "{")
    if len(joints) == MAX_JOINTS:
        raise tokens.fail(f"joint {len(joints) + 1}", f"must be at most {MAX_JOINTS} joints")
    tokens.names.add(name)
    joints.append(BvhJoint(name, open_joints[-1] if open_joints else -1, line))
    open_joints.append(len(joints) - 1)


def _close_joint(tokens: _Tokens, joint: BvhJoint) -> None:
    if joint.offset is None or joint.channels is None:
        missing = "OFFSET" if joint.offset is None else "CHANNELS"
        raise tokens.fail(f"joint {shorten(joint.name)} without {missing}", "every joint must have OFFSET and CHANNELS")
    if joint.num_children == 0 and not joint.end_sites:
        joint.end_sites.append(np.zeros(3))  # some exporters end chains without an End Site


def _parse_channels(tokens: _Tokens, joint: BvhJoint) -> list[str]:
    """Returns channels as two letters: `PX` for Xposition, `RZ` for Zrotation."""
    count = tokens.number("the count of CHANNELS")
    if count not in range(7):
        raise tokens.fail(tokens.words[tokens.next - 1], "a joint must have 0 to 6 channels")
    channels: list[str] = []
    for _ in range(int(count)):
        word = tokens.take("as many channels must follow as their count says")
        channel = CHANNELS.get(word.upper())
        if channel is None or channel in channels:
            rule = f"joint {shorten(joint.name)} must list {int(count)} different channels, such as Zrotation"
            raise tokens.fail(word, rule)
        channels.append(channel)
    return channels


def _parse_end_site(tokens: _Tokens) -> np.ndarray:
    rule = "must be written `End Site { OFFSET x y z }`"
    tokens.take(rule, "SITE")
    if tokens.peek() != "{":
        tokens.rest_of_line(rule)  # some exporters name their end sites
    tokens.take(rule, "{")
    tokens.take(rule, "OFFSET")
    offset = tokens.vector("OFFSET of End Site")
    tokens.take(rule, "}")
    return offset


def _parse_frames(path: Path, numbers: str, first_line: int, counts: list[int], columns: int) -> np.ndarray:
    """Parses [T, columns] numbers, checking that every row has one finite number per channel.

    There may be more rows than the file counts: some exporters do not count a first row with the rest pose. Of a file
    that counts its frames differently in several lines, all rows are taken.
    """
    if columns == 0:
        raise InputError(path, "hierarchy", "no channels", "at least one joint must move")
    values = None
    if "," in numbers:  # decimal commas, or commas between numbers with decimal points
        numbers = numbers.replace(",", " " if "." in numbers else ".")
    if not numbers.isspace() and numbers:
        try:
            values = np.loadtxt(io.StringIO(numbers), dtype=float, comments=None, ndmin=2)
        except ValueError:
            values = None
    if values is None or values.shape[1] != columns or not np.abs(values).max() <= LIMIT:
        raise _frames_error(path, numbers, first_line, counts[0], columns)
    if len(set(counts)) == 1 and len(values) < counts[0]:
        raise _frames_error(path, numbers, first_line, counts[0], columns)
    return values


def _frames_error(path: Path, numbers: str, first_line: int, frames: int, columns: int) -> InputError:
    """Finds what is wrong with the rows, line by line since speed no longer matters."""
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
            rule = f"must be {columns}, one for each channel of the hierarchy"
            return InputError(path, f"line {line}", f"{len(words)} numbers", rule)
    return InputError(path, f"line {last}", f"{rows} frames", f"must be {frames} or more, as `Frames:` says")


def read_skeleton(path: str | Path) -> Skeleton:
    """Reads the joints of a BVH file and their OFFSETs, in the file's unit and without its motion.

    Joints above the hips are left out, and no roles are found.

    Raises:
        InputError: if the hierarchy is malformed, naming the line.
    """
    path = Path(path)
    text = _read_text(path)
    motion = _find_motion(text)
    joints = _parse_hierarchy(path, text if motion is None else text[: motion[0]])
    kept = _kept(joints)
    names, parents, end_sites = _tree(joints, kept)
    offsets = np.array([np.zeros(3), *(joint.offset for joint in joints[kept][1:])])
    return Skeleton(names, parents, offsets, end_sites, np.arange(len(names)))


def read_bvh(
    path: str | Path,
    *,
    unit: float | str | None = None,
    up: Up = "auto",
    source_fps: float | None = None,
    travel: Travel = "auto",
    roles_file: str | Path | None = None,
) -> MotionClip:
    """Reads a BVH file.

    Joints above the hips that only carry the root, such as `joint_Root` of the Bandai-Namco files, are merged into the
    hips: joint 0 moves by the product of their transforms, and their names in `roles_file` mean it. Position channels
    replace OFFSET, unless all are zero and OFFSET is not; below the root they must be constant (within 2 % of the
    longest limb, as bones are rigid), and their median becomes the offset. A joint without children and without
    End Site ends in itself.

    What a file does not state is found from its motion: see `reading.ReadOptions` for the options, and
    `MotionClip.reading` for what was decided. Jumps are cut out (`jumps.longest_part`).

    Args:
        path: file to read.
        unit: metres per unit of the file, or a name in `length_unit.UNITS`; None guesses it from the legs.
        up: the axis that points up.
        source_fps: frames per second, in place of the file's `Frame Time`.
        travel: whether to rebuild the travel of walks on the spot.
        roles_file: JSON from role to joint name, see `assign_roles`. None finds the roles by names and geometry, and
            leaves them None if that fails.

    Returns:
        The clip, with style `unknown` and empty content.

    Raises:
        InputError: if the file is malformed, naming the line or joint; for legs or speeds that no person has.
    """
    options = ReadOptions(unit, up, source_fps, travel)  # type: ignore[arg-type] # checked by read_whole
    return repair(read_whole(path, options, roles_file), options)


def read_whole(path: str | Path, options: ReadOptions, roles_file: str | Path | None = None) -> MotionClip:
    """Reads all frames of a BVH file, as `read_bvh` without `assumptions.repair`.

    Args:
        path: file to read.
        options: what is known about the file.
        roles_file: as in `read_bvh`.

    Raises:
        InputError: as `read_bvh`.
    """
    path = Path(path)
    check_options(options, path)
    text = parse_bvh(path, need_rate=options.source_fps is None)
    kept = _kept(text.joints)
    names, parents, end_sites, positions, rotations = _fold(text.joints, kept, *_channels(text.joints, text.values))
    offsets = _rest_offsets(positions)
    bare = Skeleton(names, parents, offsets, end_sites, np.arange(len(names)))
    _require_rigid(path, bare, positions)
    merged = [text.joints[joint].name for joint in _above(text.joints, kept.start)]
    skeleton, axis, lying = _find_body(bare, rotations, options, roles_file, path, merged)
    body = skeleton.humanoid
    known = body is not None and body.left_foot is not None and body.right_foot is not None
    leg = leg_length_of(skeleton, body) if body is not None and known else 0.75 * longest_chain(bare)
    unit, doubt = decide_unit(leg, known, options, path)
    sites = tuple((joint, site * unit) for joint, site in end_sites)
    skeleton = replace(skeleton, offsets=offsets * unit, end_sites=sites)
    fps = _frame_rate(text.frame_time) if options.source_fps is None else float(options.source_fps)
    named_by = "" if roles_file is None else str(roles_file)
    reading = Reading(unit, axis, fps, len(rotations), roles_file=named_by)
    reading = reading.noting(*_text_notes(text, kept), doubt_rate(fps, options), doubt, lying)
    clip = MotionClip(skeleton, fps, positions[:, 0] * unit, rotations, source=str(path), reading=reading)
    clip = stand_up(clip, axis)
    return replace(clip, skeleton=replace(clip.skeleton, poses=some_poses(clip.rotations)))


def _find_body(
    bare: Skeleton,
    rotations: np.ndarray,
    options: ReadOptions,
    roles_file: str | Path | None,
    path: Path,
    merged: Collection[str],
) -> tuple[Skeleton, Axis, str]:
    """Returns the skeleton with its map and roles, the axis of the file that points up, and a note on it.

    Where names do not tell left from right, poses that stand do: roles are found again once the axis is known.
    """

    @functools.cache
    def poses() -> np.ndarray:
        return joint_positions(bare, rotations[:: -(-len(rotations) // NUM_POSES)])

    def assign(axis: Axis) -> Skeleton:
        file = None if roles_file is None else Path(roles_file)
        standing = poses if axis == "y" else lambda: quat_rotate(TURNS[axis], poses())
        return assign_roles(bare, file, str(path), poses=standing, merged=merged)

    first: Axis = "y" if options.up == "auto" else options.up
    skeleton = assign(first)
    if skeleton.humanoid is None:
        return skeleton, first, ""
    axis, note = decide_up(poses(), skeleton.humanoid, options)
    again = skeleton if axis == first else assign(axis)
    return skeleton if again.humanoid is None else again, axis, note


def _text_notes(text: BvhText, kept: slice) -> list[str]:
    """Returns what is odd about the text of a file."""
    notes = []
    if set(text.counts) != {len(text.values)}:
        stated = " and ".join(f"`Frames: {count}`" for count in text.counts)
        notes.append(f"all {len(text.values)} rows of numbers are taken as frames, although the file states {stated}")
    unmoved = [joint.name for joint in text.joints if joint.unmoved]
    if unmoved:
        notes.append(f"position channels of {len(unmoved)} joints are zero, such as {unmoved[0]}: OFFSET is used")
    carriers = set(_above(text.joints, kept.start))
    props = [joint.name for at, joint in enumerate(text.joints[: kept.start]) if at not in carriers]
    if props := [*props, *(joint.name for joint in text.joints[kept.stop :])]:
        notes.append(f"{len(props)} joints next to the hips do not belong to the body, such as {props[0]}: left out")
    return notes


def _frame_rate(frame_time: float) -> float:
    """Returns frames per second, rounded to a whole number where the printed frame time means one."""
    fps = 1.0 / frame_time
    whole = round(fps)
    return float(whole) if whole and abs(fps - whole) <= RATE_STEP * whole else fps


def _channels(joints: list[BvhJoint], values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns positions [T, J, 3] in file units and rotations [T, J, 4], both in the parent's frame."""
    positions = np.empty((len(values), len(joints), 3))
    orders: dict[str, list[tuple[int, list[int]]]] = {}
    column, first = 0, values[0].tolist()
    for index, joint in enumerate(joints):
        positions[:, index] = joint.offset
        columns = {channel: column + i for i, channel in enumerate(joint.channels or ())}
        column += len(columns)
        places = {AXES[channel[1]]: place for channel, place in columns.items() if channel[0] == "P"}
        joint.unmoved = index > 0 and len(places) == 3 and _all_zero(values, first, list(places.values()), joint)
        for axis, place in places.items():
            if not joint.unmoved:
                positions[:, index, axis] = values[:, place]
        order = "".join(channel[1] for channel in columns if channel[0] == "R")
        full = order + "".join(axis for axis in "XYZ" if axis not in order)
        # a missing rotation reads the appended column of zeros
        orders.setdefault(full, []).append((index, [columns.get(f"R{axis}", -1) for axis in full]))
    radians = np.concatenate((np.radians(values), np.zeros((len(values), 1))), axis=1)
    rotations = np.empty((len(values), len(joints), 4))
    for order, members in orders.items():
        chosen = radians[:, np.array([columns for _, columns in members])]
        rotations[:, [index for index, _ in members]] = quat_from_euler(chosen, order)
    return positions, rotations


def _all_zero(values: np.ndarray, first: list[float], columns: list[int], joint: BvhJoint) -> bool:
    """Returns whether a joint's positions are zero compared with its OFFSET; `first` is the first of the values [T, C].

    The first frame rules out nearly all joints without a pass over the others.
    """
    size = NO_OFFSET * math.hypot(*joint.offset) if joint.offset is not None else 0.0
    return all(abs(first[column]) < size for column in columns) and bool((np.abs(values[:, columns]) < size).all())


def _fold(joints: list[BvhJoint], kept: slice, positions: np.ndarray, rotations: np.ndarray):
    """Merges the joints above the kept ones into joint 0; returns names, parents, end sites, positions, rotations."""
    chain = [*_above(joints, kept.start), kept.start]
    position, rotation = positions[:, 0], rotations[:, 0]
    for joint in chain[1:]:
        position = position + quat_rotate(rotation, positions[:, joint])
        rotation = quat_multiply(rotation, rotations[:, joint])
    positions, rotations = positions[:, kept].copy(), rotations[:, kept].copy()
    positions[:, 0], rotations[:, 0] = position, rotation
    return *_tree(joints, kept), positions, rotations


def _kept(joints: list[BvhJoint]) -> slice:
    """Returns which joints are kept: the one that becomes joint 0, and all below it."""
    first = 0
    while not _is_body_name(joints[first].name):
        if joints[first].num_children == 1 and not joints[first].end_sites:
            first += 1  # the only child follows its parent
        elif (body := _travelling_body(joints, first)) is not None:
            first = body
        else:
            break
    if joints[first].num_children < 2 and not is_hips_name(joints[first].name):
        first = 0  # a chain without hips is kept whole
    return slice(first, _end_of(joints, first))


def _travelling_body(joints: list[BvhJoint], root: int) -> int | None:
    """Returns the child of a joint that carries hips or legs and travels, next to props and controls alone."""
    children = [joint for joint in range(root + 1, len(joints)) if joints[joint].parent == root]
    bodies = [child for child in children if _has_body(joints[child : _end_of(joints, child)])]
    if len(bodies) != 1 or not _has_legs(joints[bodies[0] : _end_of(joints, bodies[0])]):
        return None
    joint, travels = bodies[0], _travels(joints[bodies[0]])
    while joints[joint].num_children == 1 and not is_hips_name(joints[joint].name):
        joint += 1  # the only child follows its parent
        travels |= _travels(joints[joint])
    return bodies[0] if travels else None


def _travels(joint: BvhJoint) -> bool:
    """Returns whether a joint has channels for all three positions."""
    return sum(channel[0] == "P" for channel in joint.channels or ()) == 3


def _has_body(joints: list[BvhJoint]) -> bool:
    """Returns whether a joint's name is that of a part of the body."""
    return any(_is_body_name(joint.name) or _limb_parts(joint) for joint in joints)


def _has_legs(joints: list[BvhJoint]) -> bool:
    """Returns whether a joint's name is that of the hips or of a leg."""
    return any(is_hips_name(joint.name) or "shin" in _limb_parts(joint) for joint in joints)


def _limb_parts(joint: BvhJoint) -> dict[str, float]:
    """Returns the parts of a limb that a joint's name may mean."""
    return limb_points(read_names((joint.name,))[0])


def _end_of(joints: list[BvhJoint], first: int) -> int:
    """Returns the index behind a joint and all below it, which follow it."""
    below = range(first + 1, len(joints))
    return next((joint for joint in below if joints[joint].parent < first), len(joints))


def _above(joints: list[BvhJoint], joint: int) -> list[int]:
    """Returns the ancestors of a joint, from the root downwards."""
    above = []
    while (joint := joints[joint].parent) >= 0:
        above.insert(0, joint)
    return above


def _tree(
    joints: list[BvhJoint], kept: slice
) -> tuple[tuple[str, ...], np.ndarray, tuple[tuple[int, np.ndarray], ...]]:
    """Returns names, parents and end sites of the kept joints, of which the first becomes joint 0."""
    body = joints[kept]
    parents = np.array([-1] + [joint.parent - kept.start for joint in body[1:]])
    end_sites = tuple((index, site) for index, joint in enumerate(body) for site in joint.end_sites)
    return tuple(joint.name for joint in body), parents, end_sites


@functools.lru_cache(maxsize=1024)
def _is_body_name(name: str) -> bool:
    """Returns whether a joint plays a part of the body: a headset's skeleton is rooted at the head, above the spine."""
    return is_hips_name(name) or is_upper_body_name(name)


def _rest_offsets(positions: np.ndarray) -> np.ndarray:
    """Returns offsets [J, 3]: a joint's constant position, its median if it varies, zero for the root."""
    offsets = positions[0].copy()
    varying = np.any(positions != offsets, axis=0)
    varying[0] = False
    offsets[varying] = median(positions[:, varying])
    offsets[0] = 0.0
    return offsets


def _require_rigid(path: Path, skeleton: Skeleton, positions: np.ndarray) -> None:
    stretch = np.abs(positions - skeleton.offsets).max(axis=(0, 2))
    stretch[0] = 0.0
    joint, size = int(np.argmax(stretch)), longest_chain(skeleton)
    if stretch[joint] > STRETCH * size:
        rule = f"bones must be rigid: positions may vary by {STRETCH:.0%} of the longest limb's {size:.3g}"
        raise InputError(path, f"joint {shorten(skeleton.names[joint])}", f"moves by {stretch[joint]:.3g}", rule)


def write_bvh(path: str | Path, clip: MotionClip, *, unit: float = CENTIMETRE, overwrite: bool = False) -> None:
    """Writes a clip as a BVH file for other software: ZYX Euler channels, centimetres, an End Site on every leaf.

    Joints are written depth first, which is the skeleton's own order for clips that were read from BVH. Numbers have
    6 decimals. The file is written atomically.

    Args:
        path: file to write.
        clip: the motion, in metres.
        unit: metres per unit of the file.
        overwrite: whether to replace an existing file.

    Raises:
        InputError: if the file exists and `overwrite` is false, it cannot be written, or the clip is not finite.
    """
    path = Path(path)
    refuse_existing(path, overwrite)
    write_whole(path, bvh_text(clip, unit=unit, path=path))


def bvh_text(clip: MotionClip, *, unit: float = CENTIMETRE, path: str | Path = "clip") -> str:
    """Returns the text of a BVH file, as `write_bvh` writes it.

    Args:
        clip: the motion, in metres.
        unit: metres per unit of the file.
        path: of the file, for messages.

    Raises:
        InputError: if the clip is empty or not finite, or the unit is not positive.
    """
    if not (np.isfinite(unit) and unit > 0):
        raise InputError(path, "unit", unit, "must be a positive, finite number of metres")
    for what, values in (("root positions", clip.root_positions), ("rotations", clip.rotations)):
        if not np.all(np.isfinite(values)):
            frame = int(np.argwhere(~np.isfinite(values))[0][0])
            raise InputError(path, f"frame {frame}", f"non-finite {what}", "every value must be finite")
    if clip.num_frames < 1:
        raise InputError(path, "clip", "0 frames", "must have at least one frame")
    return "\n".join(_hierarchy_lines(clip.skeleton, unit) + _motion_lines(clip, unit)) + "\n"


def _depth_first(skeleton: Skeleton) -> list[int]:
    children: list[list[int]] = [[] for _ in skeleton.names]
    for joint in range(1, skeleton.num_joints):
        children[skeleton.parents[joint]].append(joint)
    order, waiting = [], [0]
    while waiting:
        order.append(waiting.pop())
        waiting += children[order[-1]][::-1]
    return order


def _hierarchy_lines(skeleton: Skeleton, unit: float) -> list[str]:
    lines, open_joints = ["HIERARCHY"], []
    parents = skeleton.parents

    def put(text: str) -> None:
        lines.append("\t" * len(open_joints) + text)

    def close() -> None:
        joint = open_joints[-1]
        sites = [site for owner, site in skeleton.end_sites if owner == joint]
        if joint not in parents and not sites:
            sites = [np.zeros(3)]
        for site in sites:
            put("End Site")
            put("{")
            put("\tOFFSET " + _numbers(site / unit))
            put("}")
        open_joints.pop()
        put("}")

    for joint in _depth_first(skeleton):
        while open_joints and open_joints[-1] != parents[joint]:
            close()
        put(f"{'JOINT' if open_joints else 'ROOT'} {skeleton.names[joint]}")
        put("{")
        positions = "" if open_joints else "Xposition Yposition Zposition "
        open_joints.append(joint)
        put("OFFSET " + _numbers(skeleton.offsets[joint] / unit))
        put(f"CHANNELS {6 if positions else 3} {positions}Zrotation Yrotation Xrotation")
    while open_joints:
        close()
    return lines


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.6f}" for value in values)


def _motion_lines(clip: MotionClip, unit: float) -> list[str]:
    angles = np.degrees(quat_to_euler(clip.rotations[:, _depth_first(clip.skeleton)], "ZYX"))
    rows = np.concatenate((clip.root_positions / unit, angles.reshape(clip.num_frames, -1)), axis=1)
    form = " ".join(["%.6f"] * rows.shape[1])
    head = ["MOTION", f"Frames: {clip.num_frames}", f"Frame Time: {1.0 / clip.fps:.9f}"]
    return head + [form % tuple(row) for row in rows.tolist()]
