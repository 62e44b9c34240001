"""Damaged and hostile files of every kind are read or refused in one line, without a hang and without much memory.

`experiments/mutated_files.py` reads thousands of them; here are a few, and what was found with it.
"""

from __future__ import annotations

import io
import json
import struct
import warnings
import zipfile
import zlib
from random import Random
from typing import Any

import numpy as np
import pytest

from experiments import mutated_files
from experiments.common.mutations import mutated
from pfnn_jax.errors import InputError
from pfnn_jax.interop.released.files import read_array
from pfnn_jax.io.files import read_json
from pfnn_jax.io.npy import load_array
from pfnn_jax.io.npz import read_arrays
from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.datasets.dataset import load_dataset
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.skeleton import MAX_JOINTS, skeleton_from_json, skeleton_to_json
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.walks import synthetic_clips
from tests.raising import assert_refused

FILES = 60
"""Changed files of the corpus that are read here."""

STYLES = 300
"""Changed shared styles that are read here; they are small."""

RULE = "must be as it was"


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mutated") / "corpus"
    mutated_files.make_files(folder)
    return folder


def test_files_changed_at_random_are_read_or_refused_in_one_line(corpus, tmp_path):
    counts = {"read": 0, "refused": 0}
    for number in range(FILES):
        target, original, data = mutated_files.changed(corpus, number)
        file = tmp_path / original.name
        file.write_bytes(data)
        try:
            target.read(file)
            counts["read"] += 1
        except InputError as error:
            assert mutated_files.check_message(error) == "refused", number
            counts["refused"] += 1
    assert min(counts.values()) > 0


def test_changes_of_a_shared_style_reach_its_card(corpus, tmp_path):
    """Entries of a card are refused one by one, which needs a header whose size fits; the file as it was is read."""
    original = (corpus / "style.safetensors").read_bytes()
    places = set()
    for number in range(STYLES):
        (tmp_path / "style.safetensors").write_bytes(mutated(original, "safetensors", Random(number)))
        try:
            mutated_files.read_shared_style(tmp_path / "style.safetensors")
        except InputError as error:
            assert mutated_files.check_message(error) == "refused", number
            places.add(error.place.partition(":")[0])
    assert places >= {"header", "info", "adapter", "skeleton", "format version"}
    mutated_files.read_shared_style(corpus / "style.safetensors")


def test_a_number_is_always_the_same_file(corpus):
    assert mutated_files.changed(corpus, 7)[2] == mutated_files.changed(corpus, 7)[2]


def tower(joints: int) -> str:
    """Returns joints without channels, each inside the one before."""
    opened = "".join(f"JOINT j{joint} {{ OFFSET 0 1 0 CHANNELS 0 " for joint in range(joints))
    return opened + "}" * joints


def bvh(joints: int, head: str = "Frames: 2", rows: int = 2) -> str:
    root = f"HIERARCHY ROOT a {{ OFFSET 0 0 0 CHANNELS 1 Zrotation {tower(joints)}}}"
    return f"{root}\nMOTION\n{head}\nFrame Time: 0.01\n" + "0\n" * rows


@pytest.mark.parametrize(
    ("text", "place", "rule"),
    [
        (bvh(2, "Frames: 1 \n" * 1000 + "x"), "line 2", "precedes"),
        (bvh(2, "Frames:  \n" * 1000 + "x"), "line 2", "precedes"),
        (bvh(2, "Frames: 1\n" * 100_000), "line 2", "precedes"),
        (bvh(2, "Frames: 999999999"), "line 6", "as `Frames:` says"),
        (bvh(20_000), None, "at most 2000 joints"),
        (bvh(1990, rows=300_000), "frames", "at most 4000000"),
        (bvh(0).replace("{", "{" * 5_000_000), "hierarchy", "at most"),
    ],
    ids=["many counts", "empty counts", "100,000 counts", "huge count", "tower", "frames of a tower", "braces"],
)
def test_text_that_repeats_without_end_is_refused(tmp_path, text, place, rule):
    """The first two took exponential time, the third quadratic; the last three gigabytes."""
    (tmp_path / "a.bvh").write_text(text)
    assert_refused(lambda: read_bvh(tmp_path / "a.bvh"), file="a.bvh", place=place, rule_mentions=rule)


def test_files_that_are_too_large_are_refused_before_they_are_read(tmp_path):
    """Sparse files, which take no room."""
    for name, read in (
        ("a.bvh", read_bvh),
        ("a.json", lambda path: read_json(path, RULE)),
        ("a.bin", lambda path: read_array(path, None)),
    ):
        with (tmp_path / name).open("wb") as file:
            file.truncate(2**40)
        assert_refused(lambda: read(tmp_path / name), file=name, place="size", value=f"{2**40} bytes")  # noqa: B023


def npy(header: str, content: bytes = b"") -> bytes:
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + content


@pytest.mark.parametrize(
    "data",
    [
        b"",
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000,)}", bytes(16)),
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (4294967296, 4294967296)}", bytes(16)),
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (-1,)}", bytes(16)),
        npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,)}", bytes(16)),
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (1,", bytes(16)),
        npy("(" * 5000),
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (8,)}", bytes(16)),
    ],
    ids=["empty", "huge", "overflow", "negative", "pickle", "cut", "nested", "short"],
)
def test_arrays_that_state_more_than_they_hold_are_refused(tmp_path, data):
    """Also as a member of an archive, stored and compressed."""
    (tmp_path / "a.npy").write_bytes(data)
    assert_refused(lambda: load_array(tmp_path / "a.npy", RULE), file="a.npy", place="array", rule_mentions=RULE)
    for method in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        with zipfile.ZipFile(tmp_path / "a.npz", "w", method) as archive:
            archive.writestr("x.npy", data)
        assert_refused(lambda: read_arrays(tmp_path / "a.npz", ("x",), RULE), file="a.npz", rule_mentions=RULE)


def test_archives_that_expand_without_bound_are_refused(tmp_path):
    """Before a byte is expanded: the directory of the archive states two gigabytes."""
    stream = io.BytesIO()
    np.savez_compressed(stream, x=np.zeros(1000))
    data = bytearray(stream.getvalue())
    struct.pack_into("<I", data, data.index(b"PK\x01\x02") + 24, 2**31)
    (tmp_path / "a.npz").write_bytes(bytes(data))
    refused = assert_refused(lambda: read_arrays(tmp_path / "a.npz", ("x",), RULE), file="a.npz", place="file")
    assert "must be at most" in str(refused.value)


@pytest.mark.parametrize("method", [9, 12, 99])
def test_archives_of_an_unknown_compression_are_refused(tmp_path, method):
    stream = io.BytesIO()
    np.savez(stream, x=np.zeros(4))
    data = bytearray(stream.getvalue())
    for signature, place in ((b"PK\x03\x04", 8), (b"PK\x01\x02", 10)):
        struct.pack_into("<H", data, data.index(signature) + place, method)
    (tmp_path / "a.npz").write_bytes(bytes(data))
    assert_refused(lambda: read_arrays(tmp_path / "a.npz", ("x",), RULE), file="a.npz", rule_mentions=RULE)


def test_archives_whose_content_is_damaged_are_refused(tmp_path):
    """`zlib.error` is no `ValueError`."""
    stream = io.BytesIO()
    np.savez_compressed(stream, x=np.arange(1000.0))
    data = bytearray(stream.getvalue())
    data[60:90] = bytes(30)
    with pytest.raises((zlib.error, zipfile.BadZipFile, ValueError)):
        np.load(io.BytesIO(bytes(data)))["x"]
    (tmp_path / "a.npz").write_bytes(bytes(data))
    assert_refused(lambda: read_arrays(tmp_path / "a.npz", ("x",), RULE), file="a.npz", rule_mentions=RULE)


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, '{"a":' * 100_000 + "1" + "}" * 100_000, '{"a": ' + "9" * 5000 + "}", '{"a": ', "[]", "\x00"],
)
def test_json_that_python_cannot_hold_is_refused(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    assert_refused(lambda: read_json(tmp_path / "a.json", RULE), file="a.json", rule_mentions=RULE)


SKELETON = skeleton_to_json(synthetic_skeleton())


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ("names", 5),
        ("names", []),
        ("parents", [-1] + [20] * (len(SKELETON["names"]) - 1)),
        ("parents", [0] * len(SKELETON["names"])),
        ("parents", [[-1]] * len(SKELETON["names"])),
        ("parents", [10**30] * len(SKELETON["names"])),
        ("mirror", [99] * len(SKELETON["names"])),
        ("offsets", [[0.0, float("nan"), 0.0]] * len(SKELETON["names"])),
        ("offsets", [["a"] * 3] * len(SKELETON["names"])),
        ("end_sites", [[99, [0, 0, 0]]]),
        ("end_sites", [[1, [0, 0]]]),
        ("end_sites", 7),
        ("roles", {**SKELETON["roles"], "head": 99}),
        ("roles", {"head": 1}),
        ("humanoid", {**SKELETON["humanoid"], "hips": "a"}),
        ("reference", [1, 2, 3]),
        ("resting_heights", "high"),
    ],
)
def test_skeletons_that_are_no_tree_are_refused(entry, value):
    changed = {**json.loads(json.dumps(SKELETON)), entry: value}
    assert_refused(lambda: skeleton_from_json(changed, "config.json"), file="config.json")


def test_skeletons_of_too_many_joints_are_refused():
    joints = MAX_JOINTS + 1
    entries = {"names": ["a"] * joints, "parents": [-1] + [0] * (joints - 1), "offsets": [[0.0, 1.0, 0.0]] * joints}
    many = {**SKELETON, **entries, "mirror": list(range(joints))}
    assert_refused(lambda: skeleton_from_json(many, "config.json"), place="skeleton.names", value=f"{joints} joints")


def test_skeletons_of_another_kind_are_refused():
    others: tuple[Any, ...] = (None, 5, [], "a")
    for data in others:
        assert_refused(lambda data=data: skeleton_from_json(data, "config.json"), file="config.json")
    assert skeleton_from_json(SKELETON).names == tuple(SKELETON["names"])


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    clips = synthetic_clips("old", 2.0)
    return prepare(clips, tmp_path_factory.mktemp("data") / "data", PrepareConfig()).path


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ("styles", 5),
        ("styles", ["another"]),
        ("rows", []),
        ("rows", {"train": {"old": "many"}}),
        ("rows", {"train": {"old": -1}}),
        ("layout", "none"),
        ("layout", []),
        ("skeleton", None),
        ("format", [2]),
    ],
)
def test_datasets_whose_entries_are_of_another_kind_are_refused(data, tmp_path, entry, value):
    content = json.loads((data / "dataset.json").read_text())
    (tmp_path / "dataset.json").write_text(json.dumps({**content, entry: value}))
    (tmp_path / "normaliser").symlink_to(data / "normaliser")
    assert_refused(lambda: load_dataset(tmp_path), file="dataset.json")


def test_no_warning_reaches_the_user(corpus, tmp_path):
    """Of numbers that overflow, for example: the readers see them first."""
    text = (corpus / "three.bvh").read_text().replace("0.033333", "1e-320").replace("OFFSET 0", "OFFSET 1e307")
    (tmp_path / "a.bvh").write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert_refused(lambda: read_bvh(tmp_path / "a.bvh"), file="a.bvh")
