"""Arrays on disk: rows are read where they are asked for, and a file that is no longer the same is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.io.npy import StoredArray
from tests.raising import assert_refused

RULE = "must be as it was written"
ROWS = np.random.default_rng(0).standard_normal((50, 3, 2)).astype(np.float32)


@pytest.fixture
def file(tmp_path) -> Path:
    np.save(tmp_path / "rows.npy", ROWS)
    return tmp_path / "rows.npy"


@pytest.mark.parametrize(
    "rows",
    [[7], [49, 0, 0, 12, 13, 14, 3], list(range(50)), [], slice(None), slice(3, 20)],
    ids=["one", "mixed", "all", "none", "slice", "part"],
)
def test_rows_are_those_of_the_array_in_any_order(file, rows):
    stored = StoredArray(file, RULE)
    assert (stored.shape, stored.dtype, len(stored), stored.size) == (ROWS.shape, ROWS.dtype, len(ROWS), ROWS.size)
    rows = rows if isinstance(rows, slice) else np.array(rows, int)
    np.testing.assert_array_equal(stored[rows], ROWS[rows])


def test_rows_outside_the_array_are_not_read(file):
    for row in (-1, len(ROWS)):
        with pytest.raises(IndexError):
            StoredArray(file, RULE)[np.array([0, row])]


@pytest.mark.skipif(not Path("/proc/self/maps").is_file(), reason="needs the /proc of Linux")
def test_no_file_stays_mapped_or_open(file):
    stored = StoredArray(file, RULE)
    stored[np.arange(20)]
    assert str(file) not in Path("/proc/self/maps").read_text()
    opened = {str(link.resolve()) for link in Path("/proc/self/fd").iterdir() if link.exists()}
    assert str(file.resolve()) not in opened


def _cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-8])


def _replace(file: Path) -> None:
    np.save(file.with_name("other.npy"), ROWS + 1)
    file.with_name("other.npy").replace(file)


@pytest.mark.parametrize("change", [Path.unlink, _cut, _replace], ids=["removed", "cut short", "replaced"])
def test_a_file_that_has_changed_is_refused(file, change):
    stored = StoredArray(file, RULE)
    change(file)
    assert_refused(lambda: stored[np.arange(3)], file=file, rule_mentions=RULE)


@pytest.mark.parametrize(
    "array",
    [np.asfortranarray(np.ones((4, 3))), np.array([{}, 1], object), np.float64(3)],
    ids=["column after column", "objects", "one number"],
)
def test_only_rows_of_numbers_are_opened(tmp_path, array):
    np.save(tmp_path / "other.npy", array)
    assert_refused(lambda: StoredArray(tmp_path / "other.npy", RULE), file="other.npy", rule_mentions=RULE)
