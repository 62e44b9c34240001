"""Laws of styles in files: export and import is the identity, nothing private is in them, a misfit is named."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pfnn_jax.control.run_settings import recorded_speed
from pfnn_jax.errors import InputError
from pfnn_jax.io.tensors import read_metadata, read_tensors, write_tensors
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.layers import style_kinds
from pfnn_jax.models.network import init_network
from pfnn_jax.run import Run, load_run, load_style, save_shared, save_style
from pfnn_jax.run_config import list_styles, save_config, style_note
from pfnn_jax.workflows.generate import generate_clip
from pfnn_jax.workflows.learn import learn_style, tune_style
from pfnn_jax.workflows.model_card import model_card
from pfnn_jax.workflows.private_paths import without_folders
from pfnn_jax.workflows.share_style import export_style, import_style
from pfnn_jax.workflows.style_card import card_from_metadata, read_style_card
from tests.interop.small_runs import make_run
from tests.raising import assert_refused

INFO = {
    "source": "/home/jane doe/clips/tired.bvh",
    "speed": 1.25,
    "held_out_error": 0.4,
    "notes": ["retargeted from 25 joints"],
    "config": {"learning_rates": [1e-3], "method": "cp"},
}


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Run:
    """A run whose second style is like one that was learned from a clip."""
    run = make_run(tmp_path_factory.mktemp("runs") / "run", "mason2018", "cp")
    save_style(run.path, "tired", load_style(run, "style1"), INFO)
    return run


@pytest.fixture(scope="module")
def file(run: Run, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("files") / "tired.safetensors"
    export_style(run, "tired", path, licence="CC BY 4.0")
    return path


@pytest.fixture
def copy(run: Run, tmp_path: Path) -> Path:
    """A copy of the run without the style."""
    shutil.copytree(run.path, tmp_path / "copy")
    shutil.rmtree(tmp_path / "copy" / "styles" / "tired")
    return tmp_path / "copy"


@pytest.fixture(scope="module")
def untouched(run: Run, tmp_path_factory) -> Run:
    """A copy of the run without the style, for what must not change it."""
    path = shutil.copytree(run.path, tmp_path_factory.mktemp("untouched") / "copy")
    shutil.rmtree(path / "styles" / "tired")
    return load_run(path)


def assert_bitwise(one: Any, other: Any) -> None:
    assert jax.tree.structure(one) == jax.tree.structure(other)
    jax.tree.map(np.testing.assert_array_equal, one, other)


@pytest.mark.parametrize("kind", style_kinds())
def test_a_style_of_every_kind_goes_through_a_file_bit_for_bit(tmp_path: Path, kind: str):
    run = make_run(tmp_path / "run", "mason2018", kind, num_styles=1)
    card = export_style(run, "style0", tmp_path / "a.safetensors")
    assert import_style(run, tmp_path / "a.safetensors", "again").adapter == card.adapter
    assert_bitwise(load_style(run, "again"), load_style(run, "style0"))


def test_a_character_walks_the_same_in_an_imported_style(run: Run, file: Path, copy: Path):
    import_style(copy, file)
    settings = {"seconds": 0.5, "foot_ik": False, "published_loop": True}
    walks = [generate_clip(where, "tired", "straight", **settings) for where in (run, load_run(copy))]
    np.testing.assert_array_equal(walks[0].rotations, walks[1].rotations)
    np.testing.assert_array_equal(walks[0].root_positions, walks[1].root_positions)


def test_an_imported_style_exports_the_same_bytes(file: Path, copy: Path, tmp_path: Path):
    import_style(copy, file)
    export_style(copy, "tired", tmp_path / "again.safetensors")
    assert (tmp_path / "again.safetensors").read_bytes() == file.read_bytes()


def test_a_run_keeps_what_it_knows_of_a_style(file: Path, copy: Path):
    import_style(copy, file)
    found = style_note(copy, "tired")["info"]
    assert found == {**INFO, "source": "tired.bvh", "licence": "CC BY 4.0"}


def test_the_card_says_what_a_style_is_and_where_it_fits(run: Run, file: Path):
    card, text = read_style_card(file), read_metadata(file)
    assert (card.name, card.source, card.licence, card.layout) == ("tired", "tired.bvh", "CC BY 4.0", "mason2018")
    assert card.network == run.fingerprint and card.skeleton["names"] == list(run.skeleton.names)
    assert card.info["held_out_error"] == 0.4 and card.info["speed"] == 1.25
    assert list(text)[:4] == ["format", "format_version", "name", "source"]
    assert card.to_metadata() == text


def test_no_folder_of_the_writer_is_in_a_file(run: Run, file: Path):
    content = file.read_bytes()
    assert b"jane" not in content and str(run.path).encode() not in content


@pytest.mark.parametrize(
    ("source", "shared"),
    [
        ("jane/walks", "walks"),
        ("jane\\walks\\", "walks"),
        ("LPN weights in jane/lpn", "lpn"),
        ("procedural walker", "procedural walker"),
        ("https://doi.org/10.5281/zenodo", "https://doi.org/10.5281/zenodo"),
        (["jane"], ["jane"]),
        (None, None),
    ],
)
@pytest.mark.parametrize("entry", ["source", "dataset"])
def test_sources_given_by_relative_paths_are_named_by_their_last_part(entry: str, source: Any, shared: Any):
    assert without_folders({"deep": [{entry: source}]}) == {"deep": [{entry: shared}]}


@pytest.mark.parametrize(
    ("text", "shared"),
    [
        ("/home/jane doe/data", "data"),
        ("/home/jane/data/", "data"),
        ("LPN weights in /home/jane doe/x/lpn", "LPN weights in lpn"),
        ("C:\\Users\\jane\\x.bvh", "x.bvh"),
        ("\\\\server\\jane\\x.bvh", "x.bvh"),
        ("file:///home/jane/x.bvh", "x.bvh"),
        ("~/jane/x.bvh", "x.bvh"),
        ("~jane/x.bvh", "x.bvh"),
        ("../jane/x.bvh", "x.bvh"),
        ("note:/home/jane/x.bvh", "note:x.bvh"),
        (["(/home/jane/x)", {"a": "/jane/b"}], ["(x)", {"a": "b"}]),
        ("procedural walker", "procedural walker"),
        ("60 fps and/or 30, 1/2", "60 fps and/or 30, 1/2"),
        ("https://doi.org/10.5281/zenodo", "https://doi.org/10.5281/zenodo"),
        (1.5, 1.5),
        (None, None),
    ],
)
def test_texts_name_files_by_their_last_part(text: Any, shared: Any):
    assert without_folders(text) == shared


def other_network(path: Path) -> None:
    save_shared(path, init_network(load_run(path).config.network, key=jax.random.key(5)))


def other_statistics(path: Path) -> None:
    np.save(path / "normaliser" / "x_mean.npy", load_run(path).normaliser.inputs.mean + 1)


def other_skeleton(change: Callable[[dict[str, Any]], None]) -> Callable[[Path], None]:
    def apply(path: Path) -> None:
        data = json.loads((path / "config.json").read_text())
        change(data["skeleton"])
        (path / "config.json").write_text(json.dumps(data))

    return apply


def lengthen(skeleton: dict[str, Any]) -> None:
    skeleton["offsets"][3][1] += 0.01


def rename(skeleton: dict[str, Any]) -> None:
    skeleton["names"][4] = "Head_01"


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (other_network, "shared network"),
        (other_statistics, "normaliser"),
        (other_skeleton(lengthen), "skeleton"),
        (other_skeleton(rename), "skeleton"),
    ],
)
def test_a_style_of_another_network_is_refused(file: Path, copy: Path, change: Callable[[Path], None], place: str):
    change(copy)
    refused = assert_refused(lambda: import_style(copy, file), file="tired.safetensors", place=place)
    assert "tired" not in list_styles(copy)
    if place == "shared network":
        assert refused.value == read_style_card(file).network and load_run(copy).fingerprint in refused.rule


@pytest.mark.parametrize("write", [import_style, learn_style, tune_style])
def test_a_run_whose_network_was_trained_again_since_it_was_loaded_is_refused(file: Path, copy: Path, write: Callable):
    loaded = load_run(copy)
    other_network(copy)
    refused = assert_refused(lambda: write(loaded, file), file="copy", place="shared network")
    assert refused.value == load_run(copy).fingerprint[:12] and loaded.fingerprint[:12] in refused.rule
    assert "tired" not in list_styles(copy)


def test_a_style_goes_into_a_run_that_was_moved_aside_by_a_killed_process(file: Path, copy: Path):
    copy.rename(copy.with_name(".copy.old"))
    import_style(copy, file)
    assert "tired" in list_styles(copy) and not copy.with_name(".copy.old").exists()


@pytest.mark.parametrize("write", [import_style, learn_style])
def test_what_is_not_a_run_is_refused_without_a_trace(file: Path, tmp_path: Path, write: Callable):
    assert_refused(lambda: write(tmp_path / "none" / "run", file), rule_mentions="run directory")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("layout", "kind", "place"),
    [("pfnn2017", "cp", "layout"), ("mason2022", "film", "layout"), ("mason2018", "film", "adapter kind")],
)
def test_a_style_of_another_layout_or_way_of_styling_is_refused(tmp_path: Path, file: Path, layout, kind, place):
    run = make_run(tmp_path / "run", layout, kind)
    assert_refused(lambda: import_style(run, file), file="tired.safetensors", place=place)


def test_a_rank_other_than_the_runs_is_refused(file: Path, copy: Path):
    save_config(copy, replace(load_run(copy).config, adapter=AdapterConfig("cp", 2)))
    assert_refused(lambda: import_style(copy, file), place="adapter rank", value=3, rule_mentions="must be 2")


def entry(name: str, value: Any) -> Callable[[dict, dict], None]:
    """Returns a change of one entry of the metadata, which is removed for None."""

    def apply(arrays: dict, text: dict) -> None:
        text.pop(name, None)
        if value is not None:
            text[name] = value if isinstance(value, str) else json.dumps(value)

    return apply


def info(**entries: Any) -> Callable[[dict, dict], None]:
    kept = {key: value for key, value in INFO.items() if key != "source"}
    return entry("info", {**kept, **entries})


def parameter(name: str, change: Callable[[np.ndarray], Any] | None) -> Callable[[dict, dict], None]:
    def apply(arrays: dict, text: dict) -> None:
        value = arrays.pop(name, np.zeros(3, np.float32))
        if change is not None:
            arrays[name] = change(value)

    return apply


def with_nan(array: np.ndarray) -> np.ndarray:
    array = array.copy()
    array.flat[1] = np.nan
    return array


TAMPERED = {
    "another format": (entry("format", "lora"), "format"),
    "no format": (entry("format", None), "format"),
    "a later version": (entry("format_version", "2"), "format version"),
    "no version": (entry("format_version", None), "format version"),
    "no name": (entry("name", None), "name"),
    "a name with a slash": (entry("name", "../escape"), "style name"),
    "an empty name": (entry("name", ""), "style name"),
    "no network": (entry("network", None), "network"),
    "a name of two lines": (entry("name", "a\nb"), "name"),
    "a layout of a million letters": (entry("layout", "m" * 10**5), "layout"),
    "an unknown kind": (entry("adapter", {"kind": "cubic", "rank": 3}), "adapter"),
    "no kind": (entry("adapter", {"rank": 3}), "adapter"),
    "an adapter of more entries": (entry("adapter", {"kind": "cp", "rank": 3, "x": 1}), "adapter"),
    "a rank of words": (entry("adapter", {"kind": "cp", "rank": "3"}), "adapter"),
    "a rank of none": (entry("adapter", {"kind": "cp", "rank": 0}), "adapter"),
    "another kind than the arrays'": (entry("adapter", {"kind": "full", "rank": 3}), "parameter weights"),
    "a rank without end": (entry("adapter", {"kind": "cp_output", "rank": 10**30}), "adapter rank"),
    "an adapter that is a list": (entry("adapter", [1]), "adapter"),
    "an adapter that is no JSON": (entry("adapter", "{"), "adapter"),
    "a deep nesting": (entry("info", "[" * 100_000), "info"),
    "a skeleton without offsets": (entry("skeleton", {"names": [], "parents": []}), "skeleton"),
    "a skeleton of other lengths": (entry("skeleton", {"names": ["a"], "parents": [], "offsets": []}), "skeleton"),
    "a speed of words": (info(speed="fast"), "info: speed"),
    "an error that is true": (info(held_out_error=True), "info: held_out_error"),
    "a speed of 400 digits": (info(speed=10**400), "info: speed"),
    "a number of frames that is none": (info(frames=float("nan")), "info: frames"),
    "an error without end": (info(error=-float("inf")), "info: error"),
    "a licence that the card does not show": (info(licence="CC0"), "info: licence"),
    "a source that the card does not show": (info(source=[1]), "info: source"),
    "a licence of two lines": (entry("licence", "mine\nforged: line"), "licence"),
    "a source of a million letters": (entry("source", "m" * 10**5), "source"),
    "notes of numbers": (info(notes=[1]), "info: notes"),
    "a warning that is no list": (info(warnings="none"), "info: warnings"),
    "a parameter too few": (parameter("bias", None), "parameter bias"),
    "a parameter too many": (parameter("more", lambda array: array), "parameter more"),
    "another shape": (parameter("a", lambda array: array[:-1]), "parameter a"),
    "a transposed matrix": (parameter("a", lambda array: array.T), "parameter a"),
    "another type": (parameter("a", lambda array: array.astype(np.float64)), "parameter a"),
    "not a number": (parameter("b", with_nan), "parameter b"),
    "infinity": (parameter("d", lambda array: array / np.float32(0)), "parameter d"),
}


@pytest.mark.parametrize("name", TAMPERED)
def test_a_tampered_file_is_refused_and_leaves_the_run_as_it_was(file: Path, untouched: Run, tmp_path: Path, name: str):
    change, place = TAMPERED[name]
    arrays, text = read_tensors(file)
    with np.errstate(divide="ignore"):
        change(arrays, text)
    write_tensors(tmp_path / "bad.safetensors", arrays, text)
    before = sorted(untouched.path.rglob("*"))
    refused = assert_refused(lambda: import_style(untouched, tmp_path / "bad.safetensors"))
    assert refused.place == place and str(refused).isprintable(), refused
    assert sorted(untouched.path.rglob("*")) == before


@given(data=st.data())
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_file_with_bytes_changed_is_read_or_refused(file: Path, tmp_path: Path, data: st.DataObject):
    """Whatever happens to a file on its way, nothing but an `InputError` comes of reading it."""
    content = bytearray(file.read_bytes())
    header = 8 + int.from_bytes(content[:8], "little")
    for _ in range(data.draw(st.integers(1, 4), "changes")):
        at = data.draw(st.integers(0, header), "place")
        content[at : at + data.draw(st.integers(0, 8), "removed")] = data.draw(st.binary(max_size=8), "written")
    changed = tmp_path / "changed.safetensors"
    changed.write_bytes(
        content[: data.draw(st.integers(0, len(content)), "kept")] if data.draw(st.booleans()) else content
    )
    try:
        arrays, text = read_tensors(changed)
        assert all(array.dtype == np.float32 for array in arrays.values())
        assert card_from_metadata(text, changed).to_metadata().keys() <= read_metadata(file).keys()
    except InputError as error:
        assert str(error).isprintable()


def test_a_name_that_exists_needs_overwrite(run: Run, file: Path, copy: Path):
    import_style(copy, file)
    save_style(copy, "tired", load_style(run, "style0"), {}, overwrite=True)
    refused = assert_refused(lambda: import_style(copy, file), file="styles/tired", place="output", value="exists")
    assert "overwrite=True" in refused.rule
    assert_bitwise(load_style(load_run(copy), "tired"), load_style(run, "style0"))
    import_style(copy, file, overwrite=True)
    assert_bitwise(load_style(load_run(copy), "tired"), load_style(run, "tired"))


def test_a_style_can_be_imported_under_another_name(file: Path, copy: Path):
    assert import_style(copy, file, "weary").name == "weary"
    assert {"weary"} == set(list_styles(copy)) - {"style0", "style1"}
    assert style_note(copy, "weary")["name"] == "weary"
    assert_refused(lambda: import_style(copy, file, "a/b"), place="style name")


@pytest.mark.parametrize("licence", ["mine\x1b[31m", "mine\nforged: line", "m" * 201])
def test_a_licence_that_no_import_would_take_is_not_exported(run: Run, tmp_path: Path, licence: str):
    out = tmp_path / "a.safetensors"
    assert_refused(lambda: export_style(run, "tired", out, licence=licence), file=out, place="licence")
    assert not out.exists()


@pytest.mark.parametrize(
    ("source", "shared"), [("jane/m\u3000y.bvh", "m?y.bvh"), ("m" * 300, "m" * 200), ([1], None), (None, None)]
)
def test_a_style_of_a_clip_of_any_name_goes_through_a_file(run: Run, copy: Path, tmp_path: Path, source, shared):
    save_style(copy, "tired", load_style(run, "tired"), {"source": source})
    export_style(copy, "tired", tmp_path / "a.safetensors")
    assert import_style(copy, tmp_path / "a.safetensors", "again").source == shared


@pytest.mark.parametrize("speed", [10**400, -1.0, "fast", 1e12])
def test_a_recorded_speed_that_is_none_is_not_used(run: Run, copy: Path, speed: Any):
    """Of a run by others, whose `style.json` nobody has checked."""
    save_style(copy, "tired", load_style(run, "tired"), {"speed": speed})
    loaded = load_run(copy)
    assert recorded_speed(loaded, "tired") is None
    assert "| tired | – | – | – | – | – |" in model_card(loaded, "a", {"tired": {"speed": 10**400}}, None, card=False)


def test_what_cannot_be_exported_is_refused(run: Run, file: Path, tmp_path: Path):
    assert_refused(lambda: export_style(run, "sad", tmp_path / "a.safetensors"), place="style", value="sad")
    assert_refused(lambda: export_style(run, "tired", tmp_path / "a.npz"), place="suffix", value=".npz")
    assert_refused(lambda: export_style(run, "tired", file), place="output", value="exists")
    assert_refused(lambda: export_style(run, "tired", tmp_path / "no" / "a.safetensors"), place="output")
    assert not list(tmp_path.iterdir())
