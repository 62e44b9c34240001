"""Walkers with known motion, which replace networks in the tests of the controller."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.motion.features.layout import LAYOUTS, FrameLayout
from pfnn_jax.motion.ground import to_world

JOINTS = 5
LAYOUT = {name: LAYOUTS[name](JOINTS) for name in ("mason2018", "pfnn2017")}

# A walk: m/s, rad/s about +Y, rad/s of phase.
WALK = {"speed": 1.2, "turn_rate": 0.6, "cadence": 6.0}

_REST = np.stack([np.linspace(-0.2, 0.3, JOINTS), np.linspace(0.9, 0.1, JOINTS), np.linspace(0.1, -0.2, JOINTS)], -1)
_SWING = np.stack([np.linspace(0.02, 0.1, JOINTS), np.linspace(0.01, 0.05, JOINTS), np.linspace(0.1, 0.4, JOINTS)], -1)
_LAG = np.arange(3 * JOINTS).reshape(JOINTS, 3)


def pose(phase):
    """Returns joint positions [J, 3] metres relative to the root at a phase []; `jnp` or `np` by its type."""
    numpy = np if isinstance(phase, float | np.floating) else jnp
    return _REST.astype(np.float32) + _SWING.astype(np.float32) * numpy.sin(phase + _LAG.astype(np.float32))


def write_output(layout: FrameLayout, blocks: dict) -> jnp.ndarray:
    """Returns y from named blocks in metres, metres and radians per second; blocks not given are zero."""
    rate = layout.time_unit / layout.length_unit
    units = {
        "joint_position": 1.0 / layout.length_unit,
        "joint_velocity": rate,
        "root_velocity": rate,
        "root_yaw_rate": layout.time_unit / layout.yaw_unit,
        "phase_change": layout.time_unit / layout.phase_unit,
        "trajectory_position_x": 1.0 / layout.length_unit,
        "trajectory_position_z": 1.0 / layout.length_unit,
    }
    found = [
        jnp.ravel(blocks[name]) * units.get(name, 1.0) if name in blocks else jnp.zeros(layout.output_width(name))
        for name in layout.output_blocks
    ]
    return jnp.concatenate(found)


def arc(speed, turn_rate, seconds):
    """Returns positions [N, 2] and directions [N, 2] of a walk on a circle after some seconds [N] (turn rate not 0)."""
    angle = turn_rate * seconds
    radius = speed / turn_rate
    positions = jnp.stack([radius * (1.0 - jnp.cos(angle)), radius * jnp.sin(angle)], -1)
    return positions, jnp.stack([jnp.sin(angle), jnp.cos(angle)], -1)


def _oracle(layout: FrameLayout):
    """Returns a function (walk, x, phase) -> y of a walk on a circle, a function of the phase alone.

    Each root step goes straight ahead, then turns."""

    def evaluate(walk, x, phase):
        dt = 1.0 / layout.fps
        turn = walk["turn_rate"] * dt
        facing = jnp.stack([jnp.sin(turn), jnp.cos(turn)])
        here, there = pose(phase), to_world(jnp.asarray(pose(phase + walk["cadence"] * dt)), facing)
        there = there + jnp.stack([jnp.zeros(()), jnp.zeros(()), walk["speed"] * dt])[None]
        positions, directions = arc(walk["speed"], walk["turn_rate"], jnp.arange(6) / 6.0)
        blocks = {
            "trajectory_position_x": positions[:, 0],
            "trajectory_position_z": positions[:, 1],
            "trajectory_direction_x": directions[:, 0],
            "trajectory_direction_z": directions[:, 1],
            "joint_position": here,
            "joint_velocity": (there - here) * layout.fps,
            "phase_change": walk["cadence"],
            "root_velocity": jnp.stack([jnp.zeros(()), walk["speed"]]),
            "root_yaw_rate": walk["turn_rate"],
        }
        return write_output(layout, blocks)

    return evaluate


ORACLES = {name: _oracle(layout) for name, layout in LAYOUT.items()}


def true_walk(walk: dict, fps: float, num_frames: int, phase: float = 0.0):
    """Returns roots [T, 2], yaw [T], phase [T] and world joints [T, J, 3] of the oracle's walk, in float64 NumPy."""
    frames = np.arange(num_frames)
    yaw, phases = walk["turn_rate"] / fps * frames, phase + walk["cadence"] / fps * frames
    steps = walk["speed"] / fps * np.stack([np.sin(yaw), np.cos(yaw)], -1)
    roots = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)[:-1]])
    joints = np.stack([pose(p) for p in phases])
    turned = np.stack(
        [
            joints[..., 0] * np.cos(yaw)[:, None] + joints[..., 2] * np.sin(yaw)[:, None] + roots[:, None, 0],
            joints[..., 1],
            joints[..., 2] * np.cos(yaw)[:, None] - joints[..., 0] * np.sin(yaw)[:, None] + roots[:, None, 1],
        ],
        -1,
    )
    return roots, yaw, phases, turned


def _obedient(layout: FrameLayout):
    """Returns a function (weights [Dy, Dx], x, phase) -> y of a walker that follows its input trajectory.

    Its joints sway asymmetrically with the whole input, so that a law which holds for it holds for any network.
    """

    def evaluate(weights, x, phase):
        def sample(name, index):
            return x[layout.input_slice(name)][index]

        seconds = 10.0 / 60.0
        go = [sample(f"trajectory_position_{axis}", 7) * layout.length_unit / seconds for axis in "xz"]
        face = [sample(f"trajectory_direction_{axis}", 7) for axis in "xz"]
        ahead = jnp.arange(6) * seconds
        blocks = {
            "trajectory_position_x": ahead * go[0],
            "trajectory_position_z": ahead * go[1],
            "trajectory_direction_z": jnp.ones(6),
            "joint_position": pose(phase),
            "phase_change": 6.0,
            "root_velocity": jnp.stack(go),
            "root_yaw_rate": jnp.arctan2(face[0], face[1]) / seconds,
        }
        y = write_output(layout, blocks)
        return y + weights @ jnp.tanh(x)

    return evaluate


OBEDIENT = {name: _obedient(layout) for name, layout in LAYOUT.items()}


def sway(layout: FrameLayout, scale: float = 1e-3) -> jnp.ndarray:
    """Returns weights [Dy, Dx] of an obedient walker's sway, in its joints alone."""
    weights = np.zeros((layout.output_size, layout.input_size), np.float32)
    rows = layout.output_slice("joint_position")
    size = (layout.output_width("joint_position"), layout.input_size)
    weights[rows] = scale / layout.length_unit * np.random.default_rng(0).normal(size=size)
    return jnp.asarray(weights)


def reflection(widths: dict[str, int]) -> jnp.ndarray:
    """Returns the signs that reflect a vector of blocks of these widths in the plane x = 0."""
    signs = {"root_velocity": [-1.0, 1.0], "root_yaw_rate": [-1.0]}
    for name in ("joint_position", "joint_velocity", "joint_forward", "joint_up"):
        signs[name] = [-1.0, 1.0, 1.0] * JOINTS
    for name in ("trajectory_position_x", "trajectory_direction_x"):
        signs[name] = [-1.0]
    return jnp.concatenate(
        [jnp.broadcast_to(jnp.asarray(signs.get(name, [1.0])), (size,)) for name, size in widths.items()]
    )


@partial(jax.jit, static_argnums=0)
def input_row(layout: FrameLayout, walk: dict, phase: float = 0.0) -> jnp.ndarray:
    """Returns x of a frame of the oracle's walk; its joints are those of the previous frame."""
    dt = 1.0 / layout.fps
    positions, directions = arc(walk["speed"], walk["turn_rate"], jnp.arange(-6, 6) / 6.0)
    y = ORACLES[layout.name](walk, jnp.zeros(layout.input_size), phase - walk["cadence"] * dt)
    blocks = {
        "trajectory_position_x": positions[:, 0] / layout.length_unit,
        "trajectory_position_z": positions[:, 1] / layout.length_unit,
        "trajectory_direction_x": directions[:, 0],
        "trajectory_direction_z": directions[:, 1],
        "gait": jnp.zeros((6, 12)).at[1].set(1.0),
        "joint_position": y[layout.output_slice("joint_position")],
        "joint_velocity": y[layout.output_slice("joint_velocity")],
        "terrain_height": jnp.zeros(36),
    }
    return jnp.concatenate([blocks[name].ravel() for name in layout.input_blocks])
