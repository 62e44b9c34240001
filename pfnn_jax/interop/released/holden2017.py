"""The weights that Holden et al. released with the PFNN (2017), turned into a run of this project.

The release holds no control points but the network blended at 50 phases: matrices `W0_iii.bin` and biases
`b0_iii.bin` (and 1, 2) at phase 2πi/50, little-endian float32, row-major (outputs, inputs). Every entry is a known
combination of four control points, so that any four or more entries give them back by least squares.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.inference.predictor import assemble_predictor, evaluate
from pfnn_jax.interop.released.files import read_array, read_description, read_statistics
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.layers.full import BlendedLayer
from pfnn_jax.models.network import Network, config_of
from pfnn_jax.models.spline import catmull_rom_basis
from pfnn_jax.motion.features.layout import pfnn2017
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.motion.kinematics import quat_conjugate, quat_exp, quat_rotate
from pfnn_jax.motion.roles import assign_roles
from pfnn_jax.motion.skeleton import Skeleton, skeleton_to_json
from pfnn_jax.run import Run, RunConfig, create_run, load_run, save_shared

NUM_TABLES = 50
CONTROL_POINTS = 4

MAX_CONDITION = 1e6
"""Design matrices above this condition number are of lower rank than 4 within rounding."""

MAX_RESIDUAL = 1e-3
"""Root mean square residual, relative to the values, above which tables are of another spline (float32 gives 1e-7)."""

# Joint, parent and bone length in centimetres of the released character (the CMU skeleton, scaled by 5.644).
JOINTS: tuple[tuple[str, int, float], ...] = (
    ("Hips", -1, 0.0), ("LHipJoint", 0, 0.0), ("LeftUpLeg", 1, 13.57), ("LeftLeg", 2, 40.40), ("LeftFoot", 3, 42.28),
    ("LeftToeBase", 4, 13.36), ("RHipJoint", 0, 0.0), ("RightUpLeg", 6, 13.39), ("RightLeg", 7, 41.96),
    ("RightFoot", 8, 42.38), ("RightToeBase", 9, 13.61), ("LowerBack", 0, 0.0), ("Spine", 11, 11.54),
    ("Spine1", 12, 11.57), ("Neck", 13, 0.0), ("Neck1", 14, 9.91), ("Head", 15, 9.98), ("LeftShoulder", 13, 0.0),
    ("LeftArm", 17, 20.23), ("LeftForeArm", 18, 28.12), ("LeftHand", 19, 19.66), ("LeftFingerBase", 20, 0.0),
    ("LeftHandIndex1", 21, 4.04), ("LThumb", 20, 0.0), ("RightShoulder", 13, 0.0), ("RightArm", 24, 19.46),
    ("RightForeArm", 25, 29.59), ("RightHand", 26, 19.44), ("RightFingerBase", 27, 0.0),
    ("RightHandIndex1", 28, 3.51), ("RThumb", 27, 0.0),
)  # fmt: skip


def import_released_pfnn(directory: str | Path, out: str | Path, overwrite: bool = False) -> Run:
    """Makes a run of layout `pfnn2017` from a directory of released tables.

    Args:
        directory: holds `Xmean.bin`, `Xstd.bin`, `Ymean.bin`, `Ystd.bin` and, for at least four table indices
            iii of 000-049, `W0_iii.bin`, `W1_iii.bin`, `W2_iii.bin`, `b0_iii.bin`, `b1_iii.bin`, `b2_iii.bin`. With
            a `description.json` beside them they are of its skeleton, else of the released character.
        out: the run directory to make.
        overwrite: replace an existing run.

    Returns:
        The run. `config.pretrain` tells the indices used, the condition number of the least squares and the largest
        residual of each array, relative to its root mean square.

    Raises:
        InputError: for a file that is missing, of a wrong size or not finite; for fewer than four tables or tables
            from which four control points cannot be told apart; for tables of another spline; if `out` exists.
    """
    directory = Path(directory)
    told = read_description(directory, "pfnn2017")
    layout = pfnn2017(len(JOINTS) if told is None else told["skeleton"].num_joints)
    sides = (("X", layout.input_size), ("Y", layout.output_size))
    normaliser = Normaliser(*(read_statistics(directory, side, size) for side, size in sides))
    shared, facts = read_tables(directory, layout.input_size, layout.output_size)
    skeleton = _skeleton(shared, normaliser, directory) if told is None else told["skeleton"]
    config = RunConfig(
        network=config_of(shared),
        adapter=AdapterConfig(),
        layout=layout.name,
        num_joints=layout.num_joints,
        styles=(),
        skeleton=skeleton_to_json(skeleton),
        pretrain={"source": f"PFNN tables in {directory}", **facts},
    )
    create_run(out, config, normaliser, overwrite)
    save_shared(out, shared)
    return load_run(out, layout.name)


def read_tables(directory: Path, inputs: int, outputs: int) -> tuple[Network, dict[str, Any]]:
    """The network of a directory of tables `W0_iii.bin`, `b0_iii.bin` (and 1, 2).

    Args:
        directory: holds them for at least four table indices iii.
        inputs, outputs: sizes of x and y; the hidden size is that of the biases.

    Returns:
        The network, and which tables were used, the condition number of the least squares and what it left.

    Raises:
        InputError: as `import_released_pfnn`, for the tables.
    """
    indices = _find_indices(directory)
    condition = condition_number(indices)
    if condition > MAX_CONDITION:
        rule = f"the tables must tell 4 control points apart (condition number {condition:.1e}): add others"
        raise InputError(directory, "tables", ", ".join(map(str, indices)), rule)
    hidden = len(read_array(directory / f"b0_{indices[0]:03d}.bin", None))
    shared, residuals = _read_network(directory, indices, (inputs, hidden, hidden, outputs))
    return shared, {"tables": list(indices), "condition_number": condition, "residual": residuals}


def condition_number(indices: Sequence[int]) -> float:
    """By how much recovery from tables of these indices magnifies errors; infinite where it is impossible."""
    return float(np.linalg.cond(spline_design(indices)))


def recover_control_points(tables: np.ndarray, indices: Sequence[int]) -> tuple[np.ndarray, float]:
    """The control points of a cyclic Catmull-Rom spline from its values, by least squares in float64.

    Args:
        tables: [N, ...] values of the spline at phases 2πi/50, N at least 4.
        indices: the N table indices i.

    Returns:
        Control points [4, ...] at phases 0, π/2, π, 3π/2, and the root mean square of what the spline through them
        leaves of the tables, relative to the tables' own.
    """
    flat = tables.reshape(len(tables), -1).astype(np.float64)
    design = spline_design(indices)
    points = np.linalg.pinv(design) @ flat
    scale = float(np.sqrt(np.mean(flat**2)))
    residual = float(np.sqrt(np.mean((design @ points - flat) ** 2)))
    return points.reshape(CONTROL_POINTS, *tables.shape[1:]), residual / scale if scale > 0 else 0.0


def spline_design(indices: Sequence[int]) -> np.ndarray:
    """[N, 4] spline coefficients at the phases 2πi/50 of tables i, in float64."""
    return _all_coefficients()[list(indices)]


@functools.cache
def _all_coefficients() -> np.ndarray:
    with jax.enable_x64(True):
        phases = jnp.arange(NUM_TABLES, dtype=jnp.float64) * (2 * math.pi / NUM_TABLES)
        return np.asarray(jax.vmap(lambda phase: catmull_rom_basis(phase, CONTROL_POINTS))(phases))


def _find_indices(directory: Path) -> tuple[int, ...]:
    """Indices of which any file is there; at least four, each below 50."""
    found = (re.fullmatch(r"[Wb][012]_(\d{3})\.bin", path.name) for path in sorted(directory.iterdir()))
    indices = tuple(sorted({int(match[1]) for match in found if match}))
    if indices and indices[-1] >= NUM_TABLES:
        raise InputError(directory, "table index", indices[-1], f"must be below {NUM_TABLES}")
    if len(indices) < CONTROL_POINTS:
        rule = f"at least {CONTROL_POINTS} are needed, as W0_000.bin, W1_000.bin, W2_000.bin, b0_000.bin, ..."
        raise InputError(directory, "tables", len(indices), rule)
    return indices


def _read_network(
    directory: Path, indices: tuple[int, ...], sizes: tuple[int, int, int, int]
) -> tuple[Network, dict[str, float]]:
    """The recovered network and each array's relative residual."""
    layers, residuals = [], {}
    for layer, (i, o) in enumerate(zip(sizes[:-1], sizes[1:], strict=True)):
        points = {}
        for name, shape in ((f"W{layer}", (o, i)), (f"b{layer}", (o,))):
            tables = np.stack([read_array(directory / f"{name}_{index:03d}.bin", shape) for index in indices])
            points[name[0]], residuals[name] = recover_control_points(tables, indices)
            if residuals[name] > MAX_RESIDUAL:
                rule = f"a spline through {CONTROL_POINTS} points must leave at most {MAX_RESIDUAL:g} of the tables"
                raise InputError(directory, f"tables {name}", f"{residuals[name]:.1e} is left", rule)
        weights, biases = (jnp.asarray(points[key], jnp.float32) for key in "Wb")
        layers.append(BlendedLayer(weights=weights.swapaxes(1, 2), biases=biases))
    return Network(layers=(layers[0], layers[1], layers[2])), residuals


def _skeleton(shared: Network, normaliser: Normaliser, source: Path) -> Skeleton:
    """The released character's skeleton, whose rest pose is not among the released tables.

    The network writes positions and rotations of all joints. A bone's direction at rest is its direction in the pose,
    turned back by the parent's rotation, averaged over the poses of the mean input around the phase (within 4 degrees
    of the original rest pose); its length is the known one.
    """
    layout, predictor = pfnn2017(len(JOINTS)), assemble_predictor(shared, None, normaliser)
    phases = jnp.arange(NUM_TABLES) * (2 * math.pi / NUM_TABLES)
    y = np.asarray(jax.vmap(evaluate, (None, None, 0))(predictor, predictor.input_mean, phases), np.float64)
    positions, rotations = (
        y[:, layout.output_slice(block)].reshape(NUM_TABLES, -1, 3) for block in ("joint_position", "joint_rotation")
    )
    parents = np.array([parent for _, parent, _ in JOINTS])
    turned_back = quat_rotate(quat_conjugate(quat_exp(rotations))[:, parents], positions - positions[:, parents])
    bones = turned_back.mean(axis=0)
    lengths = np.array([length for _, _, length in JOINTS]) * layout.length_unit
    directions = bones / np.maximum(np.linalg.norm(bones, axis=1, keepdims=True), 1e-6)
    offsets = directions * lengths[:, None]
    leaves = sorted(set(range(len(JOINTS))) - set(parents.tolist()))
    skeleton = Skeleton(
        names=tuple(name for name, _, _ in JOINTS),
        parents=parents,
        offsets=offsets,
        end_sites=tuple((leaf, np.zeros(3)) for leaf in leaves),
        mirror=np.arange(len(JOINTS)),
    )
    return assign_roles(skeleton, source=str(source))
