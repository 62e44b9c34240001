"""Exports: their outputs equal JAX, they import as runs, and the NumPy loop equals the controller's loop."""

from __future__ import annotations

import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control.controller import Controller, make_controller, rollout_commands
from pfnn_jax.control.loop.state import initial_state
from pfnn_jax.control.loop.step import Command
from pfnn_jax.inference.predictor import evaluate, make_predictor
from pfnn_jax.inference.rows import predict_rows
from pfnn_jax.inference.style_choice import file_stem
from pfnn_jax.interop.export import reference_loop
from pfnn_jax.interop.export.batch import batch_function, relative_error, sample_rows
from pfnn_jax.interop.export.bins import write_bins
from pfnn_jax.interop.export.onnx import TOLERANCE
from pfnn_jax.interop.export.run import export_run
from pfnn_jax.interop.released.holden2017 import import_released_pfnn
from pfnn_jax.interop.released.mason2018 import import_released_cp
from pfnn_jax.interop.released.mason2022 import import_released_lpn
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.models.style import init_style
from pfnn_jax.motion.units import authors2018, convert_columns
from pfnn_jax.run import Run, load_run, save_style
from pfnn_jax.run_config import style_note
from tests.raising import assert_refused

FLOAT32 = 2e-5  # of an output's largest value: tables are rounded, inverted by least squares and summed again
LOOP = 1e-4  # metres after 300 frames; float32 against float64 on real networks gives 2e-6
FRAMES = 300
pytestmark = pytest.mark.usefixtures("recorded_walks")
IMPORTS = {"pfnn2017": import_released_pfnn, "mason2018": import_released_cp, "mason2022": import_released_lpn}


@pytest.fixture(scope="module")
def controllers(runs):
    """Controllers of the published loop, by layout and kind of style: mixtures need no other one."""

    @cache
    def make(name: str, kind: str) -> Controller:
        return make_controller(runs(name, kind), foot_ik=False, tracking=None)

    return make


def film_numbers(run, style) -> np.ndarray:
    """Returns the FiLM parameters [4H] of a style."""
    film = make_predictor(run, style).style
    assert isinstance(film, FiLMStyle)
    return np.asarray(film.to_vector())


@pytest.mark.parametrize(
    ("name", "kind"),
    [("mason2018", "cp"), ("mason2018", "cp_output"), ("mason2022", "film"), ("mason2022_pfnn", "one_hot")],
)
def test_batch_function_equals_the_predictor(runs, name, kind):
    run = runs(name, kind)
    x, phase = sample_rows(run.normaliser, run.layout, 64)
    predictor = make_predictor(run, "style1")
    expected = np.asarray(jax.vmap(evaluate, (None, 0, 0))(predictor, jnp.asarray(x), jnp.asarray(phase)))
    assert relative_error(np.asarray(batch_function(predictor)(x, phase)), expected) < TOLERANCE


@pytest.mark.parametrize(
    ("name", "kind", "style"),
    [
        ("pfnn2017", "cp", None),
        ("pfnn2017", "diagonal", "style1"),
        ("pfnn2017", "one_hot", {"style0": 0.25, "style1": 0.75}),
        ("mason2018", "cp", None),
        ("mason2018", "cp", {"style0": 0.5, "style1": 0.5}),
        ("mason2018", "full", "style0"),
        ("mason2018", "cp_output", "style1"),
        ("mason2022", "film", None),
        ("mason2022", "film", {"style0": 0.5, "style1": 0.5}),
    ],
)
def test_bins_round_trip_with_equal_predictions(runs, tmp_path, name, kind, style):
    run = runs(name, kind)
    description = export_run(run.path, "bins", tmp_path / "bins", style=style)
    back = IMPORTS[name](tmp_path / "bins", tmp_path / "run")
    assert back.config.pretrain["source"].endswith(" in bins"), "its folder alone, without those above it"
    notes = [style_note(back.path, imported)["info"]["source"] for imported in back.config.styles]
    assert all(source.endswith(" in bins") for source in notes)
    np.testing.assert_array_equal(back.skeleton.offsets, run.skeleton.offsets)
    x, phase = sample_rows(run.normaliser, run.layout, 32)
    separate = [file_stem(entry["name"]) for entry in description["styles"] if entry["files"]]
    assert separate == list(back.config.styles)
    pairs = [(style, separate[0] if separate else None)] if style else [(entry, entry) for entry in separate]
    for own, theirs in pairs or [(None, None)]:
        expected, found = predict_rows(run, x, phase, own), predict_rows(back, x, phase, theirs)
        assert relative_error(found, expected) < FLOAT32


def commands(speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns velocities and facings [T] as complex numbers: straight, a corner, standing, and walking again."""
    facing = np.exp(1j * np.where(np.arange(FRAMES) < 120, 0.0, 1.2))
    return np.where((np.arange(FRAMES) // 40) == 5, 0.0, speed * facing), facing


def walk(run: Run, controller: Controller, choice: str | dict[str, float], description: dict) -> np.ndarray:
    """Returns world joints [T, J, 3] of the controller's loop under `commands`, from the exported start."""
    start, layout = description["start"], run.layout
    x = np.array(start["x"])
    if layout.name == "mason2018":  # the files are in the authors' units
        columns, factors = convert_columns(authors2018(layout.num_joints), layout, "inputs")
        x = x[columns] * factors
    x, zero = jnp.asarray(x, jnp.float32), jnp.zeros((), jnp.float32)
    motion = initial_state(layout, x, jnp.asarray(start["phase"], jnp.float32), jnp.zeros(2, jnp.float32), zero)
    style = jnp.asarray(controller.style_weights(choice if isinstance(choice, str) else {**choice}))
    velocities, directions = (
        jnp.asarray(np.stack([np.imag(v), np.real(v)], -1), jnp.float32) for v in commands(start["asked_speed"])
    )
    state = replace(controller.start(), motion=motion, style=style)
    with jax.default_matmul_precision("highest"):
        asked = Command(velocity=velocities, direction=directions)
        return np.asarray(rollout_commands(controller.setup, controller.params, state, asked)[1].motion.joint_positions)


def reference_walk(folder: Path) -> np.ndarray:
    info, evaluate, speeds = reference_loop.load(folder)
    character, joints = reference_loop.PublishedLoop(info, evaluate), []
    for velocity, facing in zip(*commands(speeds["asked_speed"]), strict=True):
        character.step(velocity, facing)
        joints.append(character.pose["joint_position"])
    return np.stack(joints)


@pytest.mark.parametrize(
    ("name", "kind", "choice"),
    [
        ("pfnn2017", "cp", "style1"),
        ("pfnn2017", "cp", {"style0": 0.4, "style1": 0.6}),  # added into the tables
        ("mason2018", "cp", "style1"),
        ("mason2018", "cp", {"style0": 1.6, "style1": -0.6}),  # in separate files
        ("mason2018", "cp_output", "style1"),
        ("mason2022", "film", "style1"),
        ("mason2022", "film", {"style0": 0.4, "style1": 0.6}),
    ],
)
def test_reference_loop_equals_the_controller_loop(runs, controllers, tmp_path, name, kind, choice):
    """Without command tracking and foot locks, in a style and in a mixture of two."""
    run = runs(name, kind)
    description = export_run(run.path, "bins", tmp_path / "bins", style=choice)
    expected = walk(run, controllers(name, kind), choice, description)
    assert np.isfinite(expected).all() and np.ptp(expected, axis=0).max() > 10 * LOOP
    np.testing.assert_allclose(reference_walk(tmp_path / "bins"), expected, atol=LOOP)


@pytest.mark.parametrize("directory", ["lpn", "pfnn"])
def test_authors_files_round_trip(reference, tmp_path, directory):
    imported = {"lpn": import_released_lpn, "pfnn": import_released_pfnn}[directory](
        reference / directory, tmp_path / "run"
    )
    folder = tmp_path / "bins"
    folder.mkdir()
    write_bins(folder, imported, tables=50)
    for file in sorted((reference / directory).glob("*.bin")):
        if file.stem in ("Walk_Velocities", "Run_Velocities"):  # settings of their demo, not parameters of the network
            continue
        if directory == "lpn" or file.stem[0] in "XY":
            assert (folder / file.name).read_bytes() == file.read_bytes(), file.name
        else:  # control points were rounded once, and tables again: a few ulp of the array's larger values
            old, new = (np.fromfile(path / file.name, "<f4") for path in (file.parent, folder))
            assert np.abs(old - new).max() <= 5e-6 * np.sqrt(np.mean(old**2)), file.name


@pytest.mark.parametrize(
    ("name", "kind", "film_input"),
    [("mason2018", "cp", False), ("mason2018", "cp_output", False), ("mason2022", "film", True)],
)
def test_onnx_equals_jax(runs, tmp_path, name, kind, film_input):
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("jax2onnx")
    run, style = runs(name, kind), {"style0": 0.5, "style1": 0.5}
    description = export_run(run.path, "onnx", tmp_path / "onnx", style=style, film_input=film_input)
    assert description["network"]["relative_error"] < TOLERANCE
    session = onnxruntime.InferenceSession(tmp_path / "onnx" / description["network"]["file"])
    assert [i.name for i in session.get_inputs()] == [i["name"] for i in description["network"]["inputs"]]
    x, phase = sample_rows(run.normaliser, run.layout, 1, seed=1)
    rows = {"x": x, "phase": phase}
    if film_input:
        rows["style"] = film_numbers(run, "style0")[None]
        np.testing.assert_array_equal(
            np.fromfile(tmp_path / "onnx" / description["styles"][0]["file"], "<f4"),
            film_numbers(run, style),
        )
        style = "style0"
    expected = predict_rows(run, x, phase, style)
    assert np.abs(session.run(["y"], rows)[0] - expected).max() < 1e-4 * np.abs(expected).max()


def test_onnx_that_differs_from_jax_is_refused(runs, tmp_path, monkeypatch):
    pytest.importorskip("jax2onnx")
    monkeypatch.setattr("pfnn_jax.interop.export.onnx.TOLERANCE", 0.0)
    path = runs("mason2018", "cp").path
    assert_refused(lambda: export_run(path, "onnx", tmp_path / "onnx"), place="relative error")
    assert not list(tmp_path.iterdir())


def test_stablehlo_round_trips_bit_for_bit(runs, tmp_path):
    run = runs("mason2022", "film")
    description = export_run(run.path, "stablehlo", tmp_path / "out", style="style0")
    program = jax.export.deserialize(bytearray((tmp_path / "out" / description["network"]["file"]).read_bytes()))
    assert description["network"]["calling_convention_version"] == program.calling_convention_version
    for count in (1, 2, 7):
        x, phase = sample_rows(run.normaliser, run.layout, count, seed=2)
        with jax.default_matmul_precision("highest"):
            expected = jax.jit(batch_function(make_predictor(run, "style0")))(x, phase)
        if count == 1:  # compiled for one row, which is computed in another way than several
            np.testing.assert_allclose(program.call(x, phase), expected, rtol=FLOAT32)
        else:
            np.testing.assert_array_equal(program.call(x, phase), expected)


def test_mixture_of_an_adapter_and_an_output_adapter_is_added_into_the_tables(runs, tmp_path):
    """As a style of pretraining and one of `few-shot`."""
    name = "mason2018"
    shutil.copytree(runs(name, "cp").path, tmp_path / "run")
    learned = init_style(AdapterConfig("cp_output", 3), runs(name, "cp").config.network, key=jax.random.key(0))
    save_style(tmp_path / "run", "learned", learned, {"speed": 1.0})
    run, choice = load_run(tmp_path / "run"), {"style0": 0.4, "learned": 0.6}
    description = export_run(run.path, "bins", tmp_path / "bins", style=choice)
    assert [(entry["kind"], entry["files"]) for entry in description["styles"]] == [("cp+cp_output", {})]
    x, phase = sample_rows(run.normaliser, run.layout, 32)
    back = IMPORTS[name](tmp_path / "bins", tmp_path / "again")
    assert relative_error(predict_rows(back, x, phase, None), predict_rows(run, x, phase, choice)) < FLOAT32
