"""Downloads from a server on this machine that breaks off, lies, and packs what should not be unpacked."""

from __future__ import annotations

import hashlib
import io
import json
import socket
import stat
import subprocess
import sys
import threading
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.motion.datasets import archive as archive_module
from pfnn_jax.motion.datasets.download import download_100style
from pfnn_jax.motion.datasets.fetch import Patience
from pfnn_jax.motion.datasets.sources import list_clips

QUICK = Patience(tries=3, pause=0.0, timeout=10.0)
GAITS = ("BR", "BW", "FR", "FW", "ID", "SR", "SW", "TR1")
CUTS = f"STYLE_NAME,{','.join(f'{g}_START,{g}_STOP' for g in GAITS)}\nAngry{',10,90' * 8}\nOld{',10,90' * 8}\n"
STYLES = "Style Name,Description,Stochastic,Symmetric,Notes\nAngry,,No,Yes,\nOld,,No,No,\n"
MEMBERS = {
    "100STYLE/Frame_Cuts.csv": CUTS,
    "100STYLE/Dataset_List.csv": STYLES,
    "100STYLE/Angry/Angry_FW.bvh": "HIERARCHY\n" * 3,
    "100STYLE/Angry/Angry_FR.bvh": "HIERARCHY\n" * 4,
    "100STYLE/Old/Old_FW.bvh": "HIERARCHY\n" * 5,
    "__MACOSX/100STYLE/._Frame_Cuts.csv": "resource fork",
}


def pack(members: dict[str, str], *more: tuple[zipfile.ZipInfo, str], compression: int = zipfile.ZIP_STORED) -> bytes:
    """A ZIP archive of these members, and of some whose entries are given."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as packed:
        for name, content in members.items():
            packed.writestr(name, content)
        for info, content in more:
            packed.writestr(info, content)
    return file.getvalue()


@dataclass
class Site:
    """What the server does; each list is used up answer by answer, then everything goes well."""

    content: bytes
    record: Any = None
    ranges: bool = True
    lengths: bool = True
    statuses: list[int] = field(default_factory=list)
    breaks: list[int] = field(default_factory=list)
    asked: list[str | None] = field(default_factory=list)
    url: str = ""

    def __post_init__(self) -> None:
        self.said = {"size": len(self.content), "checksum": f"md5:{hashlib.md5(self.content).hexdigest()}"}

    def answer(self) -> bytes:
        if self.record is not None:
            return self.record if isinstance(self.record, bytes) else json.dumps(self.record).encode()
        file = {"key": "100STYLE.zip", **self.said, "links": {"self": f"{self.url}/100STYLE.zip/content"}}
        other = {"key": "100Style-Labelled-Data.zip", "size": 1, "checksum": "md5:0", "links": {"self": ""}}
        return json.dumps({"id": 8127870, "files": [other, file]}).encode()

    @property
    def record_url(self) -> str:
        return f"{self.url}/api/records/8127870"


class Handler(BaseHTTPRequestHandler):
    """Answers with the record, the archive or an error, as the site wants."""

    site: Site

    def do_GET(self) -> None:
        if self.path.startswith("/api"):
            self._send(200, self.site.answer(), {})
            return
        self.site.asked.append(self.headers["Range"])
        if self.site.statuses:
            status = self.site.statuses.pop(0)
            self._send(status, b"", {"Retry-After": "0", "Location": "http://elsewhere.invalid/100STYLE.zip"})
            return
        body, start = self.site.content, 0
        if self.site.ranges and self.headers["Range"]:
            start = int(self.headers["Range"].removeprefix("bytes=").removesuffix("-"))
        headers = {"Content-Range": f"bytes {start}-{len(body) - 1}/{len(body)}"} if start else {}
        self._send(206 if start else 200, body[start:], headers)

    def _send(self, status: int, body: bytes, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        if self.site.lengths:
            self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        kept = self.site.breaks.pop(0) if self.site.breaks and status in (200, 206) and body[:1] != b"{" else len(body)
        self.wfile.write(body[:kept])

    def log_message(self, format: str, *args: Any) -> None:
        """Keeps quiet."""


@pytest.fixture
def serve(monkeypatch) -> Iterator[Any]:
    """Starts a server of an archive; returns its site."""
    monkeypatch.setenv("no_proxy", "*")
    started = []

    def start(content: bytes | None = None, **behaviour: Any) -> Site:
        site = Site(pack(MEMBERS) if content is None else content, **behaviour)
        server = ThreadingHTTPServer(("127.0.0.1", 0), type("Here", (Handler,), {"site": site}))
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        started.append((server, thread))
        site.url = f"http://127.0.0.1:{server.server_port}"
        return site

    yield start
    for server, thread in started:
        server.shutdown()
        server.server_close()
        thread.join()


def get(site: Site, out: Path, **options: Any):
    return download_100style(out, record_url=site.record_url, patience=QUICK, **options)


def refused(site: Site, out: Path, *words: str, left: tuple[str, ...] = ()) -> str:
    """The download is refused with a message that has these words; beside `out` only `left` remains."""
    with pytest.raises(InputError) as caught:
        get(site, out)
    message = str(caught.value)
    assert "\n" not in message
    assert not [word for word in words if word not in message], message
    assert {path.name for path in out.parent.iterdir()} == set(left)
    return message


def test_what_arrives_is_read_as_100style(serve, tmp_path):
    site, seen = serve(), []
    got = get(site, tmp_path / "new" / "styles", progress=lambda *now: seen.append(now))
    clips = list_clips(got.folder, "100style")
    assert got.folder == tmp_path / "new" / "styles" / "100STYLE"
    assert [(clip.path.name, clip.symmetric, clip.start) for clip in clips] == [
        ("Angry_FR.bvh", True, 10),
        ("Angry_FW.bvh", True, 10),
        ("Old_FW.bvh", False, 10),
    ]
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["styles"]
    assert sorted(path.name for path in (tmp_path / "new" / "styles").iterdir()) == ["100STYLE", "download.json"]
    assert json.loads((tmp_path / "new" / "styles" / "download.json").read_text())["md5"] == got.published.md5
    assert got.published.size == len(site.content)
    assert list(dict.fromkeys(stage for stage, _, _ in seen)) == ["downloading", "verifying", "unpacking"]
    assert all(done <= total for _, done, total in seen)
    assert {seen[-1][1:]} == {(done, total) for stage, done, total in seen if stage == "unpacking" and done == total}


def test_tables_and_takes_may_lie_in_the_archive_itself(serve, tmp_path):
    flat = {name.removeprefix("100STYLE/"): content for name, content in MEMBERS.items()}
    got = get(serve(pack(flat)), tmp_path / "styles")
    assert got.folder == tmp_path / "styles"
    assert len(list_clips(got.folder, "100style")) == 3


@pytest.mark.parametrize("lengths", [True, False], ids=["length stated", "length unknown"])
def test_a_broken_connection_is_resumed_where_it_broke_off(serve, tmp_path, lengths):
    site = serve(breaks=[100, 150], lengths=lengths)
    assert get(site, tmp_path / "styles").folder.is_dir()
    assert site.asked == [None, "bytes=100-", "bytes=250-"]


def test_a_connection_lost_for_good_leaves_the_part_and_the_next_run_goes_on(serve, tmp_path):
    site = serve(breaks=[100, 0, 0])
    refused(site, tmp_path / "styles", "broken off at 100 of", "styles.zip.part", "again", left=("styles.zip.part",))
    assert (tmp_path / "styles.zip.part").read_bytes() == site.content[:100]
    get(site, tmp_path / "styles")
    assert site.asked[-1] == "bytes=100-"
    assert [path.name for path in tmp_path.iterdir()] == ["styles"]


def test_a_whole_part_is_not_fetched_again(serve, tmp_path):
    site = serve()
    (tmp_path / "styles.zip.part").write_bytes(site.content)
    get(site, tmp_path / "styles")
    assert site.asked == []


def test_a_server_without_ranges_sends_everything_again(serve, tmp_path):
    site = serve(ranges=False, breaks=[100])
    assert len(list_clips(get(site, tmp_path / "styles").folder, "100style")) == 3
    assert site.asked == [None, "bytes=100-"]


@pytest.mark.parametrize("status", [429, 503])
def test_a_busy_server_is_asked_again(serve, tmp_path, status):
    site = serve(statuses=[status, status])
    assert get(site, tmp_path / "styles").folder.is_dir()
    assert len(site.asked) == 3


def test_pauses_grow_and_heed_the_server(serve, tmp_path, monkeypatch):
    slept: list[float] = []
    monkeypatch.setattr("pfnn_jax.motion.datasets.fetch.time", SimpleNamespace(sleep=slept.append))
    site = serve(statuses=[503] * 3)
    patience = Patience(tries=4, pause=0.5, timeout=10.0)
    download_100style(tmp_path / "styles", record_url=site.record_url, patience=patience)
    assert slept == [0.5, 1.0, 2.0]


def test_tries_that_bring_much_do_not_count(serve, tmp_path):
    size = 5 * 2**20
    site = serve(pack({**MEMBERS, "100STYLE/noise.bin": "0" * size}), breaks=[2**20 + 7] * 4)
    assert get(site, tmp_path / "styles").folder.is_dir()
    assert len(site.asked) == 5 > QUICK.tries


@pytest.mark.parametrize("status", [404, 403, 410])
def test_an_answer_that_will_not_change_is_told_at_once(serve, tmp_path, status):
    site = serve(statuses=[status])
    refused(site, tmp_path / "styles", "100STYLE.zip/content", str(status))
    assert len(site.asked) == 1


def test_a_record_that_is_not_there_is_told(serve, tmp_path):
    site = serve(statuses=[404])
    with pytest.raises(InputError, match="nothing: answer: 404"):
        download_100style(tmp_path / "styles", record_url=f"{site.url}/nothing", patience=QUICK)


def test_redirections_stay_on_the_server(serve, tmp_path):
    refused(serve(statuses=[302]), tmp_path / "styles", "elsewhere.invalid", "server of the record")


def test_a_wrong_checksum_removes_the_file(serve, tmp_path):
    site = serve()
    site.said["checksum"] = "md5:" + "0" * 32
    refused(site, tmp_path / "styles", "checksum", hashlib.md5(site.content).hexdigest(), "0" * 32, "removed")


def test_a_part_of_another_file_is_found_out(serve, tmp_path):
    (tmp_path / "styles.zip.part").write_bytes(b"another")
    refused(serve(), tmp_path / "styles", "checksum", "removed")


def test_a_part_longer_than_the_file_is_begun_anew(serve, tmp_path):
    site = serve()
    (tmp_path / "styles.zip.part").write_bytes(bytes(len(site.content) + 1))
    assert get(site, tmp_path / "styles").folder.is_dir()
    assert site.asked == [None]


@pytest.mark.parametrize("more", [1, -1])
@pytest.mark.parametrize("lengths", [True, False], ids=["length stated", "length unknown"])
def test_a_wrong_size_is_told(serve, tmp_path, more, lengths):
    site = serve(lengths=lengths)
    site.said["size"] += more
    refused(site, tmp_path / "styles", "size", f"must be {site.said['size']}")


def test_a_server_with_nothing_left_to_send_has_another_size(serve, tmp_path):
    site = serve(statuses=[416])
    (tmp_path / "styles.zip.part").write_bytes(site.content[:10])
    refused(site, tmp_path / "styles", "size", "at most 10 bytes")


def test_a_resumed_file_of_another_size_is_told(serve, tmp_path):
    site = serve()
    site.said["size"] += 1
    (tmp_path / "styles.zip.part").write_bytes(site.content[:10])
    refused(site, tmp_path / "styles", "size", f"{len(site.content)} bytes", f"must be {len(site.content) + 1}")


def test_offline_is_one_clear_line_without_a_wait(tmp_path):
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))  # bound and not listening: connections are refused
        url = f"http://127.0.0.1:{closed.getsockname()[1]}/api/records/8127870"
        with pytest.raises(InputError, match=f"{url}: connection: .*offline") as caught:
            download_100style(tmp_path / "styles", record_url=url, patience=Patience(pause=60.0))
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


MD5 = "md5:" + "0" * 32


def listed(**entries: Any) -> dict:
    file = {"key": "100STYLE.zip", "size": 5, "checksum": MD5, "links": {"self": "http://127.0.0.1/a"}, **entries}
    return {"files": [{name: value for name, value in file.items() if value is not None}]}


@pytest.mark.parametrize(
    ("record", "word"),
    [
        (b"", "JSON"),
        (b"{", "JSON"),
        (b"<html>", "JSON"),
        (b"{\xff}", "JSON"),
        (b"[" * 200_000, "JSON"),
        ([], "files"),
        ({}, "files"),
        ({"files": {}}, "none"),
        ({"files": [1]}, "files"),
        ({"files": [{}]}, "key"),
        ({"files": [{"key": "other.zip"}]}, "other.zip"),
        (listed(size=None), "size"),
        (listed(size="5"), "size"),
        (listed(size=True), "size"),
        (listed(size=0), "size"),
        (listed(checksum=None), "checksum"),
        (listed(checksum="md5:abc"), "checksum"),
        (listed(checksum="crc32:" + "0" * 32), "checksum"),
        (listed(links=None), "links"),
        (listed(links={"self": 3}), "http"),
        (listed(links={"self": "file:///etc/passwd"}), "http"),
        (listed(links={"self": "ftp://127.0.0.1/a"}), "http"),
        (listed(links={"self": "http://127.0.0.1:bad/a"}), "http"),
        (listed(links={"self": "http://127.0.0.1/a b\r\nX: y"}), "http"),
        (listed(links={"self": "http://elsewhere.invalid/a"}), "server of the record"),
    ],
)
def test_a_malformed_record_is_told(serve, tmp_path, record, word):
    refused(serve(record=record), tmp_path / "styles", "/api/records/8127870", word)


@pytest.mark.parametrize("url", ["file:///etc/passwd", "/etc/passwd", "ftp://example.org/a", "http://", ""])
def test_only_http_addresses_are_opened(tmp_path, url):
    with pytest.raises(InputError, match="http"):
        download_100style(tmp_path / "styles", record_url=url)


def entry(name: str, kind: int = stat.S_IFREG) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo("name")
    info.filename, info.external_attr = name, (kind | 0o644) << 16
    return info


@pytest.mark.parametrize(
    "name",
    [
        "../outside.txt",
        "100STYLE/../../outside.txt",
        "/outside.txt",
        "//host/outside.txt",
        "C:/outside.txt",
        "C:outside.txt",
        "..\\outside.txt",
        "\\outside.txt",
        "100STYLE/./a",
        "100STYLE//a",
        "100STYLE/a\nb",
        ".",
        "..",
        "/",
    ],
)
def test_no_name_of_the_archive_leaves_the_folder(serve, tmp_path, name):
    (tmp_path / "here").mkdir()
    site = serve(pack(MEMBERS, (entry(name), "outside")))
    refused(site, tmp_path / "here" / "styles", "member")
    assert [path.name for path in tmp_path.iterdir()] == ["here"]


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR, stat.S_IFDIR])
def test_links_and_devices_are_refused(serve, tmp_path, kind):
    content = pack(MEMBERS, (entry("100STYLE/link", kind), "/etc/passwd"), (entry("100STYLE/link/a"), "through it"))
    refused(serve(content), tmp_path / "styles", "100STYLE/link", "link" if kind == stat.S_IFLNK else "special file")


@pytest.mark.parametrize("other", ["100STYLE/frame_cuts.CSV", "100STYLE/Frame_Cuts.csv/inside", "100STYLE/Angry"])
def test_every_member_needs_its_own_place(serve, tmp_path, other):
    refused(serve(pack(MEMBERS, (entry(other), "again"))), tmp_path / "styles", "member")


@pytest.mark.parametrize("limit", ["ratio", "size", "number"])
def test_bombs_are_refused_before_anything_is_written(serve, tmp_path, monkeypatch, limit):
    content = pack({**MEMBERS, "100STYLE/zeros": "0" * 2**22}, compression=zipfile.ZIP_DEFLATED)
    if limit != "ratio":
        name, value = {"size": ("MAX_BYTES", 2**21), "number": ("MAX_MEMBERS", 3)}[limit]
        monkeypatch.setattr(archive_module, "MAX_RATIO", 10**6)
        monkeypatch.setattr(archive_module, name, value)
    monkeypatch.setattr(archive_module, "_write_member", None)
    refused(serve(content), tmp_path / "styles", "archive", "at most")


def test_a_size_that_lies_is_found_out(serve, tmp_path):
    content = pack({**MEMBERS, "100STYLE/zeros": "0" * 5000}, compression=zipfile.ZIP_DEFLATED)
    for lie in (4000, 6000):
        changed = content.replace((5000).to_bytes(4, "little"), lie.to_bytes(4, "little"))
        refused(serve(changed), tmp_path / "styles", "100STYLE/zeros")


def test_damaged_and_encrypted_members_are_refused(serve, tmp_path):
    content = pack(MEMBERS)
    refused(serve(content.replace(CUTS.encode(), CUTS.upper().encode())), tmp_path / "styles", "Frame_Cuts", "CRC")
    at = content.index(b"PK\1\2") + 8  # flags of the first entry of the list of members
    refused(serve(content[:at] + b"\1\0" + content[at + 2 :]), tmp_path / "styles", "Frame_Cuts", "encrypted")
    method = content[: at + 2] + (12).to_bytes(2, "little") + content[at + 4 :]
    refused(serve(method), tmp_path / "styles", "Frame_Cuts", "compression method 12")


@pytest.mark.parametrize("content", [b"no archive", b"PK\3\4" + bytes(50), pack(MEMBERS)[:-30]])
def test_what_is_no_archive_is_refused(serve, tmp_path, content):
    refused(serve(content), tmp_path / "styles", "archive", "ZIP")


@pytest.mark.parametrize("seed", range(40))
def test_damage_anywhere_is_one_line_and_stays_in_the_folder(tmp_path, seed):
    content = bytearray(pack(MEMBERS, compression=zipfile.ZIP_DEFLATED))
    for place in range(seed, len(content), 211):
        content[place] ^= 0x55
    out, file = tmp_path / "styles", tmp_path / "a.zip"
    out.mkdir()
    file.write_bytes(bytes(content))
    try:
        archive_module.unpack(file, out)
    except InputError as error:
        assert "\n" not in str(error)
    assert {path.name for path in tmp_path.iterdir()} == {"a.zip", "styles"}


def test_an_archive_of_something_else_is_refused(serve, tmp_path):
    refused(serve(pack({"a/readme.txt": "hello"})), tmp_path / "styles", "Frame_Cuts.csv", "absent")


def test_without_room_the_archive_waits(serve, tmp_path, monkeypatch):
    site = serve()
    monkeypatch.setattr(archive_module, "shutil", SimpleNamespace(disk_usage=lambda folder: SimpleNamespace(free=0)))
    refused(site, tmp_path / "styles", "0 bytes free", "styles.zip.part", left=("styles.zip.part",))
    monkeypatch.undo()
    monkeypatch.setenv("no_proxy", "*")
    get(site, tmp_path / "styles")
    assert len(site.asked) == 1


def test_existing_folders_are_replaced_only_when_asked_and_only_downloads(serve, tmp_path):
    site, out = serve(), tmp_path / "styles"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    refused(site, out, "exists", left=("styles",))
    (out / "Frame_Cuts.csv").write_text(CUTS)
    with pytest.raises(InputError, match="is no download"):
        get(site, out, overwrite=True)
    (out / "download.json").write_text("{}")
    assert site.asked == []
    assert get(site, out, overwrite=True).folder == out / "100STYLE"
    assert not (out / "mine.txt").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["styles"]


def test_a_failed_replacement_leaves_the_old_folder(serve, tmp_path):
    out = get(serve(), tmp_path / "styles").folder
    bad = serve(pack(MEMBERS, (entry("../outside"), "")))
    with pytest.raises(InputError, match="outside"):
        get(bad, tmp_path / "styles", overwrite=True)
    assert len(list_clips(out, "100style")) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["styles"]


def test_a_folder_that_cannot_be_written_is_one_line(serve, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="writable"):
        get(serve(), tmp_path / "file" / "styles")


def test_the_command_tells_where_the_takes_are(serve, tmp_path, capsys):
    from pfnn_jax.cli import main

    site, out = serve(), tmp_path / "styles"
    words = ["download", "100style", "--out", str(out), "--record-url", site.record_url]
    main([*words, "--json", str(tmp_path / "result.json")])
    printed = capsys.readouterr().out
    assert str(out / "100STYLE") in printed and "3 takes" in printed and "prepare" in printed
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["takes"] == 3 and Path(result["folder"]) == out / "100STYLE"
    assert result["md5"] == hashlib.md5(site.content).hexdigest() and result["size"] == len(site.content)
    with pytest.raises(SystemExit) as stopped:
        main(words)
    assert stopped.value.code == 2
    assert capsys.readouterr().err.strip().count("\n") == 0


def test_nothing_but_the_standard_library_is_needed():
    code = "import sys, pfnn_jax.motion.datasets.download; assert not {'numpy', 'scipy', 'jax'} & set(sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
