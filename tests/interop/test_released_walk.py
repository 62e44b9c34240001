"""The released network of Holden 2017 walks, jogs and turns under this controller as under the authors' loop."""

from __future__ import annotations

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control.loop.rollout import Frames, rollout
from pfnn_jax.control.loop.state import initial_state, straight_row
from pfnn_jax.control.loop.step import Command
from pfnn_jax.inference.predictor import Predictor, evaluate
from pfnn_jax.models.layers.full import BlendedLayer
from pfnn_jax.models.network import Network
from pfnn_jax.models.spline import catmull_rom_basis
from pfnn_jax.motion.features.layout import pfnn2017

LAYOUT = pfnn2017()
NUM_FRAMES, SETTLED = 720, 120
# The loops differ in the velocity that extrapolates the previous pose, and in their first frames.
CLOSE = 0.02
SIZES = (342, 512, 512, 311)


def read(folder: Path, name: str, shape) -> np.ndarray:
    return np.fromfile(folder / f"{name}.bin", "<f4").reshape(shape).astype(np.float64)


@pytest.fixture(scope="module")
def predictor(reference) -> Predictor:
    """Returns the network with four control points recovered from the released slices by least squares."""
    folder = reference / "pfnn"
    slices = sorted(int(file.stem[3:]) for file in folder.glob("W0_*.bin"))
    basis = np.stack([catmull_rom_basis(jnp.float32(2 * np.pi * i / 50)) for i in slices]).astype(np.float64)
    layers = []
    for layer, (inputs, outputs) in enumerate(zip(SIZES[:-1], SIZES[1:], strict=True)):
        weights = np.stack([read(folder, f"W{layer}_{i:03d}", (outputs, inputs)).T for i in slices])
        biases = np.stack([read(folder, f"b{layer}_{i:03d}", outputs) for i in slices])
        points = [np.linalg.lstsq(basis, a.reshape(len(slices), -1))[0] for a in (weights, biases)]
        shaped = points[0].reshape(4, inputs, outputs), points[1]
        layers.append(BlendedLayer(weights=jnp.float32(shaped[0]), biases=jnp.float32(shaped[1])))
    statistics = [jnp.float32(read(folder, name, -1)) for name in ("Xmean", "Xstd", "Ymean", "Ystd")]
    return Predictor(Network((layers[0], layers[1], layers[2])), None, *statistics)


def walk(predictor: Predictor, speed: float, turn: float = 0.0) -> Frames:
    """Walks straight from a standing mean pose and turns by `turn` radians at frame 300."""
    x = predictor.input_mean
    joints = LAYOUT.output_slice("joint_position")
    x = x.at[LAYOUT.input_slice("joint_position")].set(predictor.output_mean[joints])
    yaw = jnp.where(jnp.arange(NUM_FRAMES) < 300, 0.0, turn)
    direction = jnp.stack([jnp.sin(yaw), jnp.cos(yaw)], -1)
    start = initial_state(LAYOUT, straight_row(LAYOUT, x, 0.0), jnp.zeros(()), jnp.zeros(2), jnp.zeros(()))
    commands = Command(velocity=speed * direction, direction=direction)
    return jax.tree.map(np.asarray, rollout(evaluate, predictor, LAYOUT, start, commands))


@pytest.mark.parametrize(
    ("speed", "turn", "name"),
    [(1.5, 0.0, "walk_cubic"), (1.5, np.pi / 2, "walk_turn90"), (3.0, 0.0, "jog5.0"), (4.5, 0.0, "run7.5")],
)
def test_gait_matches_the_authors_rollouts(predictor, reference, speed, turn, name):
    expected = json.loads((reference / "pfnn_rollout_metrics.json").read_text())[name]
    frames = walk(predictor, speed, turn)
    roots, phase = frames.root_positions[SETTLED:], np.unwrap(frames.phase[SETTLED:])
    travelled = np.hypot(*np.diff(roots, axis=0).T).mean() * LAYOUT.fps
    cycle = 2 * np.pi / (np.diff(phase).mean() * LAYOUT.fps)
    assert 100 * travelled == pytest.approx(expected["speed_cm_s"], rel=CLOSE)
    assert cycle == pytest.approx(expected["cycle_s"], rel=CLOSE)
    assert 100 * frames.joint_positions[SETTLED:, 0, 1].mean() == pytest.approx(expected["hip"], rel=CLOSE)
    assert frames.joint_positions[SETTLED:, :, 1].min() > 0.0 and frames.joint_positions[..., 1].max() < 1.5
    heading = np.degrees(frames.root_yaw[-1])
    assert heading == pytest.approx(np.degrees(turn), abs=5.0)
