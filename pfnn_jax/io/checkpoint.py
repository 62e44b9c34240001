"""Trees of parameters on disk: complete or absent, restored into types, never unpickled. The only file with Orbax.

A record is one folder: an Orbax checkpoint of the tree, a JSON note that can be read without it, the names, types and
shapes of its arrays, and the sizes of the checkpoint's files. Orbax alone would notice a damaged file only in its
threads, with many tracebacks, and its own atomic rename covers neither the note nor an exchange of an earlier record.
It takes as long to report types and shapes as to load the arrays, and TensorStore 0.1.86 leaks memory when it does.
"""

from __future__ import annotations

import errno
import hashlib
import logging
import os
import shutil
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as orbax
from orbax.checkpoint import v1 as ocp

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import ARRAYS, json_text, locate, read_json, remove, replacing

Tree = TypeVar("Tree")

TREE = "parameters"
"""Folder of the Orbax checkpoint inside a record."""

ITEM = "state"
"""Name that Orbax gives the tree in a checkpoint."""

COMMITTED = "commit_success.txt"
"""File by which Orbax marks a complete checkpoint; only its existence counts."""

LATE, LONGEST_LATE = 0.3, 3.0
"""Seconds without a new file after which the threads of a failed save have ended, and for which they are awaited."""

SMALL_FILES = 2**18
"""Bytes for what Orbax writes besides the arrays: some twenty files, each of at least one block of the disk."""

FILES = "files.json"
"""The checkpoint's files and their sizes, by which a damaged copy is recognised."""

COMPLETE = "must be a complete, undamaged save"
"""Rule that a damaged save breaks."""

_orbax = threading.Lock()
"""Held while Orbax works. It numbers its operations for the whole process, and waits by this number for its folders: a
save during which another thread begins to load fails now and then, because it does not find its own folder."""


def save_record(folder: Path, tree: Any, note_name: str, note: Mapping[str, Any]) -> None:
    """Saves a tree of arrays and a note about it as one folder that appears complete or not at all.

    Args:
        folder: replaced if it exists.
        tree: a pytree of arrays; dataclasses of `flax.struct` and states of optax are trees.
        note_name: name of the JSON file of the note.
        note: what can be read without loading the tree.

    Raises:
        InputError: if the disk is full or too slow, or the folder was removed meanwhile; the last save is kept.
    """
    arrays = jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, int | float) else leaf, tree)
    with replacing(folder) as new:
        new.mkdir()
        _need_room(folder, new, sum(leaf.nbytes for leaf in jax.tree.leaves(arrays)))
        (new / note_name).write_text(json_text(note), encoding="utf-8")
        with _quiet(), _ending_late_writes(folder, new):
            _save((new / TREE).absolute(), arrays)
        _need_same(new, note_name)
        # Orbax writes the checkpoint's path into this file; runs are passed on, and that path is gone after the rename.
        (new / TREE / COMMITTED).write_text("Checkpoint commit was successful\n", encoding="utf-8")
        (new / ARRAYS).write_text(json_text(_arrays(arrays)), encoding="utf-8")
        (new / FILES).write_text(json_text(_sizes(new / TREE)), encoding="utf-8")


def _save(path: Path, arrays: Any) -> None:
    """Saves a tree by Orbax; of several processes (`jax.distributed`), by this one alone.

    All that a run holds is in the memory of one process, so that the others need not see its folder. Orbax's present
    interface compares the path over all processes even where one saves; its earlier one, whose checkpoints the present
    one reads, does not.
    """
    if jax.process_count() == 1:
        ocp.save(str(path), arrays)
        return
    options = ocp.options.MultiprocessingOptions(**_alone()).v0()
    handler = orbax.CompositeCheckpointHandler(
        composite_options=orbax.CompositeOptions(multiprocessing_options=options)
    )
    arrays = jax.tree.map(np.asarray, arrays)  # arrays on devices are taken for what all processes save together
    with orbax.Checkpointer(handler, multiprocessing_options=options) as checkpointer:
        checkpointer.save(path, orbax.args.Composite(**{ITEM: orbax.args.PyTreeSave(arrays)}))


def _alone() -> dict[str, Any]:
    """Returns the options by which Orbax waits for no other process."""
    process = jax.process_index()
    return {
        "primary_host": process,
        "active_processes": {process},
        "barrier_sync_key_prefix": f"process {process}",
    }


@contextmanager
def _ending_late_writes(folder: Path, new: Path) -> Iterator[None]:
    """Removes what Orbax's threads still write after one of them has failed, until nothing comes for a while.

    Raises:
        InputError: if Orbax has given up waiting, which it measures by the time of day.
    """
    try:
        yield
    except Exception as error:
        quiet_since, ends = time.monotonic(), time.monotonic() + LONGEST_LATE
        while time.monotonic() < min(quiet_since + LATE, ends):
            if new.exists():
                with suppress(OSError):  # a file that appears meanwhile is removed in the next turn
                    remove(new)
                quiet_since = time.monotonic()
            time.sleep(0.01)
        if isinstance(error, TimeoutError):
            value, rule = (
                "timed out",
                "must not take minutes, nor the clock jump meanwhile; the last save is kept, try again",
            )
            raise InputError(folder, "save", value, rule) from error
        raise


def load_record(folder: Path, abstract: Tree) -> Tree:
    """Reads the tree of the last complete `save_record` into the types of an abstract one.

    Args:
        folder: as given to `save_record`.
        abstract: the tree expected, with arrays or what `jax.eval_shape` returns as leaves.

    Returns:
        The tree, on the default device unless a leaf of `abstract` names a sharding.

    Raises:
        InputError: if the folder is absent or damaged, or if the stored tree has another structure or an array of
            another shape or type; the message names the parameter and both shapes.
    """
    record = locate(folder) or folder
    _check_files(folder, record)
    with jax.ensure_compile_time_eval():  # also where a compiled function reads a run
        device = next(iter(jnp.zeros(()).devices()))  # the default one, which JAX's settings may also give by a name
    sharding = jax.sharding.SingleDeviceSharding(device)

    def described(leaf: Any) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=getattr(leaf, "sharding", None) or sharding)

    leaves = jax.tree.map(described, jax.eval_shape(lambda: abstract))
    stored = str((record / TREE).absolute())
    try:
        with _quiet():
            _compare(folder, _stated_arrays(record, stored), _arrays(leaves))
            return ocp.load(stored, leaves)
    except InputError:
        raise
    except Exception as error:  # Orbax and tensorstore report damage by a dozen kinds
        first = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise InputError(folder, "checkpoint", first, COMPLETE) from error


def fingerprint(tree: Any) -> str:
    """Returns the SHA-256 over names, types, shapes and values of a tree of parameters, in hexadecimal."""
    digest = hashlib.sha256()
    for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]:
        array = np.ascontiguousarray(leaf)
        digest.update(f"{jax.tree_util.keystr(path)} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.data)
    return digest.hexdigest()


def _need_room(target: Path, folder: Path, size: int) -> None:
    """Refuses a save that does not fit before Orbax begins: its threads report a full disk with many tracebacks."""
    free, size = shutil.disk_usage(folder).free, size + SMALL_FILES
    if free < size:
        raise InputError(target, "disk", f"{free / 1e6:.1f} MB free", f"the save needs up to {size / 1e6:.1f} MB")


def _need_same(new: Path, note_name: str) -> None:
    """Refuses a folder that was removed while it was written, for example with its run: Orbax makes it again."""
    if not (new / note_name).is_file():
        remove(new)
        with suppress(OSError):  # folders that hold something else stay
            new.parent.rmdir()
            if new.parent.name == "styles":  # in the run, which is one of possibly other things in its folder
                new.parent.parent.rmdir()
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(new))


def _sizes(folder: Path) -> dict[str, int]:
    return {path.relative_to(folder).as_posix(): path.stat().st_size for path in folder.rglob("*") if path.is_file()}


def _check_files(folder: Path, record: Path) -> None:
    """Refuses a record with a missing or truncated file, before Orbax's threads fail on it."""
    found = _sizes(record / TREE)
    for name, size in read_json(record / FILES, COMPLETE).items():
        if found.get(name) != size:
            value = "absent" if name not in found else f"{found[name]} bytes"
            raise InputError(folder, f"file {TREE}/{name}", value, f"must be {size} bytes; {COMPLETE}")


def _arrays(tree: Any) -> dict[str, str]:
    """Returns type and shape of every array, or of what describes it, by its dotted name."""
    found = {}
    for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]:
        name = ".".join(str(getattr(k, "name", getattr(k, "key", getattr(k, "idx", k)))) for k in path)
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            leaf = jax.eval_shape(jax.random.key_data, leaf)
        found[name] = f"{leaf.dtype.name} {list(leaf.shape)}"
    return found


def _stated_arrays(record: Path, stored: str) -> dict[str, Any]:
    """Returns types and shapes as the record states them, or as Orbax does for records that earlier versions wrote."""
    file = record / ARRAYS
    return read_json(file, COMPLETE) if file.exists() else _arrays(ocp.metadata(stored).metadata)


def _compare(folder: Path, stored: Mapping[str, Any], expected: Mapping[str, str]) -> None:
    for name in (*expected, *stored):
        here, there = (side.get(name, "absent") for side in (stored, expected))
        if here != there:
            raise InputError(folder, f"parameter {name}", str(here), f"must be {there}")


@contextmanager
def _quiet() -> Iterator[None]:
    """Lets one thread use Orbax, without its log lines; of several processes it then waits for no other."""
    logger = logging.getLogger("absl")
    with _orbax:
        level = logger.level
        logger.setLevel(logging.CRITICAL)
        context: Any = ocp.Context()
        if jax.process_count() > 1:
            for name, value in _alone().items():
                setattr(context.multiprocessing, name, value)
        try:
            with context:
                yield
        finally:
            logger.setLevel(level)
