"""Is an adapter better that is trained through several frames of the loop?

Question  do walks come nearer to the actor's when the adapter is trained on sequences, in which the network reads the
          poses that it predicted itself, instead of on single frames?
Method    after restyled rows were learned, 150 steps of 32 sequences of 8 frames, and of 16 of 16 frames, with the
          gradient through all of them. Trajectory and phase stay those of the rows; the first pose has noise of .1.
          Sequences are the clip's, and consecutive frames of the known styles' turns, restyled.
Verdict   (8 frames, on networks without noise in pretraining, before and after) elderly 2.76 / 2.55, 2.77 / 2.67;
          feminine 3.16 / 2.97, 2.90 / 2.90; active 4.49 / 4.33, 4.73 / 4.11; normal 2.94 / 2.63, 3.08 / 2.64. In the
          controller better on one style and worse on two: not worth a second kind of training.
Run       python -m experiments.few_shot.unrolled --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from experiments.common.few_shot_recipes import (
    Learning,
    LearningData,
    clip_rows,
    learn_rows,
    learning_data,
    minimise,
)
from experiments.common.style_takes import Take
from experiments.common.turning_folds import Fold, FoldConfig, Method, NetworkKind, run_methods
from experiments.common.turning_table import PAPER
from experiments.common.varied_restyling import BASE, restyle_turns, straight_and_turning
from pfnn_jax.models.network import coefficients, forward
from pfnn_jax.models.style import Style
from pfnn_jax.motion.features.encode import Features, join_rows, select_rows
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.training.data import join_batches
from pfnn_jax.training.losses import l1_penalty

SEQUENCE = 30
"""Consecutive frames that are cut from the known styles' turns: half a second."""

SEQUENCES_PER_STYLE = 40
"""Sequences of each known style."""

POSE_BLOCKS = ("joint_position", "joint_velocity")
"""What the network reads of its own last frame."""


def pose_columns(layout: FrameLayout) -> tuple[np.ndarray, np.ndarray]:
    """Returns the columns of the pose in x and in y."""
    sides = (layout.input_size, layout.input_slice), (layout.output_size, layout.output_slice)
    x, y = (np.concatenate([np.arange(size)[columns(name)] for name in POSE_BLOCKS]) for size, columns in sides)
    return x, y


def feedback(layout: FrameLayout, normaliser: Normaliser) -> tuple[np.ndarray, np.ndarray]:
    """Returns factor and offset of the pose columns from normalised outputs to normalised inputs."""
    x, y = pose_columns(layout)
    inputs, outputs = normaliser.inputs, normaliser.outputs
    return outputs.std[y] / inputs.std[x], (outputs.mean[y] - inputs.mean[x]) / inputs.std[x]


def make_unrolled_loss(layout: FrameLayout, frames: int):
    """Returns the loss of sequences of some frames; `data.other` holds their first rows, factor and offset."""
    x_columns, y_columns = pose_columns(layout)

    def loss(style: Style, data: LearningData, learning: Learning, key: jax.Array) -> jax.Array:
        starts, factor, offset = data.other
        row_key, noise_key = jax.random.split(key)
        first = starts[jax.random.randint(row_key, (learning.batch_size,), 0, starts.shape[0])]

        def sequence(first: jax.Array, key: jax.Array) -> jax.Array:
            def frame(pose: jax.Array, row: jax.Array):
                x = data.rows.x[row].at[x_columns].set(pose)
                y = forward(data.shared, style, coefficients(data.shared, data.rows.phase[row]), x)
                return y[y_columns] * factor + offset, jnp.mean(jnp.square(y - data.rows.y[row]))

            pose = data.rows.x[first, x_columns]
            pose = pose + learning.noise * jax.random.normal(key, pose.shape)
            return jnp.mean(jax.lax.scan(frame, pose, first + jnp.arange(frames))[1])

        errors = jax.vmap(sequence)(first, jax.random.split(noise_key, learning.batch_size))
        return jnp.mean(errors) + learning.l1 * l1_penalty(style)

    return loss


def sequence_starts(frames_of_rows: np.ndarray, length: int) -> np.ndarray:
    """Returns the rows from which on `length` rows are consecutive frames; frame numbers [N] of joined parts."""
    steps = np.flatnonzero(np.diff(frames_of_rows) != 1) + 1
    ends = np.append(steps, len(frames_of_rows))
    end_of_run = ends[np.searchsorted(ends, np.arange(len(frames_of_rows)), side="right")]
    return np.flatnonzero(end_of_run - np.arange(len(frames_of_rows)) >= length)


def draw_sequences(takes: list[Take], rng: np.random.Generator) -> Features:
    """Returns random sequences of consecutive frames of turning takes and of their mirror images."""
    turning = [take for take in takes if "turn" in take.content]
    long = [part for take in turning for part in (take.rows, take.mirrored) if len(part.x) > SEQUENCE]
    found = []
    for _ in range(SEQUENCES_PER_STYLE):
        part = long[rng.integers(len(long))]
        begin = rng.integers(len(part.x) - SEQUENCE)
        found.append(select_rows(part, slice(begin, begin + SEQUENCE)))
    return join_rows(found)


def learn_unrolled(fold: Fold, kind: NetworkKind, frames: int, learning: Learning) -> Style:
    """Returns the style that is learned from restyled sequences, first by single frames and then unrolled."""
    network, rng = fold.network(kind), np.random.default_rng(fold.seed)
    parts = straight_and_turning(fold.known_takes(kind))
    turns = {style: draw_sequences(takes, rng) for style, takes in fold.known_takes(kind).items()}
    rows = join_batches([clip_rows(fold, network), restyle_turns(fold, network, parts, turns)])
    numbers = np.concatenate([part.frames for part in (*fold.clip, *turns.values())])
    starts = sequence_starts(numbers, frames)
    style = learn_rows(fold, network, rows)
    data = learning_data(fold, network, rows, (starts, *feedback(fold.layout, network.normaliser)))
    loss = make_unrolled_loss(fold.layout, frames)
    return minimise(loss, style, data, learning, jax.random.key(fold.seed))


LENGTHS = {8: Learning(150, 32, 2e-3, noise=0.1), 16: Learning(150, 16, 2e-3, noise=0.1)}
"""Frames of a sequence, and how the adapter is learned from such sequences."""

METHODS = {
    f"unrolled over {frames} frames": Method(partial(learn_unrolled, frames=frames, learning=learning))
    for frames, learning in LENGTHS.items()
}


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "unrolled", METHODS, (PAPER, BASE))
