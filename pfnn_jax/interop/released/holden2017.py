"""Imports the weights that Holden et al. (2017) released with the PFNN as a run.

The release does not contain the control points but the network blended at 50 phases: matrices `W0_iii.bin` and biases
`b0_iii.bin` (and 1, 2) at phase 2πi/50, little-endian float32, row-major (outputs, inputs). Every table is a known
linear combination of four control points, so least squares recovers them from any four or more tables.
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
from pfnn_jax.motion.arrays import unit
from pfnn_jax.motion.features.layout import pfnn2017
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.motion.kinematics import quat_conjugate, quat_exp, quat_rotate
from pfnn_jax.motion.roles import assign_roles
from pfnn_jax.motion.skeleton import Skeleton, skeleton_to_json
from pfnn_jax.run import Run, create_run, load_run, save_shared
from pfnn_jax.run_config import RunConfig

NUM_TABLES = 50
CONTROL_POINTS = 4

MAX_CONDITION = 1e6
"""Design matrices above this condition number are numerically rank-deficient (rank below 4)."""

MAX_RESIDUAL = 1e-3
"""Relative root mean square residual above which the tables come from another spline (float32 rounding gives 1e-7)."""

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
    """Imports a directory of released tables as a run of layout `pfnn2017`.

    Args:
        directory: contains `Xmean.bin`, `Xstd.bin`, `Ymean.bin`, `Ystd.bin` and, for at least four table indices
            iii of 000-049, `W0_iii.bin`, `W1_iii.bin`, `W2_iii.bin`, `b0_iii.bin`, `b1_iii.bin`, `b2_iii.bin`. A
            `description.json` next to them gives the skeleton; without one it is that of the released character.
        out: the run directory to write.
        overwrite: whether to replace an existing run.

    Returns:
        The run. `config.pretrain` records the table indices used, the condition number of the least-squares problem
        and the residual of each array, relative to its root mean square.

    Raises:
        InputError: if a file is missing, has the wrong size or is not finite; if there are fewer than four tables, or
            tables that do not determine four control points; if the tables come from another spline; if `out` exists.
    """
    directory = Path(directory)
    description = read_description(directory, "pfnn2017")
    layout = pfnn2017(len(JOINTS) if description is None else description["skeleton"].num_joints)
    sides = (("X", layout.input_size), ("Y", layout.output_size))
    normaliser = Normaliser(*(read_statistics(directory, side, size) for side, size in sides))
    shared, facts = read_tables(directory, layout.input_size, layout.output_size)
    skeleton = _skeleton(shared, normaliser, directory) if description is None else description["skeleton"]
    config = RunConfig(
        network=config_of(shared),
        adapter=AdapterConfig(),
        layout=layout.name,
        num_joints=layout.num_joints,
        styles=(),
        skeleton=skeleton_to_json(skeleton),
        pretrain={"source": f"PFNN tables in {directory.resolve().name}", **facts},
    )
    create_run(out, config, normaliser, overwrite)
    save_shared(out, shared)
    return load_run(out, layout.name)


def read_tables(directory: Path, inputs: int, outputs: int) -> tuple[Network, dict[str, Any]]:
    """Recovers a network from a directory of tables `W0_iii.bin`, `b0_iii.bin` (and 1, 2).

    Args:
        directory: contains them for at least four table indices iii.
        inputs, outputs: sizes of x and y; the hidden size is read from the biases.

    Returns:
        The network, and a dict with the table indices, the condition number of the least-squares problem and the
        relative residuals.

    Raises:
        InputError: for the tables, as in `import_released_pfnn`.
    """
    indices = _find_indices(directory)
    condition = condition_number(indices)
    if condition > MAX_CONDITION:
        rule = f"must determine 4 control points (condition number {condition:.1e}): add tables at other phases"
        raise InputError(directory, "tables", ", ".join(map(str, indices)), rule)
    hidden = len(read_array(directory / f"b0_{indices[0]:03d}.bin", None))
    shared, residuals = _read_network(directory, indices, (inputs, hidden, hidden, outputs))
    return shared, {"tables": list(indices), "condition_number": condition, "residual": residuals}


def condition_number(indices: Sequence[int]) -> float:
    """Returns the factor by which recovery from these tables amplifies errors; infinite if it is impossible."""
    return float(np.linalg.cond(spline_design(indices)))


def recover_control_points(tables: np.ndarray, indices: Sequence[int]) -> tuple[np.ndarray, float]:
    """Recovers the control points of a cyclic Catmull-Rom spline from its values, by least squares in float64.

    Args:
        tables: [N, ...] values of the spline at phases 2πi/50, N at least 4.
        indices: the N table indices i.

    Returns:
        Control points [4, ...] at phases 0, π/2, π, 3π/2, and the root mean square residual of the spline through
        them, relative to the root mean square of the tables.
    """
    flat = tables.reshape(len(tables), -1).astype(np.float64)
    design = spline_design(indices)
    points = np.linalg.pinv(design) @ flat
    scale = float(np.sqrt(np.mean(flat**2)))
    residual = float(np.sqrt(np.mean((design @ points - flat) ** 2)))
    return points.reshape(CONTROL_POINTS, *tables.shape[1:]), residual / scale if scale > 0 else 0.0


def spline_design(indices: Sequence[int]) -> np.ndarray:
    """Returns the spline coefficients [N, 4] at the phases 2πi/50 of tables i, in float64."""
    return _all_coefficients()[list(indices)]


@functools.cache
def _all_coefficients() -> np.ndarray:
    with jax.enable_x64(True):
        phases = jnp.arange(NUM_TABLES, dtype=jnp.float64) * (2 * math.pi / NUM_TABLES)
        return np.asarray(jax.vmap(lambda phase: catmull_rom_basis(phase, CONTROL_POINTS))(phases))


def _find_indices(directory: Path) -> tuple[int, ...]:
    """Returns the table indices found in the directory: at least four, each below 50."""
    found = (re.fullmatch(r"[Wb][012]_(\d{3})\.bin", path.name) for path in sorted(directory.iterdir()))
    indices = tuple(sorted({int(match[1]) for match in found if match}))
    if indices and indices[-1] >= NUM_TABLES:
        raise InputError(directory, "table index", indices[-1], f"must be below {NUM_TABLES}")
    if len(indices) < CONTROL_POINTS:
        rule = f"must be at least {CONTROL_POINTS}, named W0_000.bin, W1_000.bin, W2_000.bin, b0_000.bin, ..."
        raise InputError(directory, "tables", len(indices), rule)
    return indices


def _read_network(
    directory: Path, indices: tuple[int, ...], sizes: tuple[int, int, int, int]
) -> tuple[Network, dict[str, float]]:
    """Returns the recovered network and the relative residual of each array."""
    layers, residuals = [], {}
    for layer, (i, o) in enumerate(zip(sizes[:-1], sizes[1:], strict=True)):
        points = {}
        for name, shape in ((f"W{layer}", (o, i)), (f"b{layer}", (o,))):
            tables = np.stack([read_array(directory / f"{name}_{index:03d}.bin", shape) for index in indices])
            points[name[0]], residuals[name] = recover_control_points(tables, indices)
            if residuals[name] > MAX_RESIDUAL:
                rule = f"must fit a spline through {CONTROL_POINTS} points to {MAX_RESIDUAL:g}"
                raise InputError(directory, f"tables {name}", f"relative residual {residuals[name]:.1e}", rule)
        weights, biases = (jnp.asarray(points[key], jnp.float32) for key in "Wb")
        layers.append(BlendedLayer(weights=weights.swapaxes(1, 2), biases=biases))
    return Network(layers=(layers[0], layers[1], layers[2])), residuals


def _skeleton(shared: Network, normaliser: Normaliser, source: Path) -> Skeleton:
    """Reconstructs the skeleton of the released character, whose rest pose is not part of the release.

    The network predicts positions and rotations of all joints. The rest direction of a bone is its direction in the
    pose, rotated back by the parent's rotation and averaged over the poses predicted from the mean input at all phases
    (within 4 degrees of the original rest pose); the bone lengths are known.
    """
    layout, predictor = pfnn2017(len(JOINTS)), assemble_predictor(shared, None, normaliser)
    phases = jnp.arange(NUM_TABLES) * (2 * math.pi / NUM_TABLES)
    y = np.asarray(jax.vmap(evaluate, (None, None, 0))(predictor, predictor.input_mean, phases), np.float64)
    positions, rotations = (
        y[:, layout.output_slice(block)].reshape(NUM_TABLES, -1, 3) for block in ("joint_position", "joint_rotation")
    )
    parents = np.array([parent for _, parent, _ in JOINTS])
    rest_bones = quat_rotate(quat_conjugate(quat_exp(rotations))[:, parents], positions - positions[:, parents])
    bones = rest_bones.mean(axis=0)
    lengths = np.array([length for _, _, length in JOINTS]) * layout.length_unit
    directions = unit(bones)
    offsets = directions * lengths[:, None]
    return cmu_skeleton(offsets, str(source))


def cmu_skeleton(offsets: np.ndarray, source: str) -> Skeleton:
    """Returns the skeleton of the CMU joints `JOINTS` with offsets [31, 3] in metres.

    Args:
        offsets: of each joint from its parent.
        source: what to name in messages.
    """
    parents = np.array([parent for _, parent, _ in JOINTS])
    leaves = sorted(set(range(len(JOINTS))) - set(parents.tolist()))
    skeleton = Skeleton(
        names=tuple(name for name, _, _ in JOINTS),
        parents=parents,
        offsets=offsets,
        end_sites=tuple((leaf, np.zeros(3)) for leaf in leaves),
        mirror=np.arange(len(JOINTS)),
    )
    return assign_roles(skeleton, source=source)
