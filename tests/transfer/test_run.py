"""The run directory of style transfer: what is saved comes back, and what does not fit is refused."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.io import checkpoint
from pfnn_jax.models.convolution import Convolution
from pfnn_jax.motion.features.normaliser import Statistics
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.run import load_run
from pfnn_jax.run_config import load_config
from pfnn_jax.transfer.autoencoder import init_autoencoder
from pfnn_jax.transfer.config import AutoencoderConfig
from pfnn_jax.transfer.layout import HOLDEN2016, HOLDEN2017, ClipLayout
from pfnn_jax.transfer.run import (
    BASE_AUTOENCODER,
    TransferRun,
    create_transfer_run,
    list_transformations,
    load_transfer_config,
    load_transfer_run,
    load_transformation,
    save_transformation,
    transformation_note,
)
from pfnn_jax.workflows.base import BASE_NETWORK
from tests.raising import assert_refused

SMALL = AutoencoderConfig(filters=4, width=3)


def make_run(
    path: Path, seed: int = 0, layout: ClipLayout = HOLDEN2017, sizes: AutoencoderConfig = SMALL, **options: Any
) -> TransferRun:
    autoencoder = init_autoencoder(sizes, layout.size, key=jax.random.key(seed))
    statistics = Statistics(np.full(layout.size, 0.5, np.float32), np.full(layout.size, 2.0, np.float32))
    return create_transfer_run(path, layout, synthetic_skeleton(), statistics, autoencoder, {"steps": 3}, **options)


def make_style(seed: int = 0, width: int = 3) -> dict[str, Any]:
    layer = Convolution.init(width, 2, 4, key=jax.random.key(seed))
    return {"network": layer, "gram": jnp.full((4, 4), seed, jnp.float32)}


def assert_equal(a: Any, b: Any) -> None:
    assert jax.tree.structure(a) == jax.tree.structure(b)
    jax.tree.map(np.testing.assert_array_equal, a, b)


def change_config(path: Path, **changes: Any) -> None:
    data = json.loads((path / "config.json").read_text())
    (path / "config.json").write_text(json.dumps({**data, **changes}))


@pytest.mark.parametrize("layout", [HOLDEN2017, HOLDEN2016], ids=lambda layout: layout.name)
@pytest.mark.parametrize("tied", [True, False], ids=("tied", "untied"))
def test_a_run_rebuilds_itself(tmp_path: Path, layout: ClipLayout, tied: bool):
    made = make_run(tmp_path / "run", 3, layout, AutoencoderConfig(4, 3, tied))
    run = load_transfer_run(tmp_path / "run", layout.name)
    assert run.config.autoencoder == made.config.autoencoder and run.config.training == {"steps": 3}
    assert run.layout == layout and run.fingerprint == made.fingerprint
    assert run.skeleton.names == synthetic_skeleton().names and run.skeleton.humanoid is not None
    assert_equal(run.autoencoder, made.autoencoder)
    np.testing.assert_array_equal(run.statistics.mean, made.statistics.mean)
    np.testing.assert_array_equal(run.statistics.std, made.statistics.std)
    assert set(run.config.versions) == {"pfnn_jax", "jax"}


def test_a_style_round_trips(tmp_path: Path):
    run = make_run(tmp_path / "run")
    assert list_transformations(run.path) == ()
    save_transformation(run, "angry", make_style(1), {"loss": 0.5})
    save_transformation(run, "old", make_style(2), {})
    assert list_transformations(run.path) == ("angry", "old")
    loaded = load_transfer_run(run.path)
    assert_equal(load_transformation(loaded, "angry", make_style()), make_style(1))
    assert transformation_note(run.path, "angry")["info"] == {"loss": 0.5}


def test_saving_a_style_touches_only_its_folder(tmp_path: Path):
    run = make_run(tmp_path / "run")
    before = {path: path.read_bytes() for path in run.path.rglob("*") if path.is_file()}
    save_transformation(run, "angry", make_style(1), {})
    assert all(path.read_bytes() == data for path, data in before.items())


def test_a_style_fits_a_copy_of_its_run_and_no_other_autoencoder(tmp_path: Path):
    first, other = make_run(tmp_path / "first", 1), make_run(tmp_path / "other", 2)
    folder = save_transformation(first, "angry", make_style(1), {})
    shutil.copytree(first.path, tmp_path / "copy")
    assert_equal(load_transformation(load_transfer_run(tmp_path / "copy"), "angry", make_style()), make_style(1))
    shutil.copytree(folder, other.path / "styles" / "angry")
    assert_refused(
        lambda: load_transformation(other, "angry", make_style()),
        file="styles/angry",
        place="autoencoder",
        value=first.fingerprint[:12],
        rule_mentions=other.fingerprint[:12],
    )


def test_a_style_of_other_shapes_is_refused(tmp_path: Path):
    run = make_run(tmp_path / "run")
    save_transformation(run, "angry", make_style(1, width=5), {})
    assert_refused(
        lambda: load_transformation(run, "angry", make_style()),
        file="angry",
        place="parameter network.filters",
        value="float32 [5, 2, 4]",
    )


def test_the_run_in_the_package_is_never_written_to():
    run = load_transfer_run(BASE_AUTOENCODER)
    before = sorted(BASE_AUTOENCODER.rglob("*"))
    assert_refused(
        lambda: save_transformation(run, "angry", make_style(), {}), place="run", value="is part of the package"
    )
    assert sorted(BASE_AUTOENCODER.rglob("*")) == before


def test_an_unknown_style_lists_the_known_ones(tmp_path: Path):
    run = make_run(tmp_path / "run")
    assert_refused(lambda: load_transformation(run, "old", make_style()), place="style", rule_mentions="no styles yet")
    save_transformation(run, "angry", make_style(1), {})
    assert_refused(lambda: load_transformation(run, "old", make_style()), place="style", rule_mentions="angry")


def test_existing_output_is_refused_without_overwrite(tmp_path: Path):
    run = make_run(tmp_path / "run")
    save_transformation(run, "angry", make_style(1), {})
    assert_refused(lambda: make_run(tmp_path / "run", 1), file="run", place="output", value="exists")
    assert_refused(lambda: save_transformation(run, "angry", make_style(2), {}), file="angry", value="exists")
    save_transformation(run, "angry", make_style(2), {}, overwrite=True)
    assert_equal(load_transformation(run, "angry", make_style()), make_style(2))
    make_run(tmp_path / "run", 1, overwrite=True)
    assert list_transformations(run.path) == ()


def test_only_a_run_of_style_transfer_is_overwritten(tmp_path: Path):
    shutil.copytree(BASE_NETWORK, tmp_path / "network")
    value = "exists and is a controller run"
    assert_refused(lambda: make_run(tmp_path / "network", overwrite=True), file="network", place="output", value=value)
    assert load_run(tmp_path / "network").config.layout == "mason2018"
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "one.txt").write_text("dear")
    value = "exists but is not a run directory"
    assert_refused(lambda: make_run(tmp_path / "letters", overwrite=True), place="output", value=value)


def test_loaders_of_the_two_kinds_of_run_refuse_each_others(tmp_path: Path):
    run = make_run(tmp_path / "run")
    for load in (load_run, load_config):
        assert_refused(
            lambda load=load: load(run.path),
            file="config.json",
            place="kind",
            value="transfer",
            rule_mentions="`transfer --run` reads",
        )
    for load in (load_transfer_run, load_transfer_config):
        assert_refused(
            lambda load=load: load(BASE_NETWORK),
            file="config.json",
            place="kind",
            value="controller",
            rule_mentions="`few-shot`, `generate` and `play` read",
        )


def test_a_run_of_another_layout_is_refused(tmp_path: Path):
    run = make_run(tmp_path / "run")
    assert_refused(lambda: load_transfer_run(run.path, "holden2016"), place="layout", value="holden2017")


@pytest.mark.parametrize(
    ("changes", "place", "value"),
    [
        ({"layout": "holden2030"}, "entries", "must be one of holden2017, holden2016"),
        ({"autoencoder": {"filters": 4, "width": 4}}, "entries", "width must be odd"),
        ({"autoencoder": {"colour": 4}}, "entries", "colour"),
        ({"colour": "red"}, "entries", "colour"),
        ({"kind": "sculpture"}, "kind", "sculpture"),
        ({"skeleton": {"names": []}}, "skeleton", "no parents"),
    ],
)
def test_a_wrong_configuration_names_the_file_and_the_rule(
    tmp_path: Path, changes: dict[str, Any], place: str, value: str
):
    run = make_run(tmp_path / "run")
    change_config(run.path, **changes)
    error = assert_refused(lambda: load_transfer_run(run.path), file="config.json", place=place)
    assert value in str(error.value)


def cut_short(path: Path) -> None:
    largest = max((path / "autoencoder").rglob("*"), key=lambda file: file.stat().st_size * file.is_file())
    largest.write_bytes(largest.read_bytes()[:-1])


@pytest.mark.parametrize(
    ("damage", "file", "place"),
    [
        (lambda path: (path / "config.json").unlink(), "config.json", "file"),
        (lambda path: (path / "config.json").write_text("{"), "config.json", "line 1"),
        (lambda path: (path / "config.json").write_text('{"kind": "transfer"}'), "config.json", "entry"),
        (lambda path: (path / "normaliser" / "x_std.npy").unlink(), "x_std.npy", "array"),
        (lambda path: np.save(path / "normaliser" / "x_mean.npy", np.ones(5)), "x_std.npy", "array"),
        (lambda path: np.save(path / "normaliser" / "x_std.npy", np.zeros(66)), "x_std.npy", "array"),
        (lambda path: shutil.rmtree(path / "autoencoder"), "files.json", "file"),
        (cut_short, "autoencoder", None),
        (lambda path: change_config(path, autoencoder={"filters": 5, "width": 3}), "autoencoder", None),
        (lambda path: change_config(path, layout="holden2016"), "normaliser", "columns"),
    ],
)
def test_a_damaged_run_is_refused(tmp_path: Path, damage: Callable[[Path], Any], file: str, place: str | None):
    run = make_run(tmp_path / "run")
    damage(run.path)
    assert_refused(lambda: load_transfer_run(run.path), file=file, place=place)


def test_a_run_killed_half_way_through_saving_stays_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    class Killed(BaseException):
        pass

    def kill(*args: Any, **kwargs: Any) -> None:
        raise Killed

    run = make_run(tmp_path / "run", 1)
    save_transformation(run, "angry", make_style(1), {})
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint.ocp, "save", kill)
        for save in (
            lambda: make_run(tmp_path / "run", 2, overwrite=True),
            lambda: save_transformation(run, "angry", make_style(2), {}, overwrite=True),
            lambda: make_run(tmp_path / "new"),
        ):
            with pytest.raises(Killed):
                save()
    loaded = load_transfer_run(tmp_path / "run")
    assert loaded.fingerprint == run.fingerprint
    assert_equal(load_transformation(loaded, "angry", make_style()), make_style(1))
    assert not (tmp_path / "new").exists()


def test_a_run_moved_aside_by_a_kill_is_found(tmp_path: Path):
    """A kill between the two renames of an exchange leaves the last run under `.run.old`."""
    run = make_run(tmp_path / "run", 1)
    run.path.rename(tmp_path / ".run.old")
    assert load_transfer_run(tmp_path / "run").fingerprint == run.fingerprint
