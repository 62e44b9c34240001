"""Laws of files of arrays: exact round trips, the same bytes for the same content, hostile files are one sentence."""

from __future__ import annotations

import json
import os
import pickle
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from pfnn_jax.io import tensors
from pfnn_jax.io.tensors import MAX_HEADER, read_metadata, read_tensors, write_tensors
from tests.raising import assert_refused

ARRAYS = {"b": np.arange(6, dtype=np.float32).reshape(2, 3), "a": np.array(np.pi, np.float32)}
TEXT = {"format": "a test", "zeta": "ζ", "alpha": '{"x": 1}'}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    write_tensors(tmp_path / "x.safetensors", ARRAYS, TEXT)
    return tmp_path / "x.safetensors"


def rebuilt(header: object, data: bytes = b"") -> bytes:
    """Returns a file with this header, text or JSON."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + data


def test_round_trip_is_exact(file: Path):
    arrays, text = read_tensors(file)
    assert text == TEXT == read_metadata(file)
    assert arrays.keys() == ARRAYS.keys()
    for name, array in arrays.items():
        assert array.dtype == np.float32 and array.shape == ARRAYS[name].shape
        np.testing.assert_array_equal(array, ARRAYS[name])


def test_the_same_content_makes_the_same_bytes_and_text_keeps_its_order(file: Path, tmp_path: Path):
    write_tensors(tmp_path / "y.safetensors", dict(reversed(ARRAYS.items())), TEXT)
    assert (tmp_path / "y.safetensors").read_bytes() == file.read_bytes()
    assert list(read_metadata(file)) == list(TEXT)


def test_the_library_of_the_format_reads_the_file(file: Path):
    with safe_open(file, framework="numpy") as opened:
        assert opened.metadata() == TEXT
        np.testing.assert_array_equal(opened.get_tensor("b"), ARRAYS["b"])


def test_arrays_begin_at_a_multiple_of_eight_bytes(file: Path):
    assert int.from_bytes(file.read_bytes()[:8], "little") % 8 == 0


ENTRY = {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]}
HOSTILE = {
    "empty": (b"", "header"),
    "too short": (b"\x02\0\0\0", "header"),
    "a pickle": (pickle.dumps({"a": np.ones(3)}), "header"),
    "a header of a terabyte": ((10**12).to_bytes(8, "little") + b"{}", "header"),
    "a header that ends early": ((100).to_bytes(8, "little") + b"{}", "header"),
    "no JSON": (rebuilt(b"nonsense"), "header"),
    "no UTF-8": (rebuilt(b'{"\xff": 1}'), "header"),
    "a deep nesting": (rebuilt(b"[" * 100_000), "header"),
    "a list": (rebuilt([1]), "header"),
    "metadata of numbers": (rebuilt({"__metadata__": {"a": 1}}), "header"),
    "metadata that is a list": (rebuilt({"__metadata__": []}), "header"),
    "no data": (rebuilt({"a": ENTRY}), "file"),
    "too much data": (rebuilt({"a": ENTRY}, bytes(9)), "file"),
    "another size than its shape's": (rebuilt({"a": {**ENTRY, "shape": [3]}}, bytes(8)), "file"),
    "a shape of 2^70": (rebuilt({"a": {**ENTRY, "shape": [2**35, 2**35]}}, bytes(8)), "file"),
    "a negative shape": (rebuilt({"a": {**ENTRY, "shape": [-2]}}, bytes(8)), "file"),
    "offsets backwards": (rebuilt({"a": {**ENTRY, "data_offsets": [8, 0]}}, bytes(8)), "file"),
    "arrays that overlap": (rebuilt({"a": ENTRY, "b": ENTRY}, bytes(8)), "file"),
    "an unknown type": (rebuilt({"a": {**ENTRY, "dtype": "O"}}, bytes(8)), "file"),
    "half precision": (rebuilt({"a": {**ENTRY, "dtype": "F16", "shape": [4]}}, bytes(8)), "parameter a"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused(tmp_path: Path, name: str):
    content, place = HOSTILE[name]
    (tmp_path / "x.safetensors").write_bytes(content)
    assert_refused(lambda: read_tensors(tmp_path / "x.safetensors"), file="x.safetensors", place=place)


@pytest.mark.parametrize("kept", [0.0, 0.3, 0.6, 0.99])
def test_a_truncated_file_is_refused(file: Path, kept: float):
    os.truncate(file, int(kept * file.stat().st_size))
    assert_refused(lambda: read_tensors(file), file=file.name, rule_mentions="whole safetensors file")


def test_what_is_no_file_or_too_large_is_refused(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    assert_refused(lambda: read_tensors(tmp_path / "no"), place="file", value="does not exist")
    assert_refused(lambda: read_tensors(tmp_path), place="file", value="is not a file")
    os.mkfifo(tmp_path / "pipe")
    assert_refused(lambda: read_tensors(tmp_path / "pipe"), place="file", value="is not a file")
    monkeypatch.setattr(tensors, "MAX_BYTES", 50)
    assert_refused(lambda: read_tensors(file), place="file", rule_mentions="at most 50 bytes")


def test_text_that_could_not_be_read_again_is_not_written(tmp_path: Path):
    text = {"a": "x" * MAX_HEADER}
    assert_refused(lambda: write_tensors(tmp_path / "x.safetensors", ARRAYS, text), place="header")
    assert not list(tmp_path.iterdir())


def test_files_of_others_are_read(tmp_path: Path):
    save_file(ARRAYS, tmp_path / "x.safetensors")
    arrays, text = read_tensors(tmp_path / "x.safetensors")
    assert arrays.keys() == ARRAYS.keys() and text == {}
