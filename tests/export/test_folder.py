"""What an exported folder tells beside its numbers, and what cannot be exported."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.export import reference_loop
from pfnn_jax.export.run import export_run
from pfnn_jax.export.walks import find_walks
from pfnn_jax.runtime.controller import make_controller
from pfnn_jax.runtime.released_cp import import_released_cp
from pfnn_jax.runtime.released_lpn import import_released_lpn
from pfnn_jax.training.run import load_run
from tests.export.small_runs import make_run


def test_description_tells_what_an_engine_needs(runs, tmp_path):
    run = runs("mason2018", "cp")
    export_run(run.path, "bins", tmp_path / "out")
    told = json.loads((tmp_path / "out" / "description.json").read_text())
    assert (told["schema"], told["version"], told["format"]) == ("pfnn_jax.export", 1, "bins")
    columns = [column for block in told["layout"]["outputs"].values() for column in block["columns"]]
    assert sorted(columns) == list(range(run.layout.output_size))
    # Authors' units: half metres, frames, degrees and cycles a frame.
    scales = {name: block["scale"] for name, block in told["layout"]["outputs"].items()}
    assert scales["joint_velocity"] == pytest.approx(30.0) and scales["joint_position"] == 0.5
    assert scales["root_yaw_rate"] == pytest.approx(np.deg2rad(60.0))
    assert scales["phase_change"] == pytest.approx(120 * np.pi)
    assert [style["speed"] for style in told["styles"]] == pytest.approx([1.0, 1.1])
    assert told["loop"]["pose_rate"] == 0.5 and told["skeleton"]["names"] == list(run.skeleton.names)
    assert len(told["normaliser"]["y_std"]) == run.layout.output_size


def test_description_tells_what_to_ask_for_a_walk(runs, tmp_path):
    """The speed that the page asks of the network, which is not the speed at which the style walks."""
    run = runs("mason2018", "cp")
    params = make_controller(run, foot_ik=False, regulated=False).params
    asked = np.asarray(params.speeds * params.shares)
    assert np.abs(asked - np.asarray(params.speeds)).max() > 0.1  # or this would be no test
    told = export_run(run.path, "bins", tmp_path / "all")
    assert [style["asked_speed"] for style in told["styles"]] == pytest.approx(asked)
    assert [reference_loop.Character(tmp_path / "all", n).asked_speed for n in range(2)] == pytest.approx(asked)
    one = export_run(run.path, "stablehlo", tmp_path / "one", style="style1")
    assert one["styles"][0]["asked_speed"] == one["start"]["asked_speed"] == pytest.approx(asked[1])
    assert one["start"]["speed"] == pytest.approx(1.1)
    mixed = find_walks(run, [{"style0": 0.5, "style1": 0.5}])[0]
    assert mixed.speed == pytest.approx(1.05)
    assert mixed.asked_speed == pytest.approx(1.05 * np.mean(params.shares))


@pytest.mark.parametrize(
    ("layout", "kind", "import_released", "file"),
    [
        ("mason2018", "cp", import_released_cp, "style0-0.5+style1-0.5_W0.bin"),
        ("mason2022", "film", import_released_lpn, "Style_000_scale1.bin"),
    ],
)
def test_a_mixture_has_one_name_in_every_format(runs, tmp_path, layout, kind, import_released, file):
    run, style = runs(layout, kind), {"style0": 0.5, "style1": 0.5}
    names = [export_run(run.path, f, tmp_path / f, style=style)["styles"][0]["name"] for f in ("bins", "stablehlo")]
    assert names == ["style0:0.5+style1:0.5"] * 2
    assert (tmp_path / "bins" / file).exists()
    assert import_released(tmp_path / "bins", tmp_path / "run").config.styles == ("style0-0.5+style1-0.5",)


@pytest.mark.parametrize("settings", [{"format": "bins"}, {"format": "stablehlo", "film_input": True}])
def test_a_film_network_without_styles_is_not_exported(tmp_path, settings):
    run = make_run(tmp_path / "run", "mason2022", "film", 0)
    with pytest.raises(InputError, match="styles: none; a FiLM run needs at least one style to move"):
        export_run(run.path, out=tmp_path / "out", **settings)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


@pytest.mark.parametrize("out", [".", "..", "inner/.."])
def test_the_folder_that_a_command_runs_in_is_not_replaced(runs, tmp_path, monkeypatch, out):
    here = tmp_path / "above" / "here"
    here.mkdir(parents=True)
    monkeypatch.chdir(here)
    with pytest.raises(InputError, match="output: holds the working folder; must be a folder of its own"):
        export_run(runs("mason2018", "cp").path, "bins", out, overwrite=True)
    assert not list(here.iterdir())


@pytest.mark.parametrize(
    ("name", "kind", "settings", "said"),
    [
        ("mason2022_mann", "film", {"format": "bins"}, "mason2022_mann with film styles; only pfnn2017, mason2018"),
        ("mason2022", "dense", {"format": "bins"}, "knows Films alone"),
        ("mason2018", "cp", {"format": "bins", "style": "nobody"}, "nobody; must be one of style0, style1"),
        ("mason2018", "cp", {"format": "onnx", "film_input": True}, "only a Film can be an input"),
        ("mason2018", "cp", {"format": "fbx"}, "fbx; must be onnx, stablehlo or bins"),
    ],
)
def test_what_cannot_be_is_said(runs, tmp_path, name, kind, settings, said):
    with pytest.raises(InputError, match=said):
        export_run(runs(name, kind).path, out=tmp_path / "out", **settings)
    assert not list(tmp_path.iterdir())


def test_only_an_export_is_replaced(runs, tmp_path):
    path, out = runs("mason2018", "cp").path, tmp_path / "out"
    out.mkdir()
    export_run(path, "bins", out, style="style0")
    with pytest.raises(InputError, match="--overwrite"):
        export_run(path, "bins", out)
    export_run(path, "bins", out, style="style1", overwrite=True)
    assert (out / "style1_W0.bin").exists() and not (out / "style0_W0.bin").exists()
    with pytest.raises(InputError, match="is no export"):
        export_run(path, "bins", path, overwrite=True)
    load_run(path)


def test_files_of_the_2018_demo_need_their_description(runs, tmp_path):
    export_run(runs("mason2018", "cp").path, "bins", tmp_path / "out")
    (tmp_path / "out" / "description.json").unlink()
    with pytest.raises(InputError, match="they do not name the joints"):
        import_released_cp(tmp_path / "out", tmp_path / "run")
