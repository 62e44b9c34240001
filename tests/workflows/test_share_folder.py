"""Laws of runs that are passed on: the same network and styles, nothing private, read back from the Hub."""

from __future__ import annotations

import errno
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
import yaml

from pfnn_jax.models.film_generator import FiLMGenerator
from pfnn_jax.run import Run, load_generator, load_run, load_style, save_generator, save_style, save_train_state
from pfnn_jax.run_config import list_styles, load_config, save_config, style_note
from pfnn_jax.training.log import append_metrics
from pfnn_jax.training.restyling import has_differences
from pfnn_jax.workflows import runs
from pfnn_jax.workflows.base import BASE_NETWORK
from pfnn_jax.workflows.hub import hub_run, is_hub_address
from pfnn_jax.workflows.share_folder import CARD, share_run
from pfnn_jax.workflows.share_style import export_style, import_style
from tests.interop.small_runs import make_run
from tests.raising import assert_refused
from tests.workflows.test_run import GENERATOR, make_film_run
from tests.writers import another_writer

COMMIT = "0123456789abcdef0123456789abcdef01234567"

PUBLIC = {"config.json", "normaliser", "shared", "styles", "README.md"}


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Run:
    """A run as it looks after training and use: with private files, and folders of its machine in its texts."""
    run = make_run(tmp_path_factory.mktemp("jane") / "run", "mason2018", "cp")
    settings = {"dataset": "jane/walks", "frames": {"style0": 10, "style1": 20}, "steps": 5}
    save_config(run.path, replace(run.config, pretrain=settings))
    info = {"source": str(run.path.parent / "my clip.bvh"), "frames": 240, "speed": 1.25, "held_out_error": 0.4}
    save_style(run.path, "tired", load_style(run, "style1"), {**info, "licence": "CC BY | 4.0"})
    save_style(run.path, "weary", load_style(run, "style1"), {"source": "jane/walks"})
    save_train_state(run.path, {"a": np.zeros(2, np.float32)}, 5)
    append_metrics(run.path, {"step": 5, "loss": 1.0})
    for private in ("uploads/a.bvh", ".deleted.1/style.json", ".shared.99.new/x", "styles/.old.1.new/x", "notes.txt"):
        (run.path / private).parent.mkdir(parents=True, exist_ok=True)
        (run.path / private).write_text("secret")
    return load_run(run.path)


@pytest.fixture(scope="module")
def shared(run: Run, tmp_path_factory) -> Path:
    return share_run(run, tmp_path_factory.mktemp("out") / "walker", licence="CC BY 4.0")


def head(folder: Path) -> dict[str, Any]:
    return yaml.safe_load((folder / "README.md").read_text().split("---")[1])


def assert_same(one: Run, other: Run) -> None:
    assert one.fingerprint == other.fingerprint and one.layout == other.layout
    np.testing.assert_array_equal(one.normaliser.inputs.mean, other.normaliser.inputs.mean)
    for name in list_styles(other.path):
        jax.tree.map(np.testing.assert_array_equal, load_style(one, name), load_style(other, name))


def test_a_shared_run_is_the_same_network_with_the_same_styles(run: Run, shared: Path):
    assert list_styles(shared) == list_styles(run.path) == ("style0", "style1", "tired", "weary")
    assert_same(run, load_run(shared))


def test_nothing_private_is_in_a_shared_run(run: Run, shared: Path):
    assert {path.name for path in shared.iterdir()} == PUBLIC
    assert not [path for path in shared.rglob(".*") if path.name.endswith((".new", ".old", ".lock"))]
    for file in (path for path in shared.rglob("*") if path.is_file()):
        content = file.read_bytes()
        for secret in (str(run.path.parent), "jane", "secret", str(shared.parent)):
            assert secret.encode() not in content, file
    assert load_config(shared).pretrain["dataset"] == style_note(shared, "weary")["info"]["source"] == "walks"


def test_styles_that_stay_behind_are_not_named(run: Run, tmp_path: Path):
    out = share_run(run, tmp_path / "out", styles=["style1"])
    assert list_styles(out) == load_config(out).styles == ("style1",)
    assert load_config(out).pretrain["frames"] == {"style1": 20}
    assert not [path for path in out.rglob("*") if path.is_file() and b"style0" in path.read_bytes()]
    assert_refused(lambda: share_run(run, tmp_path / "no", styles=["sad"]), place="style", value="sad")
    assert not (tmp_path / "no").exists()


def test_a_style_of_the_original_fits_the_shared_run(run: Run, tmp_path: Path):
    export_style(run, "tired", tmp_path / "tired.safetensors")
    out = share_run(run, tmp_path / "out", styles=[])
    import_style(out, tmp_path / "tired.safetensors")
    assert list_styles(out) == ("tired",)


def test_excerpts_of_the_data_are_passed_on_only_if_asked_for(tmp_path: Path):
    without = share_run(BASE_NETWORK, tmp_path / "without", styles=[])
    assert (
        not has_differences(without) and (without / "CARD.md").read_bytes() == (BASE_NETWORK / "CARD.md").read_bytes()
    )
    assert "(CARD.md)" in (without / "README.md").read_text()
    assert has_differences(share_run(BASE_NETWORK, tmp_path / "with", styles=[], differences=True))


def test_a_generator_is_passed_on(tmp_path: Path):
    path = make_film_run(tmp_path / "run")
    save_generator(path, FiLMGenerator.init(GENERATOR, key=jax.random.key(2)))
    run = load_run(path)
    shared = load_run(share_run(run, tmp_path / "out"))
    jax.tree.map(np.testing.assert_array_equal, load_generator(run), load_generator(shared))


def test_the_card_has_a_head_that_the_hub_reads(run: Run, shared: Path, tmp_path: Path):
    assert head(shared)["license"] == "cc-by-4.0" and head(shared)["library_name"] == "pfnn_jax"
    other = share_run(run, tmp_path / "other", styles=[], licence='My: "own"\nterms')
    assert (head(other)["license"], head(other)["license_name"]) == ("other", "my-own-terms")
    assert "license" not in head(share_run(run, tmp_path / "none", styles=[]))


def test_the_card_lists_the_styles(run: Run, shared: Path):
    text = (shared / "README.md").read_text()
    assert "| tired | my clip.bvh | 240 | 1.25 | 0.4 | CC BY \\| 4.0 |" in text
    assert run.fingerprint in text and "CARD.md" not in text


def test_existing_folders_and_the_run_itself_are_not_written_over(run: Run, shared: Path, tmp_path: Path):
    assert_refused(lambda: share_run(run, shared), place="output", value="exists")
    for inside in (run.path, run.path / "styles" / "new", run.path / ".." / run.path.name):
        refused = assert_refused(lambda path=inside: share_run(run, path, overwrite=True), place="output")
        assert refused.value == "is in the run itself"
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "one.txt").write_text("dear")
    assert_refused(lambda: share_run(run, tmp_path / "letters", overwrite=True), rule_mentions="another path")
    assert (run.path / "metrics.jsonl").exists()


def test_a_folder_that_another_process_writes_is_not_replaced(run: Run, tmp_path: Path):
    out = share_run(run, tmp_path / "out", styles=["style0"])
    with another_writer(out):
        refused = assert_refused(lambda: share_run(run, out, overwrite=True), file=out, place="run")
    assert "one process at a time" in refused.rule
    assert list_styles(out) == ("style0",)


def test_a_card_that_cannot_be_read_is_named_itself(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """And not the output, which could be written."""
    path, read_bytes = shutil.copytree(run.path, tmp_path / "run"), Path.read_bytes
    (path / CARD).write_text("mine")

    def read(file: Path) -> bytes:
        if file.name == CARD:
            raise PermissionError(errno.EACCES, "Permission denied", str(file))
        return read_bytes(file)

    monkeypatch.setattr(Path, "read_bytes", read)
    with pytest.raises(PermissionError) as refused:
        share_run(load_run(path), tmp_path / "out", styles=[])
    assert refused.value.filename == str(path / CARD) and not (tmp_path / "out").exists()


# The Hub, whose client is replaced by one that knows a local folder


@pytest.fixture
def hub(shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Returns the calls of a client of the Hub that has one run, and a folder that is no run."""
    snapshots = tmp_path / "cache" / "snapshots"
    snapshot = shutil.copytree(shared, snapshots / COMMIT, copy_function=os.symlink)  # as the real one lays them out
    (snapshots / "empty").mkdir()
    calls: list[dict[str, Any]] = []

    def snapshot_download(repository: str, **options: Any) -> str:
        calls.append({"repository": repository, **options})
        if repository == "jane/walker":
            return str(snapshot)
        if repository == "jane/model":
            return str(snapshots / "empty")
        raise FileNotFoundError("there is no such repository\nwith details")

    monkeypatch.setattr("huggingface_hub.snapshot_download", snapshot_download)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    return calls


@pytest.mark.parametrize("address", ["hf://jane/walker", "hf://jane/walker@v1.0", Path("hf://jane/walker")])
def test_a_run_is_loaded_from_the_hub(run: Run, hub: list[dict[str, Any]], tmp_path: Path, address: str | Path):
    loaded = runs.load_run(address)
    assert loaded.path == tmp_path / "home" / "pfnn_jax" / "hub" / f"jane--walker-{COMMIT[:12]}"
    assert_same(run, loaded)
    assert not any(path.is_symlink() for path in loaded.path.rglob("*"))
    assert hub[0]["repository"] == "jane/walker"
    assert hub[0]["revision"] == ("v1.0" if "@" in str(address) else None)


def test_only_files_of_a_run_are_downloaded(shared: Path, hub: list[dict[str, Any]]):
    from huggingface_hub.utils import filter_repo_objects

    hub_run("hf://jane/walker")
    patterns = hub[0]["allow_patterns"]
    files = sorted(path.relative_to(shared).as_posix() for path in shared.rglob("*") if path.is_file())
    assert sorted(filter_repo_objects(files, allow_patterns=patterns)) == files
    others = ["model.bin", "pytorch_model.pt", "data/x.npy", "train_state/x", "setup.py"]
    assert not list(filter_repo_objects(others, allow_patterns=patterns))


def test_styles_learned_on_a_run_of_the_hub_stay(run: Run, hub: list[dict[str, Any]], tmp_path: Path):
    save_style(hub_run("hf://jane/walker"), "mine", load_style(run, "style0"), {})
    shutil.rmtree(tmp_path / "cache" / "snapshots" / COMMIT / "styles" / "tired")
    assert "mine" in list_styles(hub_run("hf://jane/walker"))
    assert not (tmp_path / "cache" / "snapshots" / COMMIT / "styles" / "mine").exists()


@pytest.mark.parametrize("style", ["style0", "style1"])
def test_an_incomplete_download_is_refused_and_not_copied(hub: list[dict[str, Any]], tmp_path: Path, style: str):
    shutil.rmtree(tmp_path / "cache" / "snapshots" / COMMIT / "styles" / style)
    refused = assert_refused(lambda: hub_run("hf://jane/walker"), file="hf://jane/walker", place="styles")
    assert style in str(refused.value) and not (tmp_path / "home").exists()


def test_a_data_folder_that_cannot_be_written_is_named(hub: list[dict[str, Any]], tmp_path: Path):
    (tmp_path / "home").write_text("is a file")
    refused = assert_refused(lambda: hub_run("hf://jane/walker"), place="data folder", rule_mentions="must be writable")
    assert str(refused.file).startswith(str(tmp_path / "home"))


@pytest.mark.parametrize(
    ("address", "place"),
    [
        ("hf://walker", "address"),
        ("hf://a/b/c", "address"),
        ("hf://", "address"),
        ("hf://../..", "address"),
        ("hf://jane/walker@", "address"),
        ("hf://jane/nothing", "download"),
        ("hf://jane/model", "file"),
    ],
)
def test_what_is_no_run_on_the_hub_is_refused(hub: list[dict[str, Any]], tmp_path: Path, address: str, place: str):
    refused = assert_refused(lambda: runs.load_run(address), place=place)
    assert refused.file == address and "\n" not in str(refused)
    assert not (tmp_path / "home").exists()


def test_without_the_extra_the_hub_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    assert_refused(lambda: runs.load_run("hf://jane/walker"), place="package", rule_mentions=".[hub]")


def test_paths_are_no_addresses(tmp_path: Path):
    assert not any(is_hub_address(path) for path in ("base", tmp_path, "hf", "/hf:/x", "run@1", "x/hf:/a/b"))
