"""The loop that engines port: the same walk from every format, the walk of the controller, and the axes of engines."""

from __future__ import annotations

import ast
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control.controller import make_controller, rollout_commands
from pfnn_jax.control.loop.step import Command
from pfnn_jax.inference.predictor import make_predictor
from pfnn_jax.interop.export import reference_loop
from pfnn_jax.interop.export.batch import batch_function, sample_rows
from pfnn_jax.interop.export.onnx import OPERATORS, OPSETS, write_onnx
from pfnn_jax.interop.export.reference_loop import Character, handedness
from pfnn_jax.interop.export.reference_loop.rotations import rotate
from pfnn_jax.interop.export.run import export_run
from pfnn_jax.motion.kinematics import quat_from_axis_angle, quat_multiply

FRAMES = 300
SAME = 1e-4  # metres between formats, and between float64 NumPy and float32 JAX; measured: 3e-5
KNEES = 5e-4  # metres: the knee of a stretched leg moves with the square root of the rounding of its ends
ALL_KINDS = (
    ("pfnn2017", "cp"),
    *(("mason2018", kind) for kind in ("cp", "diagonal", "full", "one_hot", "bias", "dense")),
    *(("mason2022", "film"), ("mason2022_mann", "film"), ("mason2022_pfnn", "one_hot")),
)


def commands(speed: float, stop: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Returns velocities and facings [T], complex: a start, two corners, a change of speed, and a stop on request."""
    frame = np.arange(FRAMES)
    facing = np.exp(1j * np.select([frame < 80, frame < 200], [0.0, 1.2], -0.6))
    speeds = np.where(frame < 10, 0.0, speed) * np.where(frame // 60 == 2, 1.3, 1.0)
    return np.where(stop & (frame > 210), 0.0, speeds) * facing, facing


def walk(character: Character, stop: bool = False) -> np.ndarray:
    """Returns the joints [T, J, 3] of a character under `commands`."""
    joints = []
    for velocity, facing in zip(*commands(character.speed, stop), strict=True):
        character.step(velocity, facing)
        joints.append(character.joints)
    return np.stack(joints)


@pytest.mark.parametrize(("name", "kind"), [("mason2018", "cp"), ("mason2022", "film"), ("pfnn2017", "cp")])
def test_the_character_walks_as_the_controller_does(runs, tmp_path, name, kind):
    """It starts, turns, changes its speed and stops with command tracking, locked feet and rigid bones."""
    run = runs(name, kind)
    export_run(run.path, "bins", tmp_path / "out", style="style1")
    controller, character = make_controller(run, ("style1",)), Character(tmp_path / "out")
    velocities, directions = (
        jnp.asarray(np.stack([np.imag(v), np.real(v)], -1), jnp.float32) for v in commands(character.speed, stop=True)
    )
    with jax.default_matmul_precision("highest"):
        start = controller.start()
        states = rollout_commands(
            controller.setup, controller.params, start, Command(velocity=velocities, direction=directions)
        )[1]
    found = walk(character, stop=True)
    assert np.ptp(found, axis=0).max() > 100 * SAME
    knees = character.body.legs[:, 1]
    np.testing.assert_allclose(np.delete(found, knees, 1), np.delete(states.joints, knees, 1), atol=SAME)
    np.testing.assert_allclose(found[:, knees], states.joints[:, knees], atol=KNEES)
    same = np.abs(np.sum(character.rotations * np.asarray(states.world_rotations[-1]), axis=-1))
    np.testing.assert_allclose(same, 1.0, atol=SAME)


@pytest.mark.parametrize(("name", "kind", "film_input"), [("mason2018", "cp", False), ("mason2022", "film", True)])
def test_every_format_walks_the_same_way(runs, tmp_path, name, kind, film_input):
    """Also with a runtime of the engine's own, which is given as a function."""
    pytest.importorskip("onnxruntime")
    run, walks = runs(name, kind), {}
    for format in ("bins", "onnx", "stablehlo"):
        settings = {} if format == "bins" else {"film_input": film_input}
        export_run(run.path, format, tmp_path / format, style="style1", **settings)
        walks[format] = walk(Character(tmp_path / format))
    _, evaluate, _ = reference_loop.load(tmp_path / "onnx")
    assert np.ptp(walks["bins"], axis=0).max() > 100 * SAME
    np.testing.assert_allclose(walks["onnx"], walks["bins"], atol=SAME)
    np.testing.assert_allclose(walks["stablehlo"], walks["bins"], atol=SAME)
    np.testing.assert_array_equal(walk(Character(tmp_path / "onnx", evaluate=evaluate)), walks["onnx"])


def test_local_rotations_give_the_joints_on_rigid_bones(runs, tmp_path):
    run = runs("mason2022", "film")
    export_run(run.path, "bins", tmp_path / "out", style="style1")
    character = Character(tmp_path / "out")
    walk(character)
    parents, offsets = run.skeleton.parents, run.skeleton.offsets
    world, joints = [character.local_rotations[0]], [character.hips]
    for joint, parent in enumerate(parents[1:], 1):
        world.append(quat_multiply(world[parent], character.local_rotations[joint]))
        joints.append(joints[parent] + rotate(world[parent], offsets[joint]))
    np.testing.assert_allclose(joints, character.joints, atol=1e-9)


@pytest.mark.parametrize("engine", ["unity", "unreal"])
def test_positions_of_an_engine_are_those_of_its_rotations(engine):
    """A chain of bones turned and then mapped is the chain of mapped bones, turned by the mapped rotations."""
    positions, rotations = (getattr(handedness, f"{engine}_{part}") for part in ("positions", "rotations"))
    random = np.random.default_rng(3)
    turns = quat_from_axis_angle(random.normal(size=(5, 3)), random.uniform(0.0, 3.0, 5))
    offsets = random.normal(size=(5, 3))
    ours, theirs, at, there = np.array([1.0, 0, 0, 0]), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3)
    for turn, offset in zip(turns, offsets, strict=True):
        ours, theirs = quat_multiply(ours, turn), quat_multiply(theirs, np.roll(rotations(turn), 1))
        at, there = at + rotate(ours, offset), there + rotate(theirs, positions(offset))
    np.testing.assert_allclose(positions(at), there, atol=1e-9)


def test_engines_face_and_lean_as_documented():
    forward, up, left = np.eye(3)[[2, 1, 0]]
    np.testing.assert_array_equal(handedness.unity_positions([forward, up, left]), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    unreal = handedness.unreal_positions([forward, up, left]) / 100.0
    np.testing.assert_array_equal(unreal, [[1, 0, 0], [0, 0, 1], [0, -1, 0]])


def test_the_exported_copy_needs_numpy_alone(runs, tmp_path):
    export_run(runs("mason2018", "cp").path, "bins", tmp_path / "out")
    copied = sorted((tmp_path / "out" / "reference_loop").glob("*.py"))
    source = sorted(Path(reference_loop.__file__).parent.glob("*.py"))
    assert [file.read_bytes() for file in copied] == [file.read_bytes() for file in source]
    for file in copied:
        assert len(file.read_text(encoding="utf-8").splitlines()) <= 250
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Import):
                assert {alias.name for alias in node.names} <= {"json", "math", "numpy"}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 1 or node.module == "pathlib"


def test_a_skeleton_without_legs_has_no_character(runs, tmp_path, monkeypatch):
    monkeypatch.setattr("pfnn_jax.interop.export.description.describe_controller", lambda run: None)
    export_run(runs("mason2018", "cp").path, "bins", tmp_path / "out")
    with pytest.raises(ValueError, match="humanoid map"):
        Character(tmp_path / "out")


@pytest.mark.parametrize(("name", "kind"), ALL_KINDS)
def test_every_network_has_documented_operators_in_every_opset(runs, tmp_path, name, kind):
    """That the numbers do not change is checked by the export itself."""
    pytest.importorskip("jax2onnx")
    onnx = pytest.importorskip("onnx")
    run = runs(name, kind)
    x, phase = sample_rows(run.normaliser, run.layout, 16)
    function, rows = batch_function(jax.tree.map(jnp.asarray, make_predictor(run, "style1"))), {"x": x, "phase": phase}
    for opset in (OPSETS[0], OPSETS[-1]):
        write_onnx(tmp_path / "network.onnx", function, rows, opset)
        model = onnx.load(tmp_path / "network.onnx")
        assert [entry.version for entry in model.opset_import] == [opset]
        assert {node.op_type for node in model.graph.node} <= OPERATORS


def test_operators_are_documented():
    page = (Path(__file__).resolve().parents[2] / "docs" / "engines.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in page for name in OPERATORS)
