"""Style transfer by optimisation over hidden units (Holden et al. 2016, the method that the paper of 2017 replaces).

A first loop moves hidden units from the content's towards the Gram matrix of the style, a second one until the motion
obeys the content's constraints. Both are compiled into one program, for clips padded to a few lengths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import comb

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from pfnn_jax.models.convolution import POOLING
from pfnn_jax.motion.features.normaliser import Statistics
from pfnn_jax.transfer.autoencoder import MotionAutoencoder
from pfnn_jax.transfer.clip_rows import FEET
from pfnn_jax.transfer.config import LossWeights, OptimisationConfig
from pfnn_jax.transfer.layout import LAYOUT_FPS, ClipLayout
from pfnn_jax.transfer.losses import (
    Constraints,
    bone_loss,
    content_constraints,
    content_loss,
    foot_loss,
    gram,
    root_rates,
    row_points,
    style_loss,
    trajectory_loss,
)
from pfnn_jax.transfer.run import TransferRun

MARGIN = 26
"""Frames of padding at both ends of a clip: a convolution reads zeros beyond its ends, which are the mean pose, and a
frame of the result sees 25 frames to either side through encoder and decoder."""

SMOOTHING = tuple(comb(16, tap) / 2**16 for tap in range(17))
"""Binomial weights of 17 frames, a Gaussian with a standard deviation of 2: it halves 5 Hz and removes what alternates
from frame to frame."""

SPEED_RATIOS = (0.5, 2.0)
"""Bounds of the ratio by which a content's velocity is scaled."""

MIN_SPEED = 0.3
"""Metres per second below which a clip stands."""

MIN_STEPS = 2
"""Steps below which a clip has no step length."""


@struct.dataclass
class Task:
    """One clip to transfer, padded to [P, D]; all arrays on the device.

    Attributes:
        x: [P, D] the content, normalised.
        content: [P / 2, F] its hidden units.
        target: [F, F] Gram matrix of the style.
        constraints: of the P frames.
        mask: [P] 1 for the clip's frames and 0 for padding.
    """

    x: jax.Array
    content: jax.Array
    target: jax.Array
    constraints: Constraints
    mask: jax.Array


def optimise(
    run: TransferRun,
    content_rows: np.ndarray,
    style_rows: Sequence[np.ndarray],
    config: OptimisationConfig | None = None,
    *,
    key: jax.Array,
) -> np.ndarray:
    """Returns the rows [T, D] of the content in the style, in layout units.

    Args:
        run: its autoencoder, statistics and layout.
        content_rows: [T, D] in layout units.
        style_rows: one or more clips of the style, [S, D] each.
        config: weights and schedule.
        key: of the noise where the optimisation starts at noise.
    """
    config, frames = config or OptimisationConfig(), len(content_rows)
    task = make_task(run, content_rows, style_rows, scale_speed=config.scale_speed)
    # Weights and learning rate are arguments of the compiled program, so that others do not compile it again.
    weights = jax.tree.map(jnp.float32, vars(config.weights))
    rows = _optimise(
        run.autoencoder, _arrays(run.statistics), task, weights, jnp.float32(config.learning_rate), key,
        layout=run.layout, config=replace(config, weights=LossWeights(), learning_rate=1.0),
    )  # fmt: skip
    return np.asarray(rows, np.float64)[MARGIN : MARGIN + frames]  # in NumPy: JAX compiles a slice of every length


def make_task(
    run: TransferRun, content_rows: np.ndarray, style_rows: Sequence[np.ndarray], *, scale_speed: bool = True
) -> Task:
    """Returns the task of transferring a content [T, D] into the style of some clips [S, D], in layout units."""
    frames, ratio = len(content_rows), 1.0
    if scale_speed:
        ratio = speed_ratio(content_rows, style_rows, run.layout)
    size = padded_length(frames)
    padded = pad_edges(content_rows, size)
    x = jnp.asarray(run.statistics.apply(padded), jnp.float32)
    return Task(
        x=x,
        content=_encode(run.autoencoder, x),
        target=style_gram(run, style_rows),
        constraints=content_constraints(padded, run.layout, ratio),
        mask=jnp.asarray(clip_mask(frames, size)),
    )


def style_gram(run: TransferRun, style_rows: Sequence[np.ndarray]) -> jax.Array:
    """Returns the Gram matrix [F, F] of all frames of some clips [S, D] of one style, in layout units."""
    frames = [len(rows) for rows in style_rows]
    grams = [
        gram(hidden_units(run, rows), loss_mask(clip_mask(len(rows), padded_length(len(rows))))) for rows in style_rows
    ]
    return jnp.stack([one * (count / sum(frames)) for one, count in zip(grams, frames, strict=True)]).sum(axis=0)


def hidden_units(run: TransferRun, rows: np.ndarray) -> jax.Array:
    """Returns the hidden units [P / 2, F] of a clip [T, D] in layout units, padded as in `pad_edges`."""
    padded = run.statistics.apply(pad_edges(rows, padded_length(len(rows))))
    return _encode(run.autoencoder, jnp.asarray(padded, jnp.float32))


def speed_ratio(content_rows: np.ndarray, style_rows: Sequence[np.ndarray], layout: ClipLayout) -> float:
    """Returns the ratio of the style's step length to the content's, within bounds; 1 if either takes no steps.

    The result steps when the content does. At the ratio of speeds, as in the authors' code of 2016, a style of quick
    steps would get long ones.
    """
    content = step_length(content_rows, layout)
    styles = [length for length in (step_length(rows, layout) for rows in style_rows) if length is not None]
    if content is None or not styles:
        return 1.0
    return float(np.clip(np.mean(styles) / content, *SPEED_RATIOS))


def step_length(rows: np.ndarray, layout: ClipLayout) -> float | None:
    """Returns the distance in metres that the root travels in a step of rows [T, D], or None without steps.

    A step begins when one ankle passes the other.
    """
    speed = np.linalg.norm(root_rates(np.asarray(rows, float), layout)[0], axis=-1)
    left, _, right, _ = FEET
    at = row_points(np.asarray(rows, float), layout)
    passing = np.flatnonzero(np.diff(np.sign(at[:, left, 2] - at[:, right, 2])))
    if len(passing) < MIN_STEPS + 1 or speed.mean() < MIN_SPEED:
        return None
    return float(speed[passing[0] : passing[-1]].sum() / LAYOUT_FPS / (len(passing) - 1))


def padded_length(frames: int) -> int:
    """Returns P, the number of frames that a clip is padded to with its margins: a power of two.

    Padding at most doubles the time of a transfer, a fraction of a second for most clips. Compiling for another length
    takes seconds, and a program that runs for long, like the page, keeps what it has compiled.
    """
    return 1 << (frames + 2 * MARGIN - 1).bit_length()


def pad_edges(rows: np.ndarray, size: int) -> np.ndarray:
    """Pads rows [T, D] to [P, D] by `MARGIN` times the first row, and the last row to the end.

    The root moves on as in the clip's first and last frame: standing still would add frames of another gait.
    """
    frames = np.clip(np.arange(size) - MARGIN, 0, len(rows) - 1)
    return rows[frames]


def clip_mask(frames: int, size: int) -> np.ndarray:
    """Returns [P], 1 for the frames of a clip in its padded rows and 0 for padding."""
    mask = np.zeros(size, np.float32)
    mask[MARGIN : MARGIN + frames] = 1.0
    return mask


def loss_mask(mask: jax.Array | np.ndarray) -> jax.Array:
    """Returns the weights [P / 2] of hidden units: those that frames of the clip are decoded from count alike."""
    pairs = mask.reshape(-1, POOLING).max(axis=1)
    reach = MARGIN // (2 * POOLING)
    padded = jnp.pad(jnp.asarray(pairs), reach)
    return jnp.max(jnp.stack([padded[shift : shift + len(pairs)] for shift in range(2 * reach + 1)]), axis=0)


def _arrays(statistics: Statistics) -> tuple[jax.Array, jax.Array]:
    return jnp.asarray(statistics.mean, jnp.float32), jnp.asarray(statistics.std, jnp.float32)


@jax.jit
def _encode(autoencoder: MotionAutoencoder, x: jax.Array) -> jax.Array:
    return autoencoder.encode(x)


@partial(jax.jit, static_argnames=("layout", "config"))
def _optimise(
    autoencoder: MotionAutoencoder,
    statistics: tuple[jax.Array, jax.Array],
    task: Task,
    weights: dict[str, jax.Array],
    learning_rate: jax.Array,
    key: jax.Array,
    *,
    layout: ClipLayout,
    config: OptimisationConfig,
) -> jax.Array:
    """Returns the rows [P, D] of the result in layout units."""
    mean, std = statistics
    counts = loss_mask(task.mask)

    def decode(hidden: jax.Array) -> jax.Array:
        result = autoencoder.decode(hidden)
        if config.keep_detail:
            result = add_change(task.x, autoencoder.decode(task.content), result)
        return result * std[None] + mean[None]

    def transfer_loss(hidden: jax.Array) -> jax.Array:
        own = weights["content"] * content_loss(hidden, task.content, counts)
        return own + weights["style"] * style_loss(hidden, task.target, counts)

    def constraint_loss(hidden: jax.Array) -> jax.Array:
        rows = decode(hidden)
        losses = {"foot": foot_loss, "bone": bone_loss, "trajectory": trajectory_loss}
        terms = [weights[name] * loss(rows, task.constraints, layout, task.mask) for name, loss in losses.items()]
        return jnp.stack(terms).sum()

    hidden = task.content if config.start == "content" else _noise(task, key)
    hidden, _ = descend(transfer_loss, hidden, learning_rate, config.iterations)
    hidden, _ = descend(constraint_loss, hidden, learning_rate, config.constraint_iterations)
    return decode(hidden)


def _noise(task: Task, key: jax.Array) -> jax.Array:
    """Returns random hidden units [P / 2, F], at least 0, in the proportions of the style's."""
    return jnp.sqrt(jnp.diagonal(task.target))[None] * jnp.abs(jax.random.normal(key, task.content.shape))


def add_change(x: jax.Array, before: jax.Array, after: jax.Array) -> jax.Array:
    """Returns x [T, D] plus the smoothed change from its projection to that of the result, all normalised.

    An autoencoder loses detail, and depooling adds steps of two frames: what it makes of a clip jerks several times as
    much. Both cancel where only the change is taken from it. The change of a style is slow, so that smoothing it costs
    nothing.

    Args:
        x: [T, D] the content.
        before: [T, D] its projection.
        after: [T, D] the projection of the result.
    """
    half = len(SMOOTHING) // 2
    change = jnp.pad(after - before, ((half, half), (0, 0)), mode="edge")
    # A convolution of each column by itself: as a sum of shifted slices it takes XLA minutes to compile with gradients.
    kernel = jnp.asarray(SMOOTHING, change.dtype)[None, None]
    return x + jax.lax.conv_general_dilated(change.T[:, None], kernel, (1,), "VALID")[:, 0].T


def descend(
    loss: Callable[[jax.Array], jax.Array], start: jax.Array, learning_rate: jax.Array, iterations: int
) -> tuple[jax.Array, jax.Array]:
    """Returns what `iterations` steps of Adam make of an array, and the loss [iterations] before each step."""
    tx = optax.adam(learning_rate)

    def step(state: tuple, _: None) -> tuple[tuple, jax.Array]:
        value, opt_state = state
        found, gradient = jax.value_and_grad(loss)(value)
        updates, opt_state = tx.update(gradient, opt_state)
        return (optax.apply_updates(value, updates), opt_state), found

    (value, _), losses = jax.lax.scan(step, (start, tx.init(start)), None, length=iterations)
    return value, losses
