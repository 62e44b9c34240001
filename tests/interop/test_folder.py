"""The description of an exported folder, and refused exports."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from pfnn_jax.control import calibration
from pfnn_jax.interop.export import reference_loop
from pfnn_jax.interop.export.run import export_run
from pfnn_jax.interop.export.walks import walks_of
from pfnn_jax.interop.released.mason2018 import import_released_cp
from pfnn_jax.interop.released.mason2022 import import_released_lpn
from pfnn_jax.run import load_run
from tests.interop.small_runs import make_run
from tests.raising import assert_refused


def test_description_contains_what_an_engine_needs(runs, tmp_path):
    run = runs("mason2018", "cp")
    export_run(run.path, "bins", tmp_path / "out")
    description = json.loads((tmp_path / "out" / "description.json").read_text())
    assert (description["schema"], description["version"], description["format"]) == ("pfnn_jax.export", 1, "bins")
    columns = [column for block in description["layout"]["outputs"].values() for column in block["columns"]]
    assert sorted(columns) == list(range(run.layout.output_size))
    # Authors' units: half metres, frames, degrees and cycles a frame.
    scales = {name: block["scale"] for name, block in description["layout"]["outputs"].items()}
    assert scales["joint_velocity"] == pytest.approx(30.0) and scales["joint_position"] == 0.5
    assert scales["root_yaw_rate"] == pytest.approx(np.deg2rad(60.0))
    assert scales["phase_change"] == pytest.approx(120 * np.pi)
    assert [style["speed"] for style in description["styles"]] == pytest.approx([1.0, 1.1])
    assert description["loop"]["pose_rate"] == 0.5 and description["skeleton"]["names"] == list(run.skeleton.names)
    assert len(description["normaliser"]["y_std"]) == run.layout.output_size


def test_description_contains_the_speed_to_command(runs, tmp_path, monkeypatch):
    """The speed to command differs from the speed at which the style walks; it is found by trial rollouts."""
    run = runs("mason2018", "cp")

    def measure_walk_speed(setup, params, styles, limits, requested):  # style0 was recorded at 1 m/s, style1 at 1.1
        return requested * np.where(limits < 1.05, 1.0, 2.5)[:, None]

    monkeypatch.setattr(calibration, "_measure_now", measure_walk_speed)
    asked = [1.0, 1.1 * 0.4]
    description = export_run(run.path, "bins", tmp_path / "all")
    assert [style["asked_speed"] for style in description["styles"]] == pytest.approx(asked)
    assert [reference_loop.load(tmp_path / "all", n)[2]["asked_speed"] for n in range(2)] == pytest.approx(asked)
    one = export_run(run.path, "stablehlo", tmp_path / "one", style="style1")
    assert one["styles"][0]["asked_speed"] == one["start"]["asked_speed"] == pytest.approx(asked[1])
    assert one["start"]["speed"] == pytest.approx(1.1)
    mixed = walks_of(run, [{"style0": 0.5, "style1": 0.5}])[0]
    assert mixed.speed == pytest.approx(1.05)
    assert mixed.asked_speed == pytest.approx(np.mean(asked))


def test_run_without_roles_is_exported(runs, tmp_path):
    shutil.copytree(runs("mason2018", "cp").path, tmp_path / "run")
    config = json.loads((tmp_path / "run" / "config.json").read_text())
    config["skeleton"]["roles"] = None
    (tmp_path / "run" / "config.json").write_text(json.dumps(config))
    description = export_run(tmp_path / "run", "bins", tmp_path / "out")
    assert [(style["speed"], style["asked_speed"]) for style in description["styles"]] == [(1.0, 1.0), (1.1, 1.1)]


@pytest.mark.parametrize(
    ("layout", "kind", "import_released", "file"),
    [
        ("mason2018", "cp", import_released_cp, "style0-0.5+style1-0.5_W0.bin"),
        ("mason2022", "film", import_released_lpn, "Style_000_scale1.bin"),
    ],
)
def test_mixture_has_the_same_name_in_every_format(runs, tmp_path, layout, kind, import_released, file):
    run, style = runs(layout, kind), {"style0": 0.5, "style1": 0.5}
    names = [export_run(run.path, f, tmp_path / f, style=style)["styles"][0]["name"] for f in ("bins", "stablehlo")]
    assert names == ["style0:0.5+style1:0.5"] * 2
    assert (tmp_path / "bins" / file).exists()
    assert import_released(tmp_path / "bins", tmp_path / "run").config.styles == ("style0-0.5+style1-0.5",)


@pytest.mark.parametrize("settings", [{"format": "bins"}, {"format": "stablehlo", "film_input": True}])
def test_film_network_without_styles_is_refused(tmp_path, settings):
    run = make_run(tmp_path / "run", "mason2022", "film", 0)
    assert_refused(lambda: export_run(run.path, out=tmp_path / "out", **settings), place="styles", value="none")
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


@pytest.mark.parametrize("out", [".", "..", "inner/.."])
def test_working_directory_is_never_replaced(runs, tmp_path, monkeypatch, out):
    here = tmp_path / "above" / "here"
    here.mkdir(parents=True)
    monkeypatch.chdir(here)
    path = runs("mason2018", "cp").path
    assert_refused(lambda: export_run(path, "bins", out, overwrite=True), place="output")
    assert not list(here.iterdir())


@pytest.mark.parametrize(
    ("name", "kind", "settings", "place", "value"),
    [
        ("mason2022_mann", "film", {"format": "bins"}, "layout", "mason2022_mann with film styles"),
        ("mason2022", "dense", {"format": "bins"}, "layout", "mason2022 with dense styles"),
        ("mason2018", "cp", {"format": "bins", "style": "nobody"}, "style", "nobody"),
        ("mason2018", "cp", {"format": "onnx", "film_input": True}, "film input", "cp"),
        ("mason2018", "cp", {"format": "fbx"}, "format", "fbx"),
    ],
)
def test_impossible_exports_are_refused_and_leave_nothing(runs, tmp_path, name, kind, settings, place, value):
    path = runs(name, kind).path
    assert_refused(lambda: export_run(path, out=tmp_path / "out", **settings), place=place, value=value)
    assert not list(tmp_path.iterdir())


def test_only_an_export_is_replaced(runs, tmp_path):
    path, out = runs("mason2018", "cp").path, tmp_path / "out"
    out.mkdir()
    export_run(path, "bins", out, style="style0")
    assert_refused(lambda: export_run(path, "bins", out), file="out", place="output", rule_mentions="overwrite")
    export_run(path, "bins", out, style="style1", overwrite=True)
    assert (out / "style1_W0.bin").exists() and not (out / "style0_W0.bin").exists()
    assert_refused(lambda: export_run(path, "bins", path, overwrite=True), place="output")
    load_run(path)


def test_files_of_the_2018_demo_need_their_description(runs, tmp_path):
    export_run(runs("mason2018", "cp").path, "bins", tmp_path / "out")
    (tmp_path / "out" / "description.json").unlink()
    error = assert_refused(lambda: import_released_cp(tmp_path / "out", tmp_path / "run"), value="absent")
    assert error.file.endswith("description.json")


def test_styles_are_taken_by_name_or_number(runs, tmp_path):
    run = runs("mason2018", "cp")
    export_run(run.path, "bins", tmp_path / "all")
    (_, by_name, speeds), (_, by_place, same) = (
        reference_loop.load(tmp_path / "all", style) for style in ("style1", 1)
    )
    assert speeds == same and speeds["name"] == "style1"
    np.testing.assert_array_equal(*(f(np.ones(len(run.normaliser.inputs.mean)), 0.3) for f in (by_name, by_place)))
    for style in ("style2", 2):
        with pytest.raises(ValueError, match=f"style {style!r}"):
            reference_loop.load(tmp_path / "all", style)


@pytest.mark.parametrize(
    ("settings", "place", "value"),
    [
        ({"format": "onnx", "opset": 14}, "opset", "14"),
        ({"format": "onnx", "opset": 23}, "opset", "23"),
        ({"format": "stablehlo", "opset": 15}, "opset", "stablehlo"),
        ({"format": "bins", "tables": 5}, "tables", "5"),
        ({"format": "onnx", "tables": 50}, "tables", "onnx"),
        ({"format": "stablehlo", "tables": 4}, "tables", "stablehlo"),
    ],
)
def test_settings_of_other_formats_or_sizes_are_refused(runs, tmp_path, settings, place, value):
    path = runs("mason2018", "cp").path
    assert_refused(lambda: export_run(path, out=tmp_path / "out", **settings), place=place, value=value)
    assert not list(tmp_path.iterdir())


def test_tables_of_a_network_without_global_phase_are_refused(runs, tmp_path):
    path = runs("mason2022", "film").path
    assert_refused(lambda: export_run(path, "bins", tmp_path / "out", tables=50), place="tables", value="mason2022")
    assert not list(tmp_path.iterdir())


def test_four_tables_hold_what_fifty_hold(runs, tmp_path):
    """Fifty tables are the same spline at more phases, so the loop reads the same network from both."""
    run = runs("mason2018", "cp")
    evaluate, sizes = {}, {}
    for tables in (4, 50):
        export_run(run.path, "bins", tmp_path / str(tables), tables=tables)
        evaluate[tables] = reference_loop.load(tmp_path / str(tables), "style1")[1]
        sizes[tables] = sum(file.stat().st_size for file in (tmp_path / str(tables)).glob("*.bin"))
    assert sizes[50] > 10 * sizes[4]
    for phase in np.linspace(0.0, 6.0, 7):
        few, all_tables = (f(np.ones(run.layout.input_size), phase) for f in evaluate.values())
        np.testing.assert_array_equal(few, all_tables)
