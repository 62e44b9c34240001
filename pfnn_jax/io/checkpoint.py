"""Trees of parameters on disk: complete or absent, restored into types, never unpickled. The only file with Orbax.

Everything is written under a temporary name beside its target and renamed when it is complete. A folder cannot be
replaced in one step, so the last save is moved aside (`.NAME.old`) for the moment of the exchange; readers find it
there. A program killed at any moment therefore leaves its last completed save.
"""

from __future__ import annotations

import errno
import hashlib
import json
import logging
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from orbax.checkpoint import v1 as ocp

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import json_text

Tree = TypeVar("Tree")

TREE = "parameters"
"""Folder of the Orbax checkpoint inside a saved record."""

FILES = "files.json"
"""The checkpoint's files and their sizes, by which a damaged copy is recognised."""

_FULL = (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Writes a file or a folder so that it is complete or absent.

    Args:
        target: where it shall stand; parents are made. An existing one is replaced when the block ends well.

    Yields:
        A path beside `target` at which nothing stands yet. The block writes a file or a folder there.

    Raises:
        InputError: if the disk is full; nothing is left of the attempt, and an earlier save stands as it was.
    """
    new = target.with_name(f".{target.name}.new")
    try:
        with reporting_full_disk(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            _remove(new)
            yield new
            _exchange(new, target)
    finally:
        _remove(new)


@contextmanager
def reporting_full_disk(target: Path) -> Iterator[None]:
    """Turns the system's error on a full disk into an `InputError` that names the target; other errors pass."""
    try:
        yield
    except (OSError, ValueError) as error:
        # Orbax writes through tensorstore, which reports the system's error only as text.
        if getattr(error, "errno", None) in _FULL or "No space left on device" in str(error):
            raise InputError(target, "disk", "no space left", "the write was given up; free some room") from error
        raise


def locate(target: Path) -> Path | None:
    """Where the last completed save of a target stands: its own path, the one moved aside, or None."""
    old = target.with_name(f".{target.name}.old")
    return next((path for path in (target, old) if path.exists()), None)


def saved_names(folder: Path) -> tuple[str, ...]:
    """Names of the completed saves in a folder, sorted; none where the folder is absent."""
    entries = [entry.name for entry in folder.iterdir()] if folder.is_dir() else []
    aside = [name[1:-4] for name in entries if name.startswith(".") and name.endswith(".old")]
    return tuple(sorted({*aside, *(name for name in entries if not name.startswith("."))}))


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Writes a dict as one JSON file, complete or absent. Arrays of one number become numbers, NaN becomes null."""
    with replacing(path) as new:
        new.write_text(json_text(data), encoding="utf-8")


def read_json(path: Path, rule: str) -> dict[str, Any]:
    """Reads a JSON object.

    Args:
        path: the file.
        rule: what the file should be, for messages.

    Raises:
        InputError: if the file is absent, is no JSON (naming the line) or no object.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise InputError(path, f"line {error.lineno}", error.msg, rule) from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, "file", getattr(error, "strerror", None) or "not UTF-8 text", rule) from error
    if not isinstance(data, dict):
        raise InputError(path, "line 1", type(data).__name__, f"must be a JSON object; {rule}")
    return data


def save_record(folder: Path, tree: Any, note_name: str, note: Mapping[str, Any]) -> None:
    """Saves a tree of arrays with a note beside it, as one folder that is complete or absent.

    Args:
        folder: replaced where it exists.
        tree: a pytree of arrays; dataclasses of `flax.struct` and states of optax are trees.
        note_name: name of the JSON file of the note.
        note: what to know of the tree without loading it.

    Raises:
        InputError: if the disk is full.
    """
    arrays = jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, int | float) else leaf, tree)
    with replacing(folder) as new:
        new.mkdir()
        _need_room(folder, new, sum(leaf.nbytes for leaf in jax.tree.leaves(arrays)))
        with _quiet():
            ocp.save(str((new / TREE).absolute()), arrays)
        write_json(new / FILES, _sizes(new / TREE))
        write_json(new / note_name, note)


def load_record(folder: Path, abstract: Tree) -> Tree:
    """Reads the tree of the last completed `save_record` into the types of an abstract one.

    Args:
        folder: as given to `save_record`.
        abstract: the tree expected, with arrays or what `jax.eval_shape` returns as leaves.

    Returns:
        The tree, on the default device unless a leaf of `abstract` names a sharding.

    Raises:
        InputError: if the folder is absent or damaged, or if the stored tree has another structure, or an array of
            another shape or type: naming the parameter and both.
    """
    record = locate(folder) or folder
    _check_files(folder, record)
    sharding = jax.sharding.SingleDeviceSharding(jax.devices()[0])

    def described(leaf: Any) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=getattr(leaf, "sharding", None) or sharding)

    leaves = jax.tree.map(described, jax.eval_shape(lambda: abstract))
    stored = str((record / TREE).absolute())
    try:
        with _quiet():
            _compare(folder, _arrays(ocp.metadata(stored).metadata), _arrays(leaves))
            return ocp.load(stored, leaves)
    except InputError:
        raise
    except (OSError, ValueError, KeyError) as error:
        first = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise InputError(folder, "checkpoint", first, "must be a completed, undamaged save") from error


def read_note(folder: Path, note_name: str, rule: str) -> dict[str, Any]:
    """The note of the last completed `save_record`; `rule` as in `read_json`."""
    return read_json((locate(folder) or folder) / note_name, rule)


def fingerprint(tree: Any) -> str:
    """SHA-256 over the names, types, shapes and values of a tree of parameters, in hexadecimal."""
    digest = hashlib.sha256()
    for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]:
        array = np.ascontiguousarray(leaf)
        digest.update(f"{jax.tree_util.keystr(path)} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.data)
    return digest.hexdigest()


def _need_room(target: Path, folder: Path, size: int) -> None:
    """Refuses a save that cannot fit, before Orbax begins: its threads report a full disk with many tracebacks."""
    free = shutil.disk_usage(folder).free
    if free < size:
        raise InputError(target, "disk", f"{free / 1e6:.1f} MB free", f"the save needs up to {size / 1e6:.1f} MB")


def _sizes(folder: Path) -> dict[str, int]:
    return {path.relative_to(folder).as_posix(): path.stat().st_size for path in folder.rglob("*") if path.is_file()}


def _check_files(folder: Path, record: Path) -> None:
    """Refuses a record of which a file is missing or cut, before Orbax's threads fall over it."""
    rule = "must be a completed, undamaged save"
    found = _sizes(record / TREE)
    for name, size in read_json(record / FILES, rule).items():
        if found.get(name) != size:
            value = "absent" if name not in found else f"{found[name]} bytes"
            raise InputError(folder, f"file {TREE}/{name}", value, f"must be {size} bytes; {rule}")


def _arrays(tree: Any) -> dict[str, tuple[tuple[int, ...], Any]]:
    """Shape and type of every array of a tree by its dotted name."""
    leaves = jax.tree_util.tree_flatten_with_path(tree)[0]
    found = {}
    for path, leaf in leaves:
        name = ".".join(str(getattr(k, "name", getattr(k, "key", getattr(k, "idx", k)))) for k in path)
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            leaf = jax.eval_shape(jax.random.key_data, leaf)
        found[name] = (tuple(leaf.shape), leaf.dtype)
    return found


def _compare(folder: Path, stored: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    for name in (*expected, *stored):
        here, there = (side.get(name) for side in (stored, expected))
        if here != there:
            value, rule = (f"{side[1]} {list(side[0])}" if side else "absent" for side in (here, there))
            raise InputError(folder, f"parameter {name}", value, f"must be {rule}")


def _exchange(new: Path, target: Path) -> None:
    """Puts `new` at `target`; at every moment `locate(target)` is a completed save."""
    if not new.is_dir():
        os.replace(new, target)
        return
    old = target.with_name(f".{target.name}.old")
    if target.exists():
        _remove(old)
        os.rename(target, old)
    os.rename(new, target)
    _remove(old)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keeps Orbax's log lines off the user's terminal, and only while Orbax works."""
    logger = logging.getLogger("absl")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
