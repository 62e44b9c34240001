"""Unpacks a ZIP archive that nobody has looked into: no member leaves the folder, and none fills the disk.

The whole list of members is checked before the first is written. Standard library only.
"""

from __future__ import annotations

import shutil
import stat
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

from pfnn_jax.errors import InputError

MAX_BYTES = 32 * 2**30
"""Bytes of all members together: ten times the BVH files of 100STYLE, some 4 million frames of 700 bytes."""

MAX_RATIO = 50
"""Bytes of all members to one of the archive; motion as text shrinks to a half or a third."""

MAX_MEMBERS = 100_000

BLOCK = 2**20
ENCRYPTED = 0x1 | 0x40  # bits of a member's flags: encryption of the 1990s, and the strong one


class ArchiveError(InputError):
    """An archive that is refused or broken, in contrast to a disk that has no room for it."""


def unpack(archive: Path, folder: Path, progress: Callable[[int, int], None] | None = None) -> None:
    """Writes the members of an archive under a folder, each with the path it has in the archive.

    Apple's `__MACOSX` members are left out. Dates and permissions are not kept.

    Args:
        archive: ZIP file.
        folder: an existing empty folder. After an error it holds a part of the members: use one that can be thrown
            away.
        progress: called with (bytes written, bytes in all).

    Raises:
        ArchiveError: if it is no ZIP file; if a name is absolute, holds `..`, a drive letter, a backslash or a control
            character, or stands there twice; if a member is a link or device, encrypted, compressed otherwise than by
            deflate, or does not match its size and CRC; if the members are more, larger or more compressed than
            `MAX_MEMBERS`, `MAX_BYTES` and `MAX_RATIO` allow.
        InputError: if the disk has no room, or the folder cannot be written.
    """
    try:
        with zipfile.ZipFile(archive) as opened:
            members = _checked(archive, opened.infolist())
            total = sum(info.file_size for info in members)
            _need_room(folder, total)
            done = 0
            for info in members:
                done += _write_member(archive, opened, info, folder)
                if progress is not None:
                    progress(done, total)
    except (zipfile.BadZipFile, ValueError, NotImplementedError) as error:
        if isinstance(error, InputError):
            raise
        raise ArchiveError(archive, "archive", error, "must be a whole ZIP file") from error


def _checked(archive: Path, members: list[zipfile.ZipInfo]) -> list[zipfile.ZipInfo]:
    """The members to unpack, after the checks of `unpack` that need no reading."""
    members = [info for info in members if not info.orig_filename.startswith("__MACOSX/")]
    total = sum(info.file_size for info in members)
    if len(members) > MAX_MEMBERS:
        raise ArchiveError(archive, "archive", f"{len(members)} members", f"must be at most {MAX_MEMBERS}")
    most = min(MAX_BYTES, max(MAX_RATIO * archive.stat().st_size, BLOCK))
    if total > most:
        raise ArchiveError(archive, "archive", f"{total} bytes unpacked", f"must be at most {most} for its size")
    seen: set[str] = set()
    for info in members:
        value, rule = _fault(info)
        name = info.orig_filename.rstrip("/").casefold()  # some disks do not tell A from a
        if not value and name in seen:
            value, rule = "stands there twice", "names must differ, in more than capitals"
        if value:
            raise ArchiveError(archive, f"member {_shown(info)}", value, rule)
        seen.add(name)
    return members


def _fault(info: zipfile.ZipInfo) -> tuple[str, str]:
    """What is wrong with a member and the rule it breaks; two empty texts if nothing is."""
    name, rule = info.orig_filename, "members must stay inside the folder"
    if name.startswith(("/", "\\")):
        return "absolute path", rule
    if "\\" in name or ":" in name or not name.isprintable():
        return "backslash, colon or control character", rule
    parts = name.removesuffix("/").split("/")
    if any(part in ("", ".", "..") for part in parts):
        return "a part of the path is empty, . or ..", rule
    kind = stat.S_IFMT(info.external_attr >> 16)
    if kind not in (0, stat.S_IFDIR if info.is_dir() else stat.S_IFREG):
        return "link" if kind == stat.S_IFLNK else "special file", "members must be files and folders"
    if info.flag_bits & ENCRYPTED:
        return "encrypted", "members must be readable without a password"
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        return f"compression method {info.compress_type}", "must be stored or deflated"
    return "", ""


def _write_member(archive: Path, opened: zipfile.ZipFile, info: zipfile.ZipInfo, folder: Path) -> int:
    """Unpacks one checked member; returns its bytes."""
    target = folder.joinpath(*info.orig_filename.removesuffix("/").split("/"))
    written = 0
    try:
        if info.is_dir():
            target.mkdir(parents=True, exist_ok=True)
            return 0
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("xb") as file:
            for block in _blocks(archive, opened, info):
                written += file.write(block)
    except (FileExistsError, NotADirectoryError):
        value, rule = "file and folder of one name", "every member needs a place of its own"
        raise ArchiveError(archive, f"member {_shown(info)}", value, rule) from None
    except OSError as error:
        raise InputError(target, "output", error.strerror or error, "must be writable and the disk have room") from None
    if written != info.file_size:
        rule = f"must be {info.file_size} as its entry says"
        raise ArchiveError(archive, f"member {_shown(info)}", f"{written} bytes", rule)
    return written


def _blocks(archive: Path, opened: zipfile.ZipFile, info: zipfile.ZipInfo) -> Iterator[bytes]:
    """A member piece by piece; whatever is wrong in reading is the archive's fault."""
    try:
        with opened.open(info) as source:
            while block := source.read(BLOCK):
                yield block
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, OSError) as error:
        raise ArchiveError(
            archive, f"member {_shown(info)}", error, "must be whole, with the CRC of its entry"
        ) from error


def _need_room(folder: Path, size: int) -> None:
    free = shutil.disk_usage(folder).free
    if free < size:
        raise InputError(folder, "disk", f"{free} bytes free", f"unpacking needs {size}")


def _shown(info: zipfile.ZipInfo) -> str:
    name = ascii(info.orig_filename)
    return name if len(name) <= 80 else f"{name[:77]}..."
