"""Measures of the models of Mason 2022: one-step errors on held-out takes, and walks on circles in every style."""

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
from pfnn_jax.evaluation.metrics import bone_length_error, foot_skating, planted_heights
from pfnn_jax.evaluation.motion_windows import motion_windows
from pfnn_jax.evaluation.style_classifier import (
    StyleClassifier,
    confusion_matrix,
    features,
    frechet_distance,
    recognition_accuracy,
    scores,
)
from pfnn_jax.inference.predictor import Predictor
from pfnn_jax.inference.rows import evaluate_rows
from pfnn_jax.models.style import Style
from pfnn_jax.motion.features.decode import root_steps
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.skeleton import Skeleton, need_roles

GROUPS = {
    "trajectory": ("trajectory_",),
    "pose": ("joint_position", "joint_forward", "joint_up"),
    "velocity": ("joint_velocity",),
    "contacts": ("foot_contacts",),
}
"""Groups of the common columns, by prefixes of their blocks' names."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Real motion to which generated motion is compared.

    Attributes:
        classifier: classifier of the styles.
        styles: S names, in the order of the classifier's labels.
        features: style -> features [N, D] of real walking windows.
        ground: [F] metres, resting heights of the feet's joints.
    """

    classifier: StyleClassifier
    styles: tuple[str, ...]
    features: Mapping[str, np.ndarray]
    ground: np.ndarray


def is_walk(take: Take) -> bool:
    """Returns whether a take is a walk in any direction, and not a run."""
    return not take.content.startswith(("run", "dash"))


def make_reference(classifier: StyleClassifier, styles: Sequence[str], takes: Sequence[Take]) -> Reference:
    """Returns the reference from real takes without runs, because the generated motion on circles is walking."""
    walking = [take for take in takes if is_walk(take)]
    found = {}
    for style in dict.fromkeys(take.style for take in walking):
        found[style] = features(classifier, windows_of([t for t in walking if t.style == style], styles)[0])
    ground = planted_heights(np.concatenate([_feet(take) for take in walking]))
    return Reference(classifier, tuple(styles), found, ground)


def real_motion(takes: Sequence[Take], reference: Reference) -> dict[str, Any]:
    """Returns the same measures of real takes, the values of a perfect model."""
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
    """Returns one-step errors on takes, each predicted in its own style.

    Args:
        model: a trained model.
        takes: real takes.
        styles: style of a take -> parameters of the style; the model's style of that name by default.

    Returns:
        `mse` over the columns common to all models and for each of `GROUPS`, in squared normalised units; `bones`, the
        mean error of bone lengths in metres; `bone_loss` in metres, Eq. 5b; `per_style`: style -> mse; `all_outputs`:
        mse over all columns of the model's layout.
    """
    layout, normaliser = model.layout, model.normaliser
    columns = common_columns(layout)
    groups = {name: _columns(layout, beginnings) for name, beginnings in GROUPS.items()}
    lengths = np.linalg.norm(model.skeleton.offsets, axis=-1)
    own_styles = list(dict.fromkeys(take.style for take in takes))
    sums, counts, bones, per_style = np.zeros(layout.output_size), 0, [], {}
    for style in own_styles:
        rows = rows_of([take for take in takes if take.style == style], layout.name)
        predicted = evaluate_rows(model.predictor(styles[style] if styles else style), rows.x, rows.phase)
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


def walks(
    model: Model, predictor: Predictor, takes: Sequence[Take], seconds: float, starts: int, speed: float | None = None
):
    """Generates walks on circles to both sides, started in the first rows of the style's walking takes.

    Returns:
        Frames with a leading axis of 2 per start, and the commanded speed in m/s.
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
    """Measures stability, path, foot sliding and recognised style of walks on circles in one style.

    Args:
        model: a trained model.
        style: name of the style in the reference.
        takes: real takes of the style, for first poses, speed, and the largest distance of a pose from the mean.
        reference: real motion.
        seconds: length of each walk; the first second is not evaluated.
        starts: number of first poses, each walked to both sides.
        predictor: the model in another style; in its own style of that name by default.

    Returns:
        `walks`, `finite` and `sound` (shares of finite and of stable walks), `pose_peak` (relative to real motion),
        `path_error` (m), `speed` and `turn_rate` (achieved over commanded), `skating` (m/s), `bones` (m), `recognition`
        (share of windows), `taken_for` (windows by predicted style) and `features` (array, of the windows). Values that
        need a finite walk are None if there is none.
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
    joints = np.asarray(frames.joint_positions)[finite, round(layout.fps) :]
    return {
        "walks": len(finite),
        "finite": float(finite.mean()),
        "sound": float(is_stable_turn(found, PEAK_RATIO * own).mean()),
        "pose_peak": _mean(np.asarray(found.pose_peak)[finite] / own),
        "path_error": _mean(np.asarray(found.trajectory_error)[finite]),
        "speed": _mean(np.asarray(found.speed)[finite] / speed),
        "turn_rate": _mean(np.abs(np.asarray(found.turn_rate)[finite]) / TURN_RATE),
        **_body(joints, model.skeleton, layout, reference),
        **_recognised(joints, style, model.skeleton, layout, reference),
    }


def pooled_frechet(results: Mapping[str, Mapping[str, Any]], reference: Reference) -> float | None:
    """Returns the Fréchet distance between the generated windows of all styles and the real windows of these styles."""
    generated = [found["features"] for found in results.values()]
    real = [reference.features[style] for style in results]
    if any(part is None or not len(part) for part in generated):
        return None
    # Every style has the same weight on both sides, regardless of its number of real windows.
    count = min(len(part) for part in real)
    rng = np.random.default_rng(0)
    return frechet_distance(
        np.concatenate(generated), np.concatenate([part[rng.permutation(len(part))[:count]] for part in real])
    )


def _body(joints: np.ndarray, skeleton: Skeleton, layout: FrameLayout, reference: Reference) -> dict[str, Any]:
    roles = need_roles(skeleton)
    feet = [*roles.left_foot, *roles.right_foot]
    lengths = np.linalg.norm(skeleton.offsets, axis=-1)
    return {
        "skating": _mean([foot_skating(one[:, feet], layout.fps, reference.ground) for one in joints]),
        "bones": _mean([bone_length_error(one, skeleton.parents, lengths) for one in joints]),
    }


def _recognised(joints: np.ndarray, style: str, skeleton: Skeleton, layout, reference: Reference) -> dict[str, Any]:
    parts = [motion_windows(one, need_roles(skeleton), layout.fps) for one in joints]
    windows = np.concatenate(parts) if parts else np.zeros((0, 0, 0), np.float32)
    if not len(windows):
        return {"recognition": None, "taken_for": None, "features": None}
    predicted = scores(reference.classifier, windows).argmax(axis=1)
    return {
        "recognition": float(np.mean(predicted == reference.styles.index(style))),
        "taken_for": np.bincount(predicted, minlength=len(reference.styles)).tolist(),
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
    """Returns the walking test takes of one style, or its walking training takes if there are none."""
    own = [take for take in takes.test if take.style == style and is_walk(take)]
    return own or [take for take in takes.train if take.style == style and is_walk(take)]
