"""Downloads of single files of an archive by range requests, from a server on this machine that can misbehave."""

from __future__ import annotations

import io
import socket
import stat
import threading
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pfnn_jax.motion.datasets import download as download_module
from pfnn_jax.motion.datasets.download import download_100style
from pfnn_jax.motion.datasets.sources import list_clips
from tests.raising import assert_refused

GAITS = ("BR", "BW", "FR", "FW", "ID", "SR", "SW", "TR1")
CUTS = f"STYLE_NAME,{','.join(f'{g}_START,{g}_STOP' for g in GAITS)}\nAngry{',10,90' * 8}\nOld{',10,90' * 8}\n"
SYMMETRY = "Style Name,Description,Stochastic,Symmetric,Notes\nAngry,,No,Yes,\nOld,,No,No,\n"
SIZE = 200_000  # bytes of a clip: more than remotezip reads at once for the directory
COUNTING = threading.Lock()  # several threads serve one site
MEMBERS = {
    "100STYLE/Frame_Cuts.csv": CUTS,
    "100STYLE/Dataset_List.csv": SYMMETRY,
    "100STYLE/Angry/Angry_FW.bvh": "1" * SIZE,
    "100STYLE/Angry/Angry_FR.bvh": "2" * SIZE,
    "100STYLE/Old/Old_FW.bvh": "3" * SIZE,
    "__MACOSX/100STYLE/._Frame_Cuts.csv": "resource fork",
}
TABLES = ["Dataset_List.csv", "Frame_Cuts.csv"]
ANGRY = ["Angry/Angry_FR.bvh", "Angry/Angry_FW.bvh"]


def pack(members: dict[str, str], *more: tuple[zipfile.ZipInfo, str], compression: int = zipfile.ZIP_STORED) -> bytes:
    """Returns a ZIP archive of these members, and of more whose entries are given."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as packed:
        for name, content in members.items():
            packed.writestr(name, content)
        for info, content in more:
            packed.writestr(info, content)
    return file.getvalue()


@dataclass
class Site:
    """What the server does; `statuses` and `breaks` are used up answer by answer.

    Attributes:
        content: the archive.
        ranges: whether range requests are supported.
        statuses: HTTP errors to answer with before all goes well.
        breaks: bytes after which the next long answers break off.
        sent: bytes of all bodies sent.
    """

    content: bytes = field(default_factory=lambda: pack(MEMBERS))
    ranges: bool = True
    statuses: list[int] = field(default_factory=list)
    breaks: list[int] = field(default_factory=list)
    sent: int = 0
    url: str = ""


class Handler(BaseHTTPRequestHandler):
    """Serves the archive, with ranges as `bytes=FIRST-LAST` and `bytes=-LENGTH`."""

    site: Site

    def do_GET(self) -> None:
        body, total, status = self.site.content, len(self.site.content), 200
        if self.site.statuses:
            body, status = b"", self.site.statuses.pop(0)
        elif self.site.ranges and "Range" in self.headers:
            first, last = self.headers["Range"].removeprefix("bytes=").rsplit("-", 1)
            start = int(first) if first else max(0, total - int(last))
            body, status = body[start : int(last) + 1 if first else total], 206 if 0 <= start < total else 416
        self.send_response(status)
        if status == 206:
            self.send_header("Content-Range", f"bytes {start}-{start + len(body) - 1}/{total}")
        self.send_header("Retry-After", "0")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.site.breaks and len(body) > SIZE // 2:
            body = body[: self.site.breaks.pop(0)]
            self.close_connection = True
        # Counted before each part is written: the client may be done before this thread runs again.
        for begin in range(0, len(body), 1 << 14):
            part = body[begin : begin + (1 << 14)]
            with COUNTING:
                self.site.sent += len(part)
            self.wfile.write(part)

    def log_message(self, format: str, *args: Any) -> None:
        """Prints nothing."""


@pytest.fixture
def serve(monkeypatch) -> Iterator[Callable[..., Site]]:
    """Starts a server of an archive, and returns its site."""
    monkeypatch.setenv("no_proxy", "*")
    monkeypatch.setattr(download_module, "RETRY", download_module.RETRY.new(backoff_factor=0.0))
    started = []

    def start(**behaviour: Any) -> Site:
        site = Site(**behaviour)
        server = ThreadingHTTPServer(("127.0.0.1", 0), type("Here", (Handler,), {"site": site}))
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        started.append((server, thread))
        site.url = f"http://127.0.0.1:{server.server_port}/100STYLE.zip"
        return site

    yield start
    for server, thread in started:
        server.shutdown()
        server.server_close()
        thread.join()


def files_in(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def test_a_whole_download_is_read_as_100style(serve, tmp_path):
    site, seen = serve(), []
    got = download_100style(tmp_path / "new" / "out", url=site.url, progress_callback=lambda *event: seen.append(event))
    assert (got.styles, got.clips, got.fetched) == (("Angry", "Old"), 3, 5)
    assert files_in(got.folder) == [*ANGRY, *TABLES, "Old/Old_FW.bvh"]
    assert (got.folder / "Old" / "Old_FW.bvh").read_text() == "3" * SIZE
    clips = list_clips(got.folder)
    assert [(clip.path.name, clip.symmetric, clip.start) for clip in clips] == [
        ("Angry_FR.bvh", True, 10),
        ("Angry_FW.bvh", True, 10),
        ("Old_FW.bvh", False, 10),
    ]
    total = 3 * SIZE + len(CUTS) + len(SYMMETRY)
    assert [done for done, _, _ in seen] == sorted({done for done, _, _ in seen})
    assert seen[-1][0] == total and {event[1] for event in seen} == {total}


def test_only_the_styles_asked_for_are_fetched(serve, tmp_path):
    site = serve()
    got = download_100style(tmp_path / "out", ["Old"], url=site.url)
    assert files_in(got.folder) == [*TABLES, "Old/Old_FW.bvh"] and got.styles == ("Old",)
    assert SIZE < site.sent < 2 * SIZE  # the archive has three clips of this size
    got = download_100style(tmp_path / "out", ("Angry",), url=site.url)  # added later, tables not fetched again
    assert (got.clips, got.fetched) == (2, 2) and files_in(got.folder) == [*ANGRY, *TABLES, "Old/Old_FW.bvh"]


def test_tables_and_clips_may_be_at_the_top_of_the_archive(serve, tmp_path):
    flat = {name.removeprefix("100STYLE/"): content for name, content in MEMBERS.items()}
    got = download_100style(tmp_path / "out", url=serve(content=pack(flat)).url)
    assert files_in(got.folder) == [*ANGRY, *TABLES, "Old/Old_FW.bvh"]


def test_compressed_members_are_unpacked(serve, tmp_path):
    content = pack(MEMBERS, compression=zipfile.ZIP_DEFLATED)
    got = download_100style(tmp_path / "out", url=serve(content=content).url)
    assert (got.folder / "Angry" / "Angry_FW.bvh").read_text() == "1" * SIZE


def test_a_complete_download_fetches_nothing_again(serve, tmp_path):
    site = serve()
    download_100style(tmp_path / "out", url=site.url)
    sent = site.sent
    assert download_100style(tmp_path / "out", url=site.url).fetched == 0
    assert site.sent - sent < SIZE  # the archive's directory only


def test_a_connection_that_breaks_is_opened_again(serve, tmp_path):
    site, seen = serve(breaks=[1000, 100_000]), []
    got = download_100style(tmp_path / "out", url=site.url, progress_callback=lambda *event: seen.append(event))
    assert got.fetched == 5 and seen[-1][0] == seen[-1][1]
    assert all(done <= total for done, total, _ in seen)


def test_an_interrupted_download_resumes_with_the_files_that_are_missing(serve, tmp_path):
    site, out = serve(), tmp_path / "out"

    def interrupt(done: int, total: int, name: str) -> None:
        if name == "Angry_FR.bvh":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        download_100style(out, url=site.url, progress_callback=interrupt)
    assert files_in(out) == ["Angry/Angry_FW.bvh", *TABLES]
    written = (out / "Angry" / "Angry_FW.bvh").stat().st_mtime_ns
    assert download_100style(out, url=site.url).fetched == 2
    assert files_in(out) == [*ANGRY, *TABLES, "Old/Old_FW.bvh"]
    assert (out / "Angry" / "Angry_FW.bvh").stat().st_mtime_ns == written


def test_a_partial_file_of_a_killed_download_is_replaced(serve, tmp_path):
    (tmp_path / "out" / "Old").mkdir(parents=True)
    (tmp_path / "out" / "Old" / ".Old_FW.bvh.part").write_text("333")
    got = download_100style(tmp_path / "out", ["Old"], url=serve().url)
    assert files_in(got.folder) == [*TABLES, "Old/Old_FW.bvh"]


def test_a_connection_that_keeps_breaking_keeps_what_is_complete(serve, tmp_path):
    site = serve(breaks=[SIZE + 1000, 10, 10, 10])
    call = partial(download_100style, tmp_path / "out", url=site.url)
    assert_refused(call, file=site.url, place="member Angry/Angry_FR.bvh", rule_mentions="run the download again")
    assert files_in(tmp_path / "out") == ["Angry/Angry_FW.bvh", *TABLES]
    assert call().fetched == 2


@pytest.mark.parametrize("status", [429, 503])
def test_a_busy_server_is_asked_again(serve, tmp_path, status):
    assert download_100style(tmp_path / "out", ["Old"], url=serve(statuses=[status, status]).url).fetched == 3


def test_an_unknown_style_is_refused_with_the_known_ones(serve, tmp_path):
    call = partial(download_100style, tmp_path / "out", ["Old", "Zombi"], url=serve().url)
    assert_refused(call, place="style", value="Zombi", rule_mentions="must be one of Angry, Old")
    assert not (tmp_path / "out").exists()


def test_a_server_without_ranges_is_refused(serve, tmp_path):
    site = serve(ranges=False)
    call = partial(download_100style, tmp_path / "out", url=site.url)
    assert_refused(call, file=site.url, place="server", value="no range requests", rule_mentions="by hand")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("status", [403, 404, 410])
def test_an_http_error_is_refused(serve, tmp_path, status):
    site = serve(statuses=[status])
    error = assert_refused(partial(download_100style, tmp_path / "out", url=site.url), place="connection")
    assert str(status) in str(error.value)


def test_being_offline_is_refused_at_once(tmp_path, monkeypatch):
    monkeypatch.setenv("no_proxy", "*")
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))  # bound and not listening: connections are refused
        url = f"http://127.0.0.1:{closed.getsockname()[1]}/100STYLE.zip"
        call = partial(download_100style, tmp_path / "out", url=url)
        assert_refused(call, file=url, place="connection", rule_mentions="must be reachable")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("url", ["file:///etc/passwd", "/etc/passwd", "ftp://example.org/a", ""])
def test_only_http_addresses_are_opened(tmp_path, url):
    assert_refused(partial(download_100style, tmp_path / "out", url=url), file=url, place="address")


def test_an_address_without_a_host_is_refused(tmp_path):
    assert_refused(partial(download_100style, tmp_path / "out", url="http://"), place="connection")


def entry(name: str, kind: int = stat.S_IFREG) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo("name")
    info.filename, info.external_attr = name, (kind | 0o644) << 16
    return info


@pytest.mark.parametrize(
    "name",
    [
        "../outside.txt",
        "100STYLE/../../outside.txt",
        "100STYLE/../Old/Old_BW.bvh",
        "/outside.txt",
        "//host/outside.txt",
        "C:/outside.txt",
        "..\\outside.txt",
        "\\outside.txt",
        "100STYLE/a\nb",
        "..",
    ],
)
def test_no_path_of_the_archive_leaves_the_folder(serve, tmp_path, name):
    (tmp_path / "here").mkdir()
    site = serve(content=pack(MEMBERS, (entry(name), "outside")))
    assert_refused(partial(download_100style, tmp_path / "here" / "out", url=site.url), value="unsafe path")
    assert files_in(tmp_path) == []


def test_links_are_written_as_plain_files(serve, tmp_path):
    content = pack(MEMBERS, (entry("100STYLE/link", stat.S_IFLNK), "/etc/passwd"))
    got = download_100style(tmp_path / "out", url=serve(content=content).url)
    assert not (got.folder / "link").is_symlink() and (got.folder / "link").read_text() == "/etc/passwd"


def test_no_more_is_written_than_the_directory_states(serve, tmp_path):
    content = pack({**MEMBERS, "100STYLE/zeros": "0" * 5000}, compression=zipfile.ZIP_DEFLATED)
    for stated in (4000, 6000):
        changed = content.replace((5000).to_bytes(4, "little"), stated.to_bytes(4, "little"))
        out = tmp_path / str(stated)
        assert_refused(partial(download_100style, out, url=serve(content=changed).url), place="member zeros")
        assert not (out / "zeros").exists()


def test_a_wrong_checksum_is_refused(serve, tmp_path):
    content = pack(MEMBERS).replace(b"3" * SIZE, b"4" * SIZE)
    error = assert_refused(
        partial(download_100style, tmp_path / "out", url=serve(content=content).url), place="member Old/Old_FW.bvh"
    )
    assert "CRC" in str(error.value) and files_in(tmp_path / "out") == [*ANGRY, *TABLES]


def test_encrypted_and_unknown_members_are_refused(serve, tmp_path):
    content = pack(MEMBERS)
    at = content.index(b"PK\1\2") + 8  # flags of the first entry of the directory, followed by its compression
    for changed in (b"\1\0" + content[at + 2 : at + 4], content[at : at + 2] + (97).to_bytes(2, "little")):
        site = serve(content=content[:at] + changed + content[at + 4 :])
        assert_refused(partial(download_100style, tmp_path / "out", url=site.url), place="member Frame_Cuts.csv")


@pytest.mark.parametrize("content", [b"no archive", b"PK\3\4" + bytes(50), pack(MEMBERS)[:-30]])
def test_what_is_not_an_archive_is_refused(serve, tmp_path, content):
    call = partial(download_100style, tmp_path / "out", url=serve(content=content).url)
    assert_refused(call, rule_mentions="archive")


def test_an_archive_of_something_else_is_refused(serve, tmp_path):
    site = serve(content=pack({"a/readme.txt": "hello"}))
    call = partial(download_100style, tmp_path / "out", url=site.url)
    assert_refused(call, place="archive", value="no Frame_Cuts.csv")


def test_files_with_other_content_are_replaced_only_when_asked(serve, tmp_path):
    site, file = serve(), tmp_path / "out" / "Frame_Cuts.csv"
    file.parent.mkdir()
    file.write_text("mine")
    (file.parent / "notes.txt").write_text("mine")
    call = partial(download_100style, file.parent, ["Old"], url=site.url)
    assert_refused(call, file=file, value="exists with other content", rule_mentions="overwrite=True")
    assert files_in(file.parent) == ["Frame_Cuts.csv", "notes.txt"]
    call(overwrite=True)
    assert file.read_text() == CUTS and (file.parent / "notes.txt").read_text() == "mine"


def test_a_full_disk_is_refused_before_anything_is_fetched(serve, tmp_path, monkeypatch):
    disk = SimpleNamespace(disk_usage=lambda folder: SimpleNamespace(free=1000))
    monkeypatch.setattr(download_module, "shutil", disk)
    call = partial(download_100style, tmp_path / "out", url=serve().url)
    assert_refused(call, file=tmp_path / "out", place="disk")
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_written_is_refused(serve, tmp_path):
    (tmp_path / "file").write_text("")
    call = partial(download_100style, tmp_path / "file" / "out", url=serve().url)
    assert_refused(call, rule_mentions="must be writable")


def test_the_command_downloads_the_styles_asked_for(serve, tmp_path, capsys):
    from pfnn_jax.cli import main

    site, out = serve(), tmp_path / "out"
    main(["download", "100style", "--styles", "Old,Angry", "--out", str(out), "--url", site.url])
    printed = capsys.readouterr().out
    assert str(out) in printed and "3 clips" in printed and "prepare" in printed
    with pytest.raises(SystemExit) as stopped:
        main(["download", "100style", "--styles", "Zombi", "--out", str(out), "--url", site.url])
    assert stopped.value.code == 2
    assert capsys.readouterr().err.strip().endswith("must be one of Angry, Old")
