"""Stability of a style on turns: rollouts on circles to both sides, by which few-shot learning chooses a setting."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.compiling import jit_quickly
from pfnn_jax.control.loop.pursuit import make_timed_path
from pfnn_jax.control.loop.rollout import Frames, Stability, follow_path, stability
from pfnn_jax.control.loop.state import initial_state
from pfnn_jax.control.loop.step import LoopConfig
from pfnn_jax.inference.predictor import Predictor, assemble_predictor, evaluate
from pfnn_jax.models.network import Network
from pfnn_jax.models.placement import commit
from pfnn_jax.motion.features.decode import median_speed
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.motion.paths import circle
from pfnn_jax.training.few_shot_learning import assemble

TURN_RATE = np.deg2rad(45.0)
"""Radians per second of the circles: a brisk turn, a full circle in 8 seconds."""

SECONDS = 4.0
"""Duration of each rollout: half a circle, and several steps in which to diverge."""

PEAK_RATIO = 3.0
"""A rollout diverges if a pose is further from the mean than this many times the clip's own peak (mean squared,
normalised)."""

MIN_TURN_SHARE = 0.5
"""Share of the commanded turn rate that must be reached. The excess may be as large as the allowed shortfall."""


def predictor_of(trained: Any, shared: Network, normaliser: Normaliser) -> Predictor:
    """Returns the predictor of few-shot training's result: an adapter of `shared`, or a whole network."""
    network, adapter = assemble(trained, shared)
    return assemble_predictor(network, adapter, normaliser)


def walk_circles(
    predictor: Predictor,
    layout: FrameLayout,
    x: np.ndarray,
    phase: np.ndarray | float,
    speed: float,
    seconds: float,
    config: LoopConfig | None = None,
) -> Frames:
    """Runs a style on two circles at `TURN_RATE`, left and right, from the pose of a real row.

    Args:
        predictor: the network and style.
        layout: of its rows.
        x: [Dx] a row of the style, in layout units.
        phase: gating input of that row: [] radians, or [G] in layout units.
        speed: metres per second.
        seconds: duration of the rollouts.
        config: constants of the published loop, by default those of the layout.

    Returns:
        Frames with a leading axis of 2: turning left, then right.
    """
    paths = [circle(turn_rate=sign * float(TURN_RATE), speed=speed) for sign in (1.0, -1.0)]
    tracks = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(make_timed_path(path, speed, 256) for path in paths))
    points = jnp.asarray(np.stack([path.points[0] for path in paths]), jnp.float32)
    yaws = jnp.asarray([path.start_yaw for path in paths], jnp.float32)
    start = (jnp.asarray(x), jnp.asarray(phase, jnp.float32), round(seconds * layout.fps), config)
    return _walk_now(predictor, layout, tracks, points, yaws, *start)


def is_stable_turn(found: Stability, allowed_peak: float) -> np.ndarray:
    """Returns whether rollouts at `TURN_RATE` (any leading axes) are finite, stay near the data and turn enough."""
    turned = np.abs(np.asarray(found.turn_rate)) / TURN_RATE
    return (
        np.asarray(found.finite)
        & (np.asarray(found.pose_peak) <= allowed_peak)
        & (np.abs(turned - 1.0) <= 1.0 - MIN_TURN_SHARE)
    )


def make_stability_check(
    shared: Network,
    normaliser: Normaliser,
    layout: FrameLayout,
    x: np.ndarray,
    y: np.ndarray,
    phase: np.ndarray,
    config: LoopConfig | None = None,
) -> Callable[[Any], bool]:
    """Returns a function that says whether trained parameters walk both circles without diverging, for `choose`.

    Args:
        shared, normaliser, layout: of the run.
        x, y, phase: [N, ...] rows of the clip, in layout units: rollouts start from its first row, request its
            speed, and are compared with its range of poses.
        config: constants of the published loop, by default those of the layout.
    """
    pose = layout.output_slice("joint_position")
    own = np.mean(normaliser.outputs.apply(y)[:, pose] ** 2, axis=1).max()
    speed = max(median_speed(layout, y), 0.3)
    mean, std = (jnp.asarray(value, jnp.float32) for value in (normaliser.outputs.mean, normaliser.outputs.std))

    def is_stable(trained: Any) -> bool:
        predictor = commit(predictor_of(trained, shared, normaliser))
        found = _stability_now(
            layout, walk_circles(predictor, layout, x[0], phase[0], speed, SECONDS, config), mean, std
        )
        return bool(is_stable_turn(found, PEAK_RATIO * own).all())

    return is_stable


@partial(jax.jit, static_argnames=("layout", "num_frames", "config"))
def _walk(predictor: Predictor, layout: FrameLayout, tracks, points, yaws, x, phase, num_frames: int, config) -> Frames:
    def one(target, point, yaw):
        return follow_path(
            evaluate, predictor, layout, initial_state(layout, x, phase, point, yaw), target, num_frames, config=config
        )

    return jax.vmap(one)(tracks, points, yaws)


@partial(jax.jit, static_argnums=0)
def _stability(layout: FrameLayout, frames: Frames, mean: jax.Array, std: jax.Array) -> Stability:
    return jax.vmap(lambda one: stability(layout, one, mean, std))(frames)


_walk_now = jit_quickly(_walk, static_argnames=("layout", "num_frames", "config"))
_stability_now = jit_quickly(_stability, static_argnums=0)
