"""Metrics of generated locomotion that need no trained network, in NumPy on plain arrays.

Positions are in metres, Y up, at `fps` frames per second. Feet are [T, F, 3], one entry for each foot joint (ankles,
toes); `ground` is the height of each joint while its foot is planted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.features.layout import FrameLayout

GROUPS: dict[str, tuple[str, ...]] = {
    "pose": ("joint_position", "joint_forward", "joint_up", "joint_rotation"),
    "velocity": ("joint_velocity",),
    "trajectory": tuple(f"trajectory_{kind}_{axis}" for kind in ("position", "direction") for axis in "xz"),
    "root": ("root_velocity", "root_yaw_rate"),
    "phase_change": ("phase_change",),
    "contacts": ("contacts", "foot_contacts"),
    "local_phase": ("local_phase", "local_phase_change"),
}
"""Blocks of an output vector whose errors are reported together."""


def one_step_error(
    y_true: np.ndarray, y_pred: np.ndarray, layout: FrameLayout, std: np.ndarray | float = 1.0
) -> dict[str, float]:
    """Returns the normalised one-step error, the mean over frames and columns of ((y_pred - y_true) / std)².

    Predicting the mean everywhere has error 1 if `std` is the standard deviation of the same data.

    Args:
        y_true: [N, Dy] true outputs.
        y_pred: [N, Dy] predicted outputs, in the same units.
        layout: names the columns.
        std: [Dy] standard deviations, or 1 if both are already normalised.

    Returns:
        `all`, and the error of each group of `GROUPS` that the layout has; dimensionless.

    Source: test error of Mason et al. 2018, section 8, by groups of columns.
    """
    _same_shape(y_true, y_pred)
    if y_true.shape[-1] != layout.output_size:
        raise ValueError(f"y needs the {layout.output_size} columns of layout {layout.name}, got {y_true.shape[-1]}.")
    columns = np.mean(((np.asarray(y_pred, float) - y_true) / std) ** 2, axis=0)
    errors = {"all": float(columns.mean())}
    for group, blocks in GROUPS.items():
        own = [columns[layout.output_slice(block)] for block in blocks if layout.has_output(block)]
        if own:
            errors[group] = float(np.concatenate(own).mean())
    return errors


def bone_length_error(positions: np.ndarray, parents: np.ndarray, lengths: np.ndarray) -> float:
    """Returns the mean over frames and bones of | ‖p_joint - p_parent‖ - L |, in metres.

    Args:
        positions: [T, J, 3] metres.
        parents: [J] index of each joint's parent, -1 for the root, which has no bone.
        lengths: [J] metres, true length of the bone from each joint's parent to the joint (the root's is ignored).

    Source: Mason et al. 2022, Eq. 5b.
    """
    parents = np.asarray(parents)
    joints = np.flatnonzero(parents >= 0)
    found = np.linalg.norm(positions[:, joints] - positions[:, parents[joints]], axis=-1)
    return float(np.abs(found - np.asarray(lengths)[joints]).mean())


def planted_heights(feet: np.ndarray, quantile: float = 0.1) -> np.ndarray:
    """Returns the height [F] of planted foot joints in metres, a low quantile of heights in real motion [T, F, 3]."""
    return np.quantile(feet[..., 1], quantile, axis=0)


def foot_skating(feet: np.ndarray, fps: float, ground: np.ndarray | float = 0.0, limit: float = 0.025) -> float:
    """Returns the sliding speed of feet near the ground in m/s, the mean of v_xz (2 - 2^clamp(h / H, 0, 1)).

    The mean is over frames and foot joints. The weight is 1 on the ground and 0 from height H upwards. Divide by `fps`
    for the published distance per frame. Feet that swing close to the ground also count, so compare with the value of
    real motion; where contacts are known, `contact_sliding` is exact.

    Args:
        feet: [T, F, 3] metres.
        fps: frames per second.
        ground: [F] metres, resting heights; h is the height above them, averaged over the two frames of a step.
        limit: H, metres.

    Source: Zhang et al. 2018 (MANN), section 8; later work also uses H = 0.033 m.
    """
    height = feet[..., 1] - ground
    return float((_horizontal_speed(feet, fps) * _near_ground((height[1:] + height[:-1]) / 2, limit)).mean())


def near_ground_skating(feet: np.ndarray, fps: float, ground: np.ndarray | float = 0.0, limit: float = 0.025) -> float:
    """Returns the speed of feet near the ground in m/s, Σ ‖Δp‖ clamp(2 - 2^(|h| / H), 0, 1) over non-zero weights.

    Unlike `foot_skating`, feet in the air do not lower it, as the sum is divided by the number of weights that are not
    zero, and vertical motion counts. Divide by `fps` for the published distance per frame.

    Args:
        feet: [T, F, 3] metres, T at least 2.
        fps: frames per second.
        ground: [F] metres, resting heights (0 in the published code); h is the height above them after a step.
        limit: H, metres.

    Returns:
        m/s, 0 if no foot is near the ground.

    Source: code of RSMT (Tang et al. 2023), `skating_loss` of its benchmark.
    """
    weight = _near_ground(np.abs(feet[1:, :, 1] - ground), limit)
    speed = np.linalg.norm(np.diff(feet, axis=0), axis=-1) * fps
    return float((speed * weight).sum() / max(np.count_nonzero(weight), 1))


def sliding_over_travel(toes: np.ndarray, root: np.ndarray, height_limit: float = 0.01) -> float:
    """Returns the mean horizontal step of toes near the ground over the mean horizontal step of the root.

    The lowest toe of the motion is put at height 0. A step counts if it begins less than `height_limit` above that.
    The published code also counts a step of length 0 after the last frame. In motion on the spot the ratio is large,
    since its denominator is small.

    Args:
        toes: [T, F, 3] metres, T at least 2.
        root: [T, 3] metres, the hips.
        height_limit: metres.

    Returns:
        Dimensionless; 0 if no step counts, NaN if the root does not move.

    Source: code of CAMDM (Chen et al. 2024), `cal_metric_foot_sliding` of its evaluation.
    """
    low = toes[:-1, :, 1] - toes[..., 1].min() < height_limit
    steps, travel = _horizontal_speed(toes, 1.0)[low], _horizontal_speed(root, 1.0).mean()
    if not steps.size:
        return 0.0
    return float(steps.mean() / travel) if travel > 0 else float("nan")


def skating_ratio(
    feet: np.ndarray,
    fps: float,
    ground: np.ndarray | float = 0.0,
    height_limit: float = 0.05,
    speed_limit: float = 0.5,
    window: int = 5,
) -> float:
    """Returns the fraction of frames in which at least one foot joint slides.

    A joint slides if it is less than `height_limit` above `ground` in two adjacent frames and its horizontal speed
    exceeds `speed_limit`, both in that step and on average over the `window` steps around it. As with `foot_skating`,
    feet that swing close to the ground count: compare with the ratio of real motion.

    Args:
        feet: [T, F, 3] metres, T at least 2.
        fps: frames per second.
        ground: [F] metres, resting heights.
        height_limit: metres.
        speed_limit: m/s.
        window: number of frames averaged.

    Source: Karunratanakul et al. 2023 (Guided Motion Diffusion), evaluation.
    """
    speed = _horizontal_speed(feet, fps)
    low = (feet[..., 1] - ground) < height_limit
    low = low[1:] & low[:-1]
    half = window // 2
    padded = np.pad(speed, ((half, window - 1 - half), (0, 0)), mode="edge")
    average = np.lib.stride_tricks.sliding_window_view(padded, window, axis=0).mean(axis=-1)
    return float((low & (speed > speed_limit) & (average > speed_limit)).any(axis=-1).mean())


def contact_sliding(feet: np.ndarray, contacts: np.ndarray, fps: float) -> float:
    """Returns the mean horizontal speed in m/s of foot joints between adjacent frames that are both in contact.

    Args:
        feet: [T, F, 3] metres.
        contacts: [T, F] bool.
        fps: frames per second.

    Returns:
        m/s, or NaN if no joint is in contact for two adjacent frames.
    """
    both = contacts[1:] & contacts[:-1]
    return float(_horizontal_speed(feet, fps)[both].mean()) if both.any() else float("nan")


def jitter(positions: np.ndarray, fps: float) -> float:
    """Returns the mean jerk ‖Δ³p‖ fps³ in m/s³ over frames and joints of positions [T, J, 3] in metres."""
    return float(np.linalg.norm(np.diff(positions, n=3, axis=0), axis=-1).mean() * fps**3)


@dataclass(frozen=True)
class TrajectoryError:
    """Distances from a path on the ground.

    Attributes:
        mean: metres, over all frames.
        final: metres, in the last frame.
        failed: fraction of frames with a distance above the limit.
    """

    mean: float
    final: float
    failed: float


def trajectory_error(achieved: np.ndarray, commanded: np.ndarray, limit: float = 0.5) -> TrajectoryError:
    """Returns the distance between the achieved and the commanded root position of the same frame.

    Args:
        achieved: [T, 2] metres, x and z.
        commanded: [T, 2] metres.
        limit: metres, beyond which a frame has failed.

    Source: Karunratanakul et al. 2023 (Guided Motion Diffusion), evaluation.
    """
    _same_shape(achieved, commanded)
    return _summary(np.linalg.norm(achieved - commanded, axis=-1), limit)


def path_error(achieved: np.ndarray, path: np.ndarray, limit: float = 0.5) -> TrajectoryError:
    """Returns the distance between the root and the nearest point of a path, which ignores timing.

    Args:
        achieved: [T, 2] metres, x and z.
        path: [M, 2] metres, at least 2 points joined by straight lines.
        limit: metres, beyond which a frame has failed.
    """
    start, along = path[:-1], np.diff(path, axis=0)
    squared = np.maximum((along**2).sum(axis=-1), 1e-12)
    distances = np.empty(len(achieved))
    for rows in _chunks(len(achieved), len(along)):
        away = achieved[rows, None] - start
        share = np.clip((away * along).sum(axis=-1) / squared, 0.0, 1.0)
        distances[rows] = np.linalg.norm(away - share[..., None] * along, axis=-1).min(axis=-1)
    return _summary(distances, limit)


def npss(true: np.ndarray, pred: np.ndarray) -> float:
    """Returns the normalised power spectrum similarity (NPSS) of two sets of sequences; 0 for equal spectra.

    For every sequence n and feature d, the power spectrum over time is divided by its sum. The distance between the two
    cumulative spectra (the sum of absolute differences, an earth mover's distance in bins) is averaged over all n and d
    with the true total power as weight. Shifts in time do not matter, and features without power have no weight.

    Args:
        true: [N, T, D].
        pred: [N, T, D].

    Source: Gopalakrishnan et al. 2019, section 4.
    """
    _same_shape(true, pred)
    power_true, power_pred = (np.abs(np.fft.fft(values, axis=1)) ** 2 for values in (true, pred))
    total = power_true.sum(axis=1)
    distance = np.abs(_cumulative(power_true) - _cumulative(power_pred)).sum(axis=1)
    weight = total.sum()
    return float((distance * total).sum() / weight) if weight > 0 else 0.0


def _cumulative(power: np.ndarray) -> np.ndarray:
    total = power.sum(axis=1, keepdims=True)
    return np.cumsum(power / np.where(total > 0, total, 1.0), axis=1)


def achieved_turn_rate(yaw: np.ndarray, fps: float) -> float:
    """Returns a clip's mean turn rate in degrees per second, positive to the left, from the root yaw [T] in radians.

    The yaw may be wrapped.
    """
    turned = np.unwrap(np.asarray(yaw, float))
    return float(np.rad2deg(turned[-1] - turned[0]) * fps / (len(turned) - 1))


def nearest_pose_distance(poses: np.ndarray, real: np.ndarray) -> np.ndarray:
    """Returns the distance [N] in metres of each pose to the nearest real pose, a root mean square over joints.

    Args:
        poses: [N, J, 3] metres, relative to the root's position and heading.
        real: [M, J, 3] metres, relative to the same frame.

    Poses are processed in chunks, so memory stays below some tens of megabytes for any N and M.
    """
    num_joints = poses.shape[1]
    queries, known = (np.asarray(p, float).reshape(len(p), -1) for p in (poses, real))
    lengths = (known**2).sum(axis=-1)
    distances = np.empty(len(queries))
    for rows in _chunks(len(queries), len(known)):
        nearest = np.argmin(lengths - 2.0 * queries[rows] @ known.T, axis=-1)
        distances[rows] = np.linalg.norm(queries[rows] - known[nearest], axis=-1)
    return distances / np.sqrt(num_joints)


def _chunks(rows: int, width: int, entries: int = 2_000_000):
    size = max(1, entries // max(1, width))
    return (slice(start, start + size) for start in range(0, rows, size))


def _near_ground(height: np.ndarray, limit: float) -> np.ndarray:
    """Returns the weight of a foot by its height: 1 on the ground and below, 0 from `limit` upwards."""
    return 2.0 - 2.0 ** np.clip(height / limit, 0.0, 1.0)


def _horizontal_speed(points: np.ndarray, fps: float) -> np.ndarray:
    return np.linalg.norm(np.diff(points[..., [0, 2]], axis=0), axis=-1) * fps


def _summary(distances: np.ndarray, limit: float) -> TrajectoryError:
    return TrajectoryError(float(distances.mean()), float(distances[-1]), float((distances > limit).mean()))


def _same_shape(a: np.ndarray, b: np.ndarray) -> None:
    if np.shape(a) != np.shape(b):
        raise ValueError(f"Both arrays must have the same shape, got {np.shape(a)} and {np.shape(b)}.")
