"""Fetches a file of a Zenodo record: resumed where it broke off, of the published size and checksum or not at all.

The record says how large the file is and what its MD5 checksum is; it comes in by HTTP, with Range requests for what an
earlier try left out. Standard library only.
"""

from __future__ import annotations

import hashlib
import http.client
import json
import re
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from pfnn_jax.errors import InputError

Progress = Callable[[str, int, int], None]
"""Called with what is being done, the bytes done and the bytes in all."""

AGENT = "pfnn-jax"
"""Zenodo asks programs to name themselves, and slows down those that do not."""

TRANSIENT = {408, 425, 429, 500, 502, 503, 504}
"""HTTP errors after which trying again makes sense."""

BEYOND_THE_END = 416
BLOCK = 2**16
ENOUGH = 2**20  # bytes that make a try count as a success, however it ends
MAX_RECORD = 2**22  # bytes of JSON; a real record has some thousand
MAX_WAIT = 120.0  # seconds, whatever the server asks for

Result = TypeVar("Result")


@dataclass(frozen=True)
class PublishedFile:
    """A file as its record describes it.

    Attributes:
        url: where it is.
        size: bytes.
        md5: checksum, 32 hexadecimal digits.
    """

    url: str
    size: int
    md5: str


@dataclass(frozen=True)
class Patience:
    """How long to bear with a bad connection.

    Attributes:
        tries: tries in a row that bring less than a mebibyte, before giving up.
        pause: seconds before the second try; doubled for each further one.
        timeout: seconds of silence after which a connection counts as broken.
    """

    tries: int = 6
    pause: float = 1.0
    timeout: float = 30.0


class _Broken(Exception):
    """A try that failed and may be repeated, after `wait` seconds at least; `gained` are the bytes it brought."""

    def __init__(self, reason: object, wait: float = 0.0, gained: int = 0):
        super().__init__(reason)
        self.wait, self.gained = wait, gained


class _Unreachable(_Broken):
    """No server answered."""


def read_record(record_url: str, name: str, patience: Patience) -> PublishedFile:
    """What a Zenodo record says of one of its files.

    Args:
        record_url: address of the record, which answers with JSON as `https://zenodo.org/api/records/NUMBER` does.
        name: the file's name (`key`).
        patience: how often to try.

    Raises:
        InputError: if the server cannot be reached or answers with an error; if the record is malformed, does not list
            the file, or links to another server.
    """
    _check_url(record_url, record_url)

    def ask() -> bytes:
        try:
            response = _open(record_url, {"Accept": "application/json"}, patience.timeout)
        except _Unreachable as error:  # not worth a wait: nothing has begun
            rule = "the server must be reachable, this machine seems to be offline; nothing was fetched"
            raise InputError(record_url, "connection", error, rule) from error
        with response:
            data = _read(response, MAX_RECORD)
            if response.length:
                raise _Broken(f"broken off at {len(data)} bytes")
            return data

    raw = _persist(ask, record_url, "the record could not be read; try again later", patience)
    try:
        files = {str(file["key"]): file for file in json.loads(raw)["files"]}
        if name not in files:
            raise InputError(record_url, "files", ", ".join(files) or "none", f"{name} must be among them")
        size, checksum, url = files[name]["size"], str(files[name]["checksum"]), str(files[name]["links"]["self"])
    except (KeyError, TypeError, json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        rule = "must be a Zenodo record: JSON with a list of files, each with key, size, checksum and links"
        raise InputError(record_url, "record", _fault(error), rule) from None
    if type(size) is not int or size < 1:
        raise InputError(record_url, f"size of {name}", size, "must be a positive number of bytes")
    found = re.fullmatch(r"md5:([0-9a-f]{32})", checksum)
    if found is None:
        raise InputError(record_url, f"checksum of {name}", checksum, "must be md5: and 32 hexadecimal digits")
    _check_url(url, record_url)
    return PublishedFile(url, size, found[1])


def fetch(published: PublishedFile, part: Path, patience: Patience, progress: Progress | None = None) -> None:
    """Brings a file to its published size, from where an earlier try broke off.

    Args:
        published: the file.
        part: where it goes; what is there already is taken for its beginning.
        patience: how often to try.
        progress: see `Progress`.

    Raises:
        InputError: if the connection is lost for good (`part` is kept) or the server answers with an error; if the file
            has another size (`part` is removed); if `part` cannot be written.
    """
    rule = f"what has come is kept in {part}: run the command again to go on"
    with _writing(part):
        part.parent.mkdir(parents=True, exist_ok=True)
        if _size(part) > published.size:
            part.unlink()
    if _size(part) < published.size:
        _persist(lambda: _fetch_rest(published, part, patience.timeout, progress), published.url, rule, patience)


def verify(published: PublishedFile, part: Path, progress: Progress | None = None) -> None:
    """Compares a fetched file with its published checksum.

    Raises:
        InputError: if they differ; the file is removed.
    """
    digest, done = hashlib.md5(usedforsecurity=False), 0
    with _writing(part), part.open("rb") as file:
        while block := file.read(16 * BLOCK):
            digest.update(block)
            done += len(block)
            if progress is not None:
                progress("verifying", done, published.size)
    if digest.hexdigest() != published.md5:
        part.unlink()
        rule = f"must be {published.md5} as the record says; the file was removed, run the command again"
        raise InputError(published.url, "checksum", digest.hexdigest(), rule)


def _fetch_rest(published: PublishedFile, part: Path, timeout: float, progress: Progress | None) -> None:
    """One try: asks for what is missing and appends it, or begins anew where the server sends everything."""
    start = _size(part)
    headers = {"Range": f"bytes={start}-"} if start else {}
    with _open(published.url, headers, timeout) as response:
        first = done = _first_byte(response, start, published, part)
        with _writing(part), part.open("ab" if first else "wb") as file:
            while done <= published.size and (block := _read(response, BLOCK, done - start)):
                file.write(block)
                done += len(block)
                if progress is not None:
                    progress("downloading", done, published.size)
    if done > published.size:
        raise _wrong_size(published, part, f"more than {published.size}")
    if done < published.size:
        raise _Broken(f"broken off at {done} of {published.size} bytes", gained=done - start)


def _first_byte(response: Any, start: int, published: PublishedFile, part: Path) -> int:
    """Where in the file the answer begins; checks the size that the server states."""
    if response.status == BEYOND_THE_END:
        raise _wrong_size(published, part, f"at most {start}")
    first, size = 0, response.length
    if response.status == 206:
        found = re.fullmatch(r"bytes (\d+)-\d+/(\d+)", response.headers.get("Content-Range", ""))
        if found is None or int(found[1]) != start:
            part.unlink(missing_ok=True)
            raise _Broken("the server sent another part than asked")
        first, size = start, int(found[2])
    if size is not None and size != published.size:
        raise _wrong_size(published, part, size)
    return first


def _wrong_size(published: PublishedFile, part: Path, found: object) -> InputError:
    part.unlink(missing_ok=True)
    rule = f"must be {published.size} as the record says; what had come was removed"
    return InputError(published.url, "size", f"{found} bytes", rule)


def _persist(attempt: Callable[[], Result], url: str, rule: str, patience: Patience) -> Result:
    """Repeats an attempt until it gets through, with longer and longer pauses, or patience ends."""
    failures = 0
    while True:
        try:
            return attempt()
        except _Broken as error:
            failures = 1 if error.gained >= ENOUGH else failures + 1
            if failures >= patience.tries:
                raise InputError(url, "connection", error, rule) from error
            time.sleep(min(MAX_WAIT, max(error.wait, patience.pause * 2 ** (failures - 1))))


class _StayHere(urllib.request.HTTPRedirectHandler):
    """Follows redirections within a server only."""

    def redirect_request(self, req, fp, code, msg, headers, newurl):
        try:
            _check_url(newurl, req.full_url)
        except InputError:
            fp.close()
            raise
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _open(url: str, headers: dict[str, str], timeout: float) -> Any:
    """The server's answer, if it is a success, or tells that nothing is left to send."""
    request = urllib.request.Request(url, headers={"User-Agent": AGENT, **headers})
    try:
        return urllib.request.build_opener(_StayHere).open(request, timeout=timeout)
    except urllib.error.HTTPError as error:
        if error.code == BEYOND_THE_END:
            return error
        with error:
            if error.code in TRANSIENT:
                asked = error.headers.get("Retry-After", "")
                raise _Broken(f"{error.code} {error.reason}", float(asked) if asked.isdecimal() else 0.0) from error
            raise InputError(url, "answer", f"{error.code} {error.reason}", "the server must have the file") from error
    except (OSError, http.client.HTTPException) as error:
        raise _Unreachable(_fault(getattr(error, "reason", error))) from error


def _read(response: Any, size: int, gained: int = 0) -> bytes:
    try:
        return response.read(size)
    except (OSError, http.client.HTTPException) as error:
        raise _Broken(_fault(error), gained=gained) from error


def _check_url(url: str, record_url: str) -> None:
    """Refuses everything but http and https, and another server than the record's."""
    try:
        if not re.fullmatch(r"https?://[!-~]+", url):
            raise ValueError
        origins = [(part.scheme, part.hostname, part.port) for part in map(urlsplit, (url, record_url))]
    except ValueError:
        raise InputError(record_url, "address", ascii(url)[:200], "must be an http or https address") from None
    if origins[0] != origins[1]:
        raise InputError(record_url, "link", url, "must lead to the server of the record")


@contextmanager
def _writing(part: Path) -> Iterator[None]:
    """Errors of the disk as a message; those of the connection are no `OSError` any more where this is used."""
    try:
        yield
    except OSError as error:
        raise InputError(part, "file", error.strerror or error, "must be writable and the disk have room") from error


def _size(part: Path) -> int:
    return part.stat().st_size if part.exists() else 0


def _fault(error: object) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split()) if isinstance(error, Exception) else str(error)
