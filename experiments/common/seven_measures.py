"""What a model of Mason 2022 is measured by: one step on held-out takes, and walks on circles in every style."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.common.seven_models import Model
from experiments.common.seven_takes import Take, Takes, common_columns, rows_of, windows_of
from pfnn_jax.control.loop.rollout import stability
from pfnn_jax.control.stability import PEAK_RATIO, TURN_RATE, is_stable_turn, walk_circles
from pfnn_jax.evaluation.metrics import bone_length_error, foot_skating, resting_heights
from pfnn_jax.evaluation.motion_windows import motion_windows
from pfnn_jax.evaluation.style_classifier import (
    StyleClassifier,
    confusion_matrix,
    features,
    frechet_distance,
    recognition_accuracy,
    scores,
)
from pfnn_jax.evaluation.style_test import predict_rows
from pfnn_jax.inference.predictor import Predictor
from pfnn_jax.models.style import Style
from pfnn_jax.motion.features.decode import root_steps
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.skeleton import Skeleton, need_roles

CHUNK = 4096
"""Rows predicted at once."""

GROUPS = {
    "trajectory": ("trajectory_",),
    "pose": ("joint_position", "joint_forward", "joint_up"),
    "velocity": ("joint_velocity",),
    "contacts": ("foot_contacts",),
}
"""Groups of the common columns, by how their blocks' names begin."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Real motion that generated motion is compared with.

    Attributes:
        classifier: of the styles.
        styles: S names, in the order of the classifier's labels.
        features: style -> features [N, D] of real walking windows.
        ground: [F] metres, resting heights of the feet's joints.
    """

    classifier: StyleClassifier
    styles: tuple[str, ...]
    features: Mapping[str, np.ndarray]
    ground: np.ndarray


def is_walk(take: Take) -> bool:
    """Whether a take walks, whatever way, and does not run."""
    return not take.content.startswith(("run", "dash"))


def make_reference(classifier: StyleClassifier, styles: Sequence[str], takes: Sequence[Take]) -> Reference:
    """The reference from real takes; those that run are left out, as the walks on circles do not."""
    walking = [take for take in takes if is_walk(take)]
    found = {}
    for style in dict.fromkeys(take.style for take in walking):
        found[style] = features(classifier, windows_of([t for t in walking if t.style == style], styles)[0])
    ground = resting_heights(np.concatenate([_feet(take) for take in walking]))
    return Reference(classifier, tuple(styles), found, ground)


def real_motion(takes: Sequence[Take], reference: Reference) -> dict[str, Any]:
    """The same measures of real takes: what a perfect model could reach."""
    windows, labels = windows_of(takes, reference.styles)
    walking = [take for take in takes if is_walk(take)]
    own = features(reference.classifier, windows_of(walking, reference.styles)[0])
    others = np.concatenate([reference.features[style] for style in dict.fromkeys(take.style for take in walking)])
    skating = [foot_skating(_feet(take), take.clip.fps, reference.ground) for take in walking]
    return {
        "windows": len(windows),
        "recognition": recognition_accuracy(reference.classifier, windows, labels),
        "confusion": confusion_matrix(reference.classifier, windows, labels).tolist(),
        "frechet": frechet_distance(own, others),
        "skating": float(np.mean(skating)),
    }


def one_step(model: Model, takes: Sequence[Take], styles: Mapping[str, Style | None] | None = None) -> dict[str, Any]:
    """One-step errors on takes, in each take's own style.

    Args:
        model: trained.
        takes: real ones.
        styles: take's style -> what the model shall run in; its own style of that name by default.

    Returns:
        `mse` over the columns that all models have and of each of `GROUPS`, in normalised units squared; `bones`,
        metres, mean over bones; `bone_loss`, metres, Eq. 5b; `per_style`: style -> mse; `all_outputs`: mse over all
        columns of the model's own layout.
    """
    layout, normaliser = model.layout, model.normaliser
    columns = common_columns(layout)
    groups = {name: _columns(layout, beginnings) for name, beginnings in GROUPS.items()}
    lengths = np.linalg.norm(model.skeleton.offsets, axis=-1)
    own_styles = list(dict.fromkeys(take.style for take in takes))
    sums, counts, bones, per_style = np.zeros(layout.output_size), 0, [], {}
    for style in own_styles:
        rows = rows_of([take for take in takes if take.style == style], layout.name)
        predicted = predict(model.predictor(styles[style] if styles else style), rows.x, rows.phase)
        squared = ((predicted - rows.y) / np.asarray(normaliser.outputs.std)) ** 2
        per_style[style] = float(squared[:, columns].mean())
        sums, counts = sums + squared.sum(axis=0, dtype=np.float64), counts + len(squared)
        joints = predicted[:, layout.output_slice("joint_position")].reshape(len(predicted), -1, 3) * layout.length_unit
        bones.append((len(joints), bone_length_error(joints, model.skeleton.parents, lengths)))
    mean = sums / counts
    bone = float(np.average([error for _, error in bones], weights=[count for count, _ in bones]))
    joints = model.skeleton.num_joints
    return {
        "mse": float(mean[columns].mean()),
        **{name: float(mean[found].mean()) for name, found in groups.items()},
        "all_outputs": float(mean.mean()),
        "bones": bone,
        "bone_loss": bone * (joints - 1) / joints,
        "per_style": per_style,
    }


def predict(predictor: Predictor, x: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """[N, Dy] outputs of rows, in layout units; the last chunk is filled up so that one size is compiled."""
    parts = []
    for start in range(0, len(x), CHUNK):
        rows = np.minimum(np.arange(start, start + CHUNK), len(x) - 1)
        parts.append(np.asarray(predict_rows(predictor, jnp.asarray(x[rows]), jnp.asarray(phase[rows]))))
    return np.concatenate(parts)[: len(x)]


def walks(
    model: Model, predictor: Predictor, takes: Sequence[Take], seconds: float, starts: int, speed: float | None = None
):
    """Walks on circles to both sides, begun in the first rows of the style's walking takes.

    Returns:
        Frames with a leading axis of 2 per start, and the speed asked for, m/s.
    """
    layout = model.layout
    walking = [take for take in takes if is_walk(take)][:starts]
    first = [take.rows[layout.name] for take in walking]
    if speed is None:
        travel, _ = root_steps(layout, rows_of(walking, layout.name, mirrored=False).y)
        speed = max(float(np.linalg.norm(travel, axis=1).mean()), 0.3)
    found = [walk_circles(predictor, layout, rows.x[0], rows.phase[0], speed, seconds) for rows in first]
    return jax.tree.map(lambda *leaves: np.concatenate([np.asarray(leaf) for leaf in leaves]), *found), speed


def rollout_test(
    model: Model,
    style: str,
    takes: Sequence[Take],
    reference: Reference,
    *,
    seconds: float,
    starts: int,
    predictor: Predictor | None = None,
) -> dict[str, Any]:
    """Walks on circles in one style: do they stay sound, follow the path, stand still on their feet, look like it?

    Args:
        model: trained.
        style: name of the style among the reference's.
        takes: real ones of the style: first poses, speed, and how far a pose may be from the mean.
        reference: real motion.
        seconds: of each walk; the first second is not judged.
        starts: number of first poses, each walked to both sides.
        predictor: of the model in another style; in its own style of that name by default.

    Returns:
        `walks`, `finite`, `sound` (shares), `pose_peak` (over the real one's), `path_error` (m), `speed` (achieved
        over commanded), `turn_rate` (likewise), `skating` (m/s), `bones` (m), `recognition` (share of windows),
        `taken_for` (windows by style) and `features` (of the windows, an array). What cannot be judged, as no walk
        stayed finite, is None.
    """
    layout, normaliser = model.layout, model.normaliser
    predictor = predictor or model.predictor(style)
    frames, speed = walks(model, predictor, takes, seconds, starts)
    mean, std = (jnp.asarray(v, jnp.float32) for v in (normaliser.outputs.mean, normaliser.outputs.std))
    found = jax.vmap(partial(stability, layout), in_axes=(0, None, None))(frames, mean, std)
    pose = layout.output_slice("joint_position")
    real = rows_of([take for take in takes if is_walk(take)], layout.name).y
    own = np.mean(normaliser.outputs.apply(real)[:, pose] ** 2, axis=1).max()
    finite = np.asarray(found.finite)
    settled = np.asarray(frames.joint_positions)[finite, round(layout.fps) :]
    return {
        "walks": len(finite),
        "finite": float(finite.mean()),
        "sound": float(is_stable_turn(found, PEAK_RATIO * own).mean()),
        "pose_peak": _mean(np.asarray(found.pose_peak)[finite] / own),
        "path_error": _mean(np.asarray(found.trajectory_error)[finite]),
        "speed": _mean(np.asarray(found.speed)[finite] / speed),
        "turn_rate": _mean(np.abs(np.asarray(found.turn_rate)[finite]) / TURN_RATE),
        **_body(settled, model.skeleton, layout, reference),
        **_recognised(settled, style, model.skeleton, layout, reference),
    }


def pooled_frechet(results: Mapping[str, Mapping[str, Any]], reference: Reference) -> float | None:
    """Fréchet distance between all styles' generated windows together and the real ones of the same styles."""
    generated = [found["features"] for found in results.values()]
    real = [reference.features[style] for style in results]
    if any(part is None or not len(part) for part in generated):
        return None
    # every style weighs the same on both sides, whatever its number of real windows
    count = min(len(part) for part in real)
    rng = np.random.default_rng(0)
    return frechet_distance(
        np.concatenate(generated), np.concatenate([part[rng.permutation(len(part))[:count]] for part in real])
    )


def _body(settled: np.ndarray, skeleton: Skeleton, layout: FrameLayout, reference: Reference) -> dict[str, Any]:
    roles = need_roles(skeleton)
    feet = [*roles.left_foot, *roles.right_foot]
    lengths = np.linalg.norm(skeleton.offsets, axis=-1)
    return {
        "skating": _mean([foot_skating(one[:, feet], layout.fps, reference.ground) for one in settled]),
        "bones": _mean([bone_length_error(one, skeleton.parents, lengths) for one in settled]),
    }


def _recognised(settled: np.ndarray, style: str, skeleton: Skeleton, layout, reference: Reference) -> dict[str, Any]:
    parts = [motion_windows(one, need_roles(skeleton), layout.fps) for one in settled]
    windows = np.concatenate(parts) if parts else np.zeros((0, 0, 0), np.float32)
    if not len(windows):
        return {"recognition": None, "taken_for": None, "features": None}
    taken_for = scores(reference.classifier, windows).argmax(axis=1)
    return {
        "recognition": float(np.mean(taken_for == reference.styles.index(style))),
        "taken_for": np.bincount(taken_for, minlength=len(reference.styles)).tolist(),
        "features": features(reference.classifier, windows),
    }


def _feet(take: Take) -> np.ndarray:
    roles = need_roles(take.clip.skeleton)
    positions, _ = forward_kinematics(take.clip.skeleton, take.clip.root_positions, take.clip.rotations)
    return positions[:, [*roles.left_foot, *roles.right_foot]]


def _columns(layout: FrameLayout, beginnings: tuple[str, ...]) -> np.ndarray:
    return np.flatnonzero([name.startswith(beginnings) for name in layout.output_names])


def _mean(values) -> float | None:
    values = np.asarray(values, float)
    return float(values.mean()) if values.size else None


def held_out_takes(takes: Takes, style: str) -> list[Take]:
    """The test takes of one style, walking ones first; training ones where none walks."""
    own = [take for take in takes.test if take.style == style and is_walk(take)]
    return own or [take for take in takes.train if take.style == style and is_walk(take)]
