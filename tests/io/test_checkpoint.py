"""Laws of saving: typed round trips, the last completed save survives, every refusal is one sentence."""

import errno
import shutil
import signal
import subprocess
import sys
import textwrap
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.io import checkpoint, files
from pfnn_jax.io.checkpoint import TREE, fingerprint, load_record, save_record
from pfnn_jax.io.files import (
    ARRAYS,
    json_text,
    locate,
    read_json,
    read_note,
    replacing,
    saved_names,
    to_plain,
    write_json,
)
from pfnn_jax.models.config import NetworkConfig
from pfnn_jax.models.network import Network, init_network
from tests.raising import assert_refused

CONFIG = NetworkConfig(input_size=6, output_size=5, hidden=4)


def make_state(seed: int = 0):
    network = init_network(CONFIG, key=jax.random.key(seed))
    return {
        "network": network,
        "optimiser": optax.adam(1e-3).init(cast(Any, network)),
        "step": jnp.int32(seed),
        "key": None,
    }


def assert_equal(a, b):
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for left, right in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert left.dtype == right.dtype
        np.testing.assert_array_equal(left, right)


def save(folder, seed=0):
    save_record(folder, make_state(seed), "note.json", {"seed": seed})


def test_round_trip_is_exact_and_typed(tmp_path):
    save(tmp_path / "state", seed=3)
    loaded = load_record(tmp_path / "state", jax.eval_shape(make_state))
    assert_equal(loaded, make_state(3))
    assert isinstance(loaded["network"], Network)
    assert read_note(tmp_path / "state", "note.json", "") == {"seed": 3}


def test_arrays_of_numpy_and_plain_numbers_are_arrays_on_disk(tmp_path):
    save_record(tmp_path / "state", {"a": np.arange(3, dtype=np.float32), "b": 2}, "note.json", {})
    loaded = load_record(tmp_path / "state", {"a": jnp.zeros(3), "b": jnp.int32(0)})
    assert_equal(loaded, {"a": jnp.arange(3, dtype=jnp.float32), "b": jnp.int32(2)})


def test_a_second_save_replaces_the_first_and_leaves_no_other_file(tmp_path):
    for seed in (1, 2):
        save(tmp_path / "state", seed)
    assert_equal(load_record(tmp_path / "state", make_state()), make_state(2))
    assert [entry.name for entry in tmp_path.iterdir()] == ["state"]


@pytest.mark.parametrize(
    ("wrong", "parts"),
    [
        ({"step": jnp.zeros(2, jnp.int32)}, ("parameter step", "int32 []", "int32 [2]")),
        ({"step": jnp.float32(0)}, ("parameter step", "int32 []", "float32 []")),
        ({"more": jnp.zeros(1)}, ("parameter more", "absent", "float32 [1]")),
        ({"optimiser": None}, ("parameter optimiser.0.count", "int32 []", "must be absent")),
    ],
)
def test_another_structure_or_shape_names_the_folder_the_parameter_and_both_shapes(tmp_path, wrong, parts):
    save(tmp_path / "state")
    with pytest.raises(InputError) as error:
        load_record(tmp_path / "state", {**make_state(), **wrong})
    assert all(part in str(error.value) for part in (str(tmp_path / "state"), *parts))


def test_another_network_size_names_the_first_parameter(tmp_path):
    save(tmp_path / "state")
    other = init_network(NetworkConfig(input_size=6, output_size=5, hidden=8), key=jax.random.key(0))
    assert_refused(
        lambda: load_record(tmp_path / "state", {**make_state(), "network": other}),
        place="parameter network.layers.0.weights",
        value="float32 [4, 6, 4]",
        rule_mentions="[4, 6, 8]",
    )


@pytest.mark.parametrize("part", ["manifest.ocdbt", "_METADATA", "d"])
@pytest.mark.parametrize("cut", [False, True])
def test_a_damaged_save_is_refused_by_file(tmp_path, part, cut):
    save(tmp_path / "state")
    path = tmp_path / "state" / TREE / "state" / part
    path = next(path.iterdir()) if path.is_dir() else path
    if cut:
        path.write_bytes(path.read_bytes()[:-1])
    else:
        path.unlink()
    error = assert_refused(lambda: load_record(tmp_path / "state", make_state()), file="state")
    assert error.place.startswith("file") and error.place.endswith(path.name)


def test_shapes_that_are_not_those_of_the_checkpoint_are_refused(tmp_path):
    """The file that states them was exchanged, and fits what is asked for."""
    save_record(tmp_path / "state", {"a": np.zeros((2, 3), np.float32)}, "note.json", {})
    for text, wanted in (("float32 [3, 2]", jnp.zeros((3, 2))), ("float32 [2, 4]", jnp.zeros((2, 4)))):
        (tmp_path / "state" / ARRAYS).write_text(json_text({"a": text}))
        load = partial(load_record, tmp_path / "state", {"a": wanted})
        assert_refused(load, file="state", place="checkpoint", rule_mentions="undamaged")


@pytest.mark.parametrize("stated", [[], ["float32 [2, 3]"], {"a": ["x"] * 1000}, {"a": None}, {}, {"a": 1, "b": 2}])
def test_a_save_without_proper_types_and_shapes_is_refused(tmp_path, stated):
    save_record(tmp_path / "state", {"a": np.zeros((2, 3), np.float32)}, "note.json", {})
    (tmp_path / "state" / ARRAYS).write_text(json_text(stated))
    error = assert_refused(partial(load_record, tmp_path / "state", {"a": jnp.zeros((2, 3))}))
    assert "state" in error.file


def test_saves_of_earlier_versions_which_do_not_state_types_and_shapes_are_read(tmp_path):
    save(tmp_path / "state", seed=1)
    (tmp_path / "state" / ARRAYS).unlink()
    assert_equal(load_record(tmp_path / "state", make_state()), make_state(1))
    wrong = {**make_state(), "step": jnp.float32(0)}
    load = partial(load_record, tmp_path / "state", wrong)
    assert_refused(load, place="parameter step", value="int32 []", rule_mentions="float32 []")


def test_an_absent_save_is_refused(tmp_path):
    assert_refused(lambda: load_record(tmp_path / "state", make_state()), file="files.json", place="file")


def test_a_folder_that_was_moved_aside_is_found(tmp_path):
    """A kill between the two renames of an exchange leaves the last save under `.state.old`."""
    save(tmp_path / "state", seed=1)
    (tmp_path / "state").rename(tmp_path / ".state.old")
    assert_equal(load_record(tmp_path / "state", make_state()), make_state(1))
    assert saved_names(tmp_path) == ("state",)
    save(tmp_path / "state", seed=2)
    assert_equal(load_record(tmp_path / "state", make_state()), make_state(2))
    assert [entry.name for entry in tmp_path.iterdir()] == ["state"]


def test_a_kill_at_any_rename_leaves_a_completed_save(tmp_path, monkeypatch):
    """Each renaming and removal of an exchange in turn is the last thing that happens."""

    class Killed(BaseException):
        pass

    def killing(function, calls):
        def call(*args, **kwargs):
            if next(calls) == stop:
                raise Killed
            return function(*args, **kwargs)

        return call

    for stop in range(5):
        folder = tmp_path / str(stop) / "state"
        save(folder, seed=1)
        calls = iter(range(100))
        with monkeypatch.context() as patch:
            for module, name in ((files.os, "rename"), (files, "remove")):
                patch.setattr(module, name, killing(getattr(module, name), calls))
            try:
                save(folder, seed=2)
            except Killed:
                pass
        seed = int(load_record(folder, make_state())["step"])
        assert seed in (1, 2)
        assert_equal(load_record(folder, make_state()), make_state(seed))
        save(folder, seed=3)
        assert_equal(load_record(folder, make_state()), make_state(3))


KILLED = """
    import itertools
    import pathlib
    import jax.numpy as jnp
    from pfnn_jax.io.checkpoint import save_record
    for step in itertools.count(1):
        save_record(pathlib.Path({folder!r}), {{"a": jnp.full((64, 64), step), "step": step}}, "note.json", {{}})
        print(step, flush=True)
"""


def test_kill_minus_nine_in_the_middle_of_saving(tmp_path):
    folder = tmp_path / "state"
    code = textwrap.dedent(KILLED).format(folder=str(folder))
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    done = [int(process.stdout.readline()) for _ in range(5)][-1]
    process.send_signal(signal.SIGKILL)
    done = max([done, *map(int, process.stdout.read().split())])
    process.wait()
    process.stdout.close()
    loaded = load_record(folder, {"a": jnp.zeros((64, 64), jnp.int32), "step": jnp.int32(0)})
    assert loaded["step"] in (done, done + 1)
    assert (loaded["a"] == loaded["step"]).all()


def full_disk(*args, **kwargs):
    raise OSError(errno.ENOSPC, "No space left on device")


def full_disk_of_tensorstore(*args, **kwargs):
    raise ValueError("RESOURCE_EXHAUSTED: Failed writing: No space left on device [os_error_code='28']")


@pytest.mark.parametrize("failure", [full_disk, full_disk_of_tensorstore])
def test_a_full_disk_is_one_line_and_leaves_the_last_save(tmp_path, monkeypatch, failure):
    save(tmp_path / "state", seed=1)
    monkeypatch.setattr(checkpoint.ocp, "save", failure)
    assert_refused(
        lambda: save(tmp_path / "state", seed=2), file="state", place="disk", value="No space left on device"
    )
    assert [entry.name for entry in tmp_path.iterdir()] == ["state"]
    assert_equal(load_record(tmp_path / "state", make_state()), make_state(1))


def test_a_save_that_cannot_fit_is_refused_before_it_begins(tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoint.shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10, 10, 0))
    assert_refused(lambda: save(tmp_path / "state"), file="state", place="disk", value="0.0 MB free")
    # Room for the arrays alone: Orbax's own files would fill the disk, and its threads print tracebacks then.
    monkeypatch.setattr(checkpoint.shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10**6, 10**6, 200_000))
    assert_refused(lambda: save(tmp_path / "state"), file="state", place="disk", value="0.2 MB free")
    assert list(tmp_path.iterdir()) == []


def test_a_save_that_times_out_is_one_line_and_keeps_the_last_one(tmp_path, monkeypatch):
    """Orbax measures how long it waits by the time of day, which can jump."""

    def time_out(place, arrays):
        raise TimeoutError

    save(tmp_path / "state", seed=1)
    monkeypatch.setattr(checkpoint.ocp, "save", time_out)
    assert_refused(lambda: save(tmp_path / "state", seed=2), file="state", place="save", value="timed out")
    assert [entry.name for entry in tmp_path.iterdir()] == ["state"]
    assert_equal(load_record(tmp_path / "state", make_state()), make_state(1))


def test_a_folder_that_is_removed_during_a_save_is_not_made_again(tmp_path, monkeypatch):
    """Orbax makes what is missing above the place at which it writes."""
    write, run = checkpoint.ocp.save, tmp_path / "run"
    (run / "styles").mkdir(parents=True)
    (run / "config.json").write_text("{}")

    def remove_and_save(place, arrays):
        shutil.rmtree(run)
        write(place, arrays)

    monkeypatch.setattr(checkpoint.ocp, "save", remove_and_save)
    assert_refused(lambda: save(run / "styles" / "mine"), file="mine", value="No such file or directory")
    assert list(tmp_path.iterdir()) == []


def test_other_errors_pass_and_leave_nothing(tmp_path):
    with pytest.raises(KeyError), replacing(tmp_path / "file") as new:
        new.write_text("half")
        raise KeyError("stopped")
    assert list(tmp_path.iterdir()) == []
    assert locate(tmp_path / "file") is None


def test_json_round_trip_and_numbers_that_are_not_finite(tmp_path):
    write_json(tmp_path / "a.json", {"a": np.float32(0.5), "b": jnp.arange(2), "c": float("nan"), "d": (1, "x")})
    assert read_json(tmp_path / "a.json", "") == {"a": 0.5, "b": [0, 1], "c": None, "d": [1, "x"]}
    assert to_plain({"p": tmp_path}) == {"p": str(tmp_path)}


@pytest.mark.parametrize(
    ("content", "place"), [(b"{\n'a': 1}", "line 2"), (b"[1]", "line 1"), (b"\xff", "file"), (None, "file")]
)
def test_malformed_json_names_file_and_line(tmp_path, content, place):
    if content is not None:
        (tmp_path / "a.json").write_bytes(content)
    assert_refused(
        lambda: read_json(tmp_path / "a.json", "the rule"), file="a.json", place=place, rule_mentions="the rule"
    )


def test_fingerprint_sees_values_names_types_and_shapes():
    a = jnp.arange(4.0)
    others = [{"a": a + 1e-6}, {"b": a}, {"a": a.astype(jnp.int32)}, {"a": a.reshape(2, 2)}]
    assert fingerprint({"a": a}) == fingerprint({"a": np.arange(4, dtype=np.float32)})
    assert len({fingerprint(tree) for tree in [{"a": a}, *others]}) == 5


def test_saving_is_silent(tmp_path, capfd):
    save(tmp_path / "state")
    load_record(tmp_path / "state", make_state())
    assert capfd.readouterr() == ("", "")


def test_a_thread_can_save_while_another_loads(tmp_path):
    """Without the lock one of a dozen saves fails, because Orbax removes the folder that it writes into."""
    save(tmp_path / "old")
    stopped = threading.Event()

    def load() -> None:
        while not stopped.is_set():
            load_record(tmp_path / "old", jax.eval_shape(make_state))

    with ThreadPoolExecutor(2) as threads:
        loading = [threads.submit(load) for _ in range(2)]
        try:
            for seed in range(40):
                save(tmp_path / "new", seed)
        finally:
            stopped.set()
        for future in loading:
            future.result()
    assert_equal(load_record(tmp_path / "new", jax.eval_shape(make_state)), make_state(39))
