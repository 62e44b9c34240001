"""Downloads published motion capture, file by file, out of the archive in which it is published.

100STYLE (Mason, Starke and Komura 2022, CC BY 4.0) is one ZIP archive at Zenodo, doi:10.5281/zenodo.8127870.
`remotezip` reads the archive's directory and then, by HTTP range requests, only the files that are wanted.
"""

from __future__ import annotations

import os
import shutil
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import requests
import urllib3
from remotezip import RangeNotSupported, RemoteZip, RemoteZipError
from requests.adapters import HTTPAdapter

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import failure
from pfnn_jax.motion.datasets.style100 import CUTS, STYLE_GAIT

ARCHIVE_URL = "https://zenodo.org/api/records/8127870/files/100STYLE.zip/content"

AGENT = "pfnn-jax"
"""Zenodo asks programs to identify themselves and slows down those that do not."""

RETRY = urllib3.Retry(
    8,
    connect=1,  # an unreachable server is reported at once
    status_forcelist=(408, 425, 429, 500, 502, 503, 504),  # Zenodo: 429 and a waiting time after 60 requests a minute
    backoff_factor=1.0,
)
"""How often one request is sent."""

ATTEMPTS = 3
"""Connections that may break one after another while the same file is fetched."""

TIMEOUT = 60.0
"""Seconds of silence after which a connection counts as broken."""

BLOCK = 2**20

BROKEN = (urllib3.exceptions.HTTPError, RemoteZipError, zipfile.BadZipFile, zlib.error, EOFError)
"""What reading a file of the archive raises if the connection breaks or its content does not match its checksum."""

Progress = Callable[[int, int, str], None]
"""Called with (bytes done, bytes in total, name of the file); bytes are those of the files on disk."""


@dataclass(frozen=True)
class Downloaded:
    """A completed download.

    Attributes:
        folder: the folder, which `list_clips` reads.
        styles: the styles asked for, in alphabetical order.
        clips: number of their BVH files.
        fetched: number of files fetched; the others were complete already.
    """

    folder: Path
    styles: tuple[str, ...]
    clips: int
    fetched: int


def download_100style(
    out: str | Path,
    styles: Collection[str] | None = None,
    *,
    url: str = ARCHIVE_URL,
    overwrite: bool = False,
    progress_callback: Progress | None = None,
) -> Downloaded:
    """Downloads 100STYLE, or some of its styles.

    Files that `out` already holds, of the right size and checksum, are not fetched again: an interrupted download
    continues where it ended, and styles can be added later. Every file appears complete or not at all.

    Args:
        out: folder for the tables and one folder per style.
        styles: names of the styles to download, such as `("Old", "Zombie")`; None for all of them.
        url: address of the archive, for copies elsewhere. The server must support range requests.
        overwrite: whether to replace files that exist with other content.
        progress_callback: called while files are fetched.

    Raises:
        InputError: for an unknown style; if the server cannot be reached, does not support range requests or breaks
            off; if the archive is not that of 100STYLE, is damaged, or holds paths that lead out of the folder; if a
            file exists with other content; if the disk is full or the folder cannot be written.
    """
    out = Path(out)
    complete: set[str] = set()
    fetched, failures = 0, 0
    while True:  # a connection that breaks leaves the archive unreadable: open it again
        with _opened(url) as archive:
            chosen = _choose(_members(archive, url), styles, url)
            complete |= {name for name in chosen.keys() - complete if _is_complete(out / name, chosen[name], overwrite)}
            missing = {name: info for name, info in chosen.items() if name not in complete}
            _check_space(out, sum(info.file_size for info in missing.values()))
            report = _Report(progress_callback, chosen, complete)
            name = ""
            try:
                for name, info in missing.items():
                    _fetch(archive, info, out / name, report)
                    complete.add(name)
                    fetched, failures = fetched + 1, 0
                break
            except RuntimeError as error:  # zipfile's error for passwords and unknown compression
                rule = "must be stored or deflated, without a password"
                raise InputError(url, f"member {name}", error, rule) from error
            except BROKEN as error:
                failures += 1
                if failures == ATTEMPTS:
                    rule = "must arrive complete; run the download again to continue it"
                    raise InputError(url, f"member {name}", failure(error), rule) from error
    clips = [style for name in chosen if (style := _style_of(name)) is not None]
    return Downloaded(out, tuple(sorted(set(clips))), len(clips), fetched)


@contextmanager
def _opened(url: str) -> Iterator[RemoteZip]:
    """Opens the archive and reads its directory.

    Raises:
        InputError: if that fails.
    """
    if not url.startswith(("http://", "https://")):
        raise InputError(url, "address", "not an HTTP address", "must begin with http:// or https://")
    with ExitStack() as opened:
        session = opened.enter_context(requests.Session())

        def close_in_the_end(response: requests.Response, **_) -> None:
            opened.callback(response.close)

        session.hooks["response"].append(close_in_the_end)  # remotezip leaves the responses of failed requests open
        session.headers["User-Agent"] = AGENT
        session.mount("http://", HTTPAdapter(max_retries=RETRY))
        session.mount("https://", HTTPAdapter(max_retries=RETRY))
        try:
            archive = RemoteZip(url, session=session, timeout=TIMEOUT)
        except RangeNotSupported:
            rule = "must support range requests; otherwise download the archive by hand and unpack it"
            raise InputError(url, "server", "no range requests", rule) from None
        except zipfile.BadZipFile as error:
            raise InputError(url, "archive", error, "must be a complete ZIP archive") from error
        except (*BROKEN, requests.RequestException, ValueError) as error:
            rule = "the server must be reachable and have the archive; run the download again to continue it"
            raise InputError(url, "connection", failure(error), rule) from error
        yield opened.enter_context(archive)


def _members(archive: RemoteZip, url: str) -> dict[str, zipfile.ZipInfo]:
    """Returns the files of the archive by their path relative to the folder of its tables.

    Raises:
        InputError: if it holds no `Frame_Cuts.csv`, or a path that leads out of the folder.
    """
    # zipfile's own `filename` is already cleaned: it hides what follows a null character
    paths = [(PurePosixPath(info.orig_filename), info) for info in archive.infolist() if not info.is_dir()]
    tables = [path for path, _ in paths if path.name == CUTS]
    if not tables:
        raise InputError(url, "archive", f"no {CUTS}", "must be the archive of 100STYLE")
    root = min(tables, key=lambda path: len(path.parts)).parent
    for path, _ in paths:
        name = str(path)
        if path.is_absolute() or ".." in path.parts or "\\" in name or ":" in name or not name.isprintable():
            raise InputError(url, f"member {name[:80]!a}", "unsafe path", "must be relative and stay in its folder")
    inside = ((path, info) for path, info in paths if path.is_relative_to(root) and path.parts[0] != "__MACOSX")
    return {str(path.relative_to(root)): info for path, info in inside}


def _style_of(name: str) -> str | None:
    """Returns the style of a BVH file of 100STYLE, or None for another file."""
    path = PurePosixPath(name)
    found = STYLE_GAIT.fullmatch(path.stem) if path.suffix.lower() == ".bvh" else None
    return None if found is None else found[1]


def _choose(
    members: dict[str, zipfile.ZipInfo], styles: Collection[str] | None, url: str
) -> dict[str, zipfile.ZipInfo]:
    """Returns the clips of the styles, and the tables.

    Raises:
        InputError: for a style that the archive does not have.
    """
    style_of = {name: _style_of(name) for name in members}
    known = sorted({style for style in style_of.values() if style is not None})
    wanted = set(known if styles is None else styles)
    for style in sorted(wanted.difference(known)):
        raise InputError(url, "style", style, f"must be one of {', '.join(known)}")
    return {name: info for name, info in members.items() if style_of[name] in {*wanted, None}}


def _is_complete(path: Path, info: zipfile.ZipInfo, overwrite: bool) -> bool:
    """Returns whether a file has the size and checksum that the archive's directory states.

    Raises:
        InputError: if it exists with other content and must not be replaced.
    """
    try:
        if not path.exists():
            return False
        if path.stat().st_size == info.file_size and _crc(path) == info.CRC:
            return True
    except OSError as error:
        raise InputError(path, "file", failure(error), "must be readable") from error
    if not overwrite:
        raise InputError(path, "file", "exists with other content", "pass overwrite=True to replace it")
    return False


def _crc(path: Path) -> int:
    crc = 0
    with path.open("rb") as file:
        while block := file.read(BLOCK):
            crc = zlib.crc32(block, crc)
    return crc


def _check_space(out: Path, size: int) -> None:
    place = next(folder for folder in (out.absolute(), *out.absolute().parents) if folder.exists())
    free = shutil.disk_usage(place).free
    if free < size:
        raise InputError(out, "disk", f"{free / 1e6:.0f} MB free", f"must have {size / 1e6:.0f} MB for the download")


class _Report:
    """Adds up bytes for a progress callback."""

    def __init__(self, callback: Progress | None, chosen: dict[str, zipfile.ZipInfo], complete: set[str]):
        self._callback = callback
        self._total = sum(info.file_size for info in chosen.values())
        self._done = sum(info.file_size for name, info in chosen.items() if name in complete)

    def add(self, size: int, name: str) -> None:
        self._done += size
        if self._callback is not None:
            self._callback(self._done, self._total, name)


def _fetch(archive: RemoteZip, info: zipfile.ZipInfo, target: Path, report: _Report) -> None:
    """Fetches one file; `zipfile` checks its checksum, and reads no more than the size in the archive's directory.

    Raises:
        BROKEN: if it does not arrive complete.
        RuntimeError: if it is encrypted or compressed in an unknown way.
        InputError: if it cannot be written.
    """
    part = target.with_name(f".{target.name}.part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with archive.open(info) as source, part.open("wb") as file:
            while block := source.read(BLOCK):
                file.write(block)
                report.add(len(block), target.name)
        if part.stat().st_size != info.file_size:
            raise EOFError(f"{part.stat().st_size} of {info.file_size} bytes")
        os.replace(part, target)
    except OSError as error:
        raise InputError(target, "file", failure(error), "must be writable, with space for the download") from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
