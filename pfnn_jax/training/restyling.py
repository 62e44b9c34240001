"""Restyled rows: the known styles show a new style what its own clip does not, such as turns.

A few seconds of straight walking contain no turn. The rows of the styles that a network was trained on do. Such a row
is the mean row of its style's straight walks at the row's phase, plus a difference from it, which holds the turn, the
change of speed and the variation between steps. Restyling adds that difference to the mean row of the new style:

    row'(n) = mean_new(phase_n) + speed_new^s * share * (row_n - mean_known(phase_n)) / speed_known^s.

Mean rows are Fourier series of the phase. `s` is 1 in columns that grow with the speed and 0 in the others; `share` is
how much of a joint's difference styles have in common. All rows are normalised: a Fourier series in normalised columns
is one in their units. Only layouts with a global phase have such rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.io.checkpoint import load_record, save_record
from pfnn_jax.io.files import locate, read_note
from pfnn_jax.motion.features.decode import median_speed, root_steps
from pfnn_jax.motion.features.encode import Features, select_rows
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.run_config import check_present
from pfnn_jax.training.data import Array, Batch, to_batch

HARMONICS = 6
"""Harmonics of the phase in a mean row: 10 Hz at a gait cycle of 0.6 s, beyond which walks hold little but noise."""

RIDGE = 1e-3
"""Weight of a quadratic penalty on the harmonics, relative to the number of rows: clips of less than a gait cycle leave
some of them undetermined."""

STRAIGHT = 10.0
"""Degrees that the trajectory of a straight walk may turn within the second before and after a row."""

AHEAD = 30.0
"""Largest angle in degrees between travel and facing in a straight walk; beyond it are side and backward steps."""

NATURAL_SPEED = 0.2
"""Share by which the speed of a row of the mean walk may differ from the style's usual speed."""

FASTEST = 1.5
"""Multiple of the style's usual speed beyond which a row is a run: differences of runs make turns of walks worse."""

FEWEST = 60
"""Straight, and turning, rows without which a style shows no differences: one second."""

COUNT = 1600
"""Rows that `find_differences` keeps: more did not make better styles (docs/research/few_shot.md)."""


NOTE = "differences.json"


@struct.dataclass
class StyleDifferences:
    """Differences of known styles' rows from the mean rows of their straight walks, per metre per second of speed.

    Normalised, and already multiplied by the shares that styles have in common.
    """

    x: Array  # [N, Dx]
    y: Array  # [N, Dy]
    phase: Array  # [N] radians


def find_differences(
    styles: Mapping[str, Features],
    layout: FrameLayout,
    normaliser: Normaliser,
    *,
    count: int = COUNT,
    fastest: float = FASTEST,
    seed: int = 0,
) -> StyleDifferences | None:
    """Collects differences of known styles: equally many rows of each, of everything but straight walks and runs.

    Args:
        styles: name -> rows in layout units, mirror images included; straight walks and others.
        layout: of the rows.
        normaliser: of the network.
        count: N at most.
        fastest: multiple of a style's usual speed up to which rows are taken.
        seed: of the choice of rows.

    Returns:
        The differences, or None where the layout has no global phase, or no style has straight walks and others.
    """
    if layout.phase_size:
        return None
    parts = {name: _straight_and_others(rows, layout, fastest) for name, rows in styles.items()}
    parts = {name: both for name, both in parts.items() if min(len(part.x) for part in both) >= FEWEST}
    if not parts:
        return None
    speeds = {name: median_speed(layout, straight.y) for name, (straight, _) in parts.items()}
    batches = {name: [to_batch([part], normaliser) for part in both] for name, both in parts.items()}
    means = {name: fit_mean_row(straight) for name, (straight, _) in batches.items()}
    scale = {name: speed_scale(layout, 1 / speed) for name, speed in speeds.items()}
    share = _shares_of(layout, parts, batches, means, scale)
    rng, found = np.random.default_rng(seed), []
    for name, (_, others) in batches.items():
        rows = rng.permutation(len(others.phase))[: -(-count // len(batches))]
        phase = np.asarray(others.phase)[rows]
        found.append((scale[name] * share * (_columns(others)[rows] - mean_row(means[name], phase)), phase))
    values, phase = (np.concatenate(part)[:count].astype(np.float32) for part in zip(*found, strict=True))
    return StyleDifferences(values[:, : layout.input_size], values[:, layout.input_size :], phase)


def restyle(differences: StyleDifferences, clip: Batch, layout: FrameLayout, normaliser: Normaliser) -> Batch:
    """Returns the rows [N, ...] that the known styles' differences make of a new style.

    Args:
        differences: N of them.
        clip: normalised rows of the new style: of its straight walk and, where that belongs to the style, of its
            mirror image.
        layout, normaliser: of the rows.
    """
    speed = median_speed(layout, np.asarray(normaliser.outputs.invert(np.asarray(clip.y))))
    values = np.concatenate([differences.x, differences.y], axis=1)
    values = mean_row(fit_mean_row(clip), differences.phase) + speed_scale(layout, speed) * values
    x, y = np.split(values.astype(np.float32), [layout.input_size], axis=1)
    return Batch(x, y, np.asarray(differences.phase, np.float32))


def save_differences(run: Path, differences: StyleDifferences) -> None:
    """Saves differences in RUN/differences/, in half precision: they are normalised."""
    check_present(run)
    halves = jax.tree.map(lambda leaf: np.asarray(leaf, np.float16), differences)
    save_record(run / "differences", halves, NOTE, {"rows": len(differences.phase)})


def has_differences(run: Path) -> bool:
    """Returns whether there is RUN/differences/, without reading it."""
    return locate(run / "differences") is not None


def load_differences(run: Path, layout: FrameLayout) -> StyleDifferences | None:
    """Reads RUN/differences/, or returns None where there is none.

    Args:
        run: directory of the run.
        layout: of the run.

    Raises:
        InputError: if it is damaged or of another layout.
    """
    if not has_differences(run):
        return None
    rows = read_note(run / "differences", NOTE, "must hold the number of rows")["rows"]
    sizes = (rows, layout.input_size), (rows, layout.output_size), (rows,)
    abstract = jax.eval_shape(lambda: StyleDifferences(*(jnp.zeros(size, jnp.float16) for size in sizes)))
    return jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), load_record(run / "differences", abstract))


def fourier_basis(phase: Array) -> np.ndarray:
    """Returns 1, cos k p and sin k p up to k = `HARMONICS` [N, 1 + 2 `HARMONICS`] for phases p [N] in radians."""
    angles = np.asarray(phase, np.float64)[:, None] * np.arange(1, HARMONICS + 1)
    return np.concatenate([np.ones((len(angles), 1)), np.cos(angles), np.sin(angles)], axis=1)


def fit_mean_row(rows: Batch) -> np.ndarray:
    """Fits the mean row of a style by least squares; coefficients [1 + 2 `HARMONICS`, Dx + Dy] of x and y."""
    basis = fourier_basis(rows.phase)
    penalty = np.full(basis.shape[1], RIDGE * len(basis))
    penalty[0] = 0.0
    return np.linalg.solve(basis.T @ basis + np.diag(penalty), basis.T @ _columns(rows))


def mean_row(coefficients: np.ndarray, phase: Array) -> np.ndarray:
    """Returns the mean rows [N, Dx + Dy] of a style at phases [N] in radians."""
    return fourier_basis(phase) @ coefficients


def speed_scale(layout: FrameLayout, speed: float) -> np.ndarray:
    """Returns the scale [Dx + Dy] of differences at a speed: the speed where they grow with it, else 1.

    At one turn rate the curvature of a trajectory in metres, the lean into the turn and the difference between the
    inner and the outer step grow with the speed. Directions, yaw rates, phase rates and contacts do not.
    """
    grows = [
        name.startswith(("joint_", "trajectory_position")) or name == "root_velocity"
        for name in (*layout.input_names, *layout.output_names)
    ]
    return np.where(grows, speed, 1.0)


def joint_shares(layout: FrameLayout, differences: np.ndarray) -> np.ndarray:
    """Returns the share [J] of each joint's difference that styles have in common.

    Each style's difference between turning and straight walks is predicted by the mean of the others'; the share is the
    regression coefficient of the true differences of joint positions on the predicted ones, between 0 and 1.

    Args:
        layout: of the rows.
        differences: [S, C, Dx + Dy] of S styles, as coefficients of mean rows; 1 style has nothing to be compared with,
            and keeps its differences whole.
    """
    styles = len(differences)
    if styles < 2:
        return np.ones(layout.num_joints)
    columns = layout.input_size + np.arange(layout.output_size)[layout.output_slice("joint_position")]
    found = differences[:, :, columns]
    predicted = (found.sum(axis=0) - found) / (styles - 1)
    by_joint = (*found.shape[:2], layout.num_joints, 3)
    product, square = ((a * predicted).reshape(by_joint).sum(axis=(0, 1, 3)) for a in (found, predicted))
    return np.clip(product / np.maximum(square, 1e-12), 0.0, 1.0)


def joint_scale(layout: FrameLayout, shares: np.ndarray) -> np.ndarray:
    """Returns shares [J] of the joints as a scale [Dx + Dy] of their columns; 1 for columns of no joint."""

    def side(names: tuple[str, ...]) -> np.ndarray:
        scale = np.ones(len(names))
        for block in {name for name in names if name.startswith("joint_")}:
            columns = np.flatnonzero(np.array(names) == block)
            scale[columns] = np.repeat(shares, len(columns) // layout.num_joints)
        return scale

    return np.concatenate([side(layout.input_names), side(layout.output_names)])


def _shares_of(layout: FrameLayout, parts, batches, means, scale) -> np.ndarray:
    """Returns the scale [Dx + Dy] of the shares of all styles' turns to the left, at equal speeds."""
    found = []
    for name, (_, others) in parts.items():
        left = _bends(layout, others.x)[:, 1] > STRAIGHT
        if left.sum() >= FEWEST:
            turning = Batch(
                *(np.asarray(leaf)[left] for leaf in (batches[name][1].x, batches[name][1].y, others.phase))
            )
            found.append(scale[name] * (fit_mean_row(turning) - means[name]))
    return joint_scale(layout, joint_shares(layout, np.stack(found)) if found else np.ones(layout.num_joints))


def _straight_and_others(rows: Features, layout: FrameLayout, fastest: float) -> tuple[Features, Features]:
    """Returns the rows of straight walks ahead at the style's usual speed, and all others that are not too fast."""
    velocity = root_steps(layout, rows.y)[0]
    straight = np.abs(_bends(layout, rows.x)).max(axis=1) < STRAIGHT
    straight &= np.abs(np.arctan2(velocity[:, 0], velocity[:, 1])) < np.deg2rad(AHEAD)
    speed = np.linalg.norm(velocity, axis=1)
    usual = _mode(speed[straight]) if straight.any() else 0.0
    straight &= np.abs(speed - usual) <= NATURAL_SPEED * usual
    return select_rows(rows, straight), select_rows(rows, ~straight & (speed <= fastest * usual))


def _bends(layout: FrameLayout, x: np.ndarray) -> np.ndarray:
    """Returns the directions [N, 2] of the trajectory's first and last sample in degrees; to the left positive."""
    across, ahead = (x[:, layout.input_slice(f"trajectory_direction_{axis}")][:, [0, -1]] for axis in "xz")
    return np.rad2deg(np.arctan2(across, ahead))


def _mode(values: np.ndarray) -> float:
    """Returns the middle of the shortest interval that holds half of the values [N].

    A style may hold walks and runs; their median can lie between both.
    """
    ordered = np.sort(values)
    half = (len(ordered) + 1) // 2
    first = int(np.argmin(ordered[half - 1 :] - ordered[: len(ordered) - half + 1]))
    return float(ordered[first] + ordered[first + half - 1]) / 2


def _columns(rows: Batch) -> np.ndarray:
    return np.concatenate([rows.x, rows.y], axis=1).astype(np.float64)
