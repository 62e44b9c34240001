"""A small network that classifies motion, by style or any other label: recognition accuracy and Fréchet distance.

Its input is a window of one second of joint positions and velocities relative to the root of each frame. The window
contains neither the character's position and heading on the ground nor bones, file names and lengths of takes. Two
convolutions over time, a mean over the window and a dense layer compute features; a second dense layer computes the
logits of the labels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from pfnn_jax.errors import check_at_least, check_probability
from pfnn_jax.models.dropout import drop
from pfnn_jax.training.loop import chunks, no_progress, scan_steps, train_steps

WIDTH = 5
"""Frames in the kernel of a convolution."""

CHUNK = 512
"""Windows evaluated at once, which limits memory."""

ROUND_UP = 1024
"""The number of training windows is filled up to a multiple of this, so that training compiles once for sets of about
the same size."""


@dataclass(frozen=True)
class ClassifierConfig:
    """Sizes and training schedule of the classifier.

    Attributes:
        filters: number of filters of each convolution.
        features: width of the feature layer, which the Fréchet distance compares.
        epochs: passes over the windows.
        batch_size: windows per minibatch.
        learning_rate: initial learning rate of Adam, with cosine decay to zero.
        dropout: drop probability before the dense layers.
        noise: standard deviation of the noise added to normalised windows, which hides small jitter.
        seed: seed of initialisation, shuffling, dropout and noise.
    """

    filters: int = 64
    features: int = 32
    epochs: int = 12
    batch_size: int = 64
    learning_rate: float = 1e-3
    dropout: float = 0.3
    noise: float = 0.3
    seed: int = 0

    def __post_init__(self):
        check_at_least(self, "filters", "features", "epochs", "batch_size")
        check_probability(self, "dropout")


@struct.dataclass
class StyleClassifier:
    """Parameters of the classifier.

    Attributes:
        filters: two arrays [WIDTH, in, out] of the convolutions.
        weights: two arrays [in, out] of the dense layers.
        biases: four arrays [out], of the convolutions and the dense layers.
        mean, std: [F] statistics of the training windows.
    """

    filters: tuple[jax.Array, jax.Array]
    weights: tuple[jax.Array, jax.Array]
    biases: tuple[jax.Array, jax.Array, jax.Array, jax.Array]
    mean: jax.Array
    std: jax.Array


def init_classifier(
    config: ClassifierConfig, num_columns: int, num_labels: int, mean: np.ndarray, std: np.ndarray
) -> StyleClassifier:
    """Returns an untrained classifier of windows with F columns: He-normal weights, zero biases."""
    keys = jax.random.split(jax.random.key(config.seed), 4)
    shapes = [
        (WIDTH, num_columns, config.filters),
        (WIDTH, config.filters, config.filters),
        (config.filters, config.features),
        (config.features, num_labels),
    ]
    arrays = [
        jax.random.normal(key, shape) * (2.0 / np.prod(shape[:-1])) ** 0.5
        for key, shape in zip(keys, shapes, strict=True)
    ]
    zeros = [jnp.zeros(shape[-1]) for shape in shapes]
    return StyleClassifier(
        filters=(arrays[0], arrays[1]),
        weights=(arrays[2], arrays[3]),
        biases=(zeros[0], zeros[1], zeros[2], zeros[3]),
        mean=jnp.asarray(mean, jnp.float32),
        std=jnp.asarray(std, jnp.float32),
    )


def train_classifier(
    windows: np.ndarray, labels: np.ndarray, num_labels: int | None = None, config: ClassifierConfig | None = None
) -> StyleClassifier:
    """Trains a classifier on real windows by cross entropy, with equal total weight for every label.

    Args:
        windows: [N, T, F] as returned by `motion_windows`, mirror images included.
        labels: [N] indices of styles, or of other labels, from 0.
        num_labels: L; the largest label plus one by default.
        config: sizes and schedule.

    Raises:
        ValueError: if the numbers of windows and labels differ or are zero, or if a label is out of range.
    """
    config = config or ClassifierConfig()
    labels = np.asarray(labels, np.int32)
    _check(windows, labels, num_labels)
    num_labels = int(labels.max()) + 1 if num_labels is None else num_labels
    mean, std = windows.mean(axis=(0, 1)), np.maximum(windows.std(axis=(0, 1)), 1e-3)
    classifier = init_classifier(config, windows.shape[-1], num_labels, mean, std)
    count = np.bincount(labels, minlength=num_labels)
    weight = jnp.asarray(np.where(count > 0, len(labels) / (np.maximum(count, 1) * (count > 0).sum()), 0.0))
    batch_size = min(config.batch_size, len(labels))
    rounds = len(labels) // batch_size
    num_steps = config.epochs * rounds
    state = (_trained(classifier), optax.scale_by_adam().init(_trained(classifier)), jnp.int32(0))
    spare = -len(labels) % ROUND_UP  # never drawn
    data = tuple(jnp.asarray(np.concatenate([part, part[:1].repeat(spare, 0)])) for part in (windows, labels))
    frozen = classifier, weight, jnp.float32(num_steps)
    scan, rng = _compiled(replace(config, seed=0)), np.random.default_rng(config.seed)

    def epoch(state: Any, first: int, count: int) -> tuple[Any, Any]:
        order = rng.permutation(len(labels))[: count * batch_size].reshape(count, batch_size)
        key = jax.random.fold_in(jax.random.key(config.seed), first // rounds + 1)
        return scan(state, (jnp.asarray(order), jax.random.split(key, count)), data, frozen)

    state = train_steps(state, epoch, chunks(0, num_steps, rounds), no_progress)
    return replace(classifier, **state[0])


def features(classifier: StyleClassifier, windows: np.ndarray) -> np.ndarray:
    """Returns the features [N, config.features] of windows [N, T, F]."""
    return _in_chunks(lambda part: _hidden(classifier, part), windows)


def scores(classifier: StyleClassifier, windows: np.ndarray) -> np.ndarray:
    """Returns the logits [N, L] of the labels for windows [N, T, F]."""
    hidden = features(classifier, windows)
    return hidden @ np.asarray(classifier.weights[1]) + np.asarray(classifier.biases[3])


def recognition_accuracy(classifier: StyleClassifier, windows: np.ndarray, labels: np.ndarray) -> float:
    """Returns the share of windows [N, T, F] whose predicted label equals `labels` [N]."""
    return float(np.mean(scores(classifier, windows).argmax(axis=1) == np.asarray(labels)))


def confusion_matrix(classifier: StyleClassifier, windows: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Returns the confusion matrix [L, L]: number of windows of label i (row) predicted as label j (column)."""
    num_labels = classifier.biases[3].shape[0]
    predicted = scores(classifier, windows).argmax(axis=1)
    pairs = np.asarray(labels) * num_labels + predicted
    return np.bincount(pairs, minlength=num_labels**2).reshape(num_labels, num_labels)


def frechet_distance(features_a: np.ndarray, features_b: np.ndarray) -> float:
    """Returns the Fréchet distance between Gaussians fitted to two sets of features [N, D] and [M, D].

    Covariances are shrunk towards multiples of the identity (Ledoit and Wolf 2004). The amount is estimated from the
    samples and vanishes as their number grows.

    Source: Heusel et al. 2017 for images; used on features of motion by Park et al. 2021.
    """
    a, b = (np.asarray(values, np.float64) for values in (features_a, features_b))
    return gaussian_frechet(a.mean(axis=0), shrunk_covariance(a), b.mean(axis=0), shrunk_covariance(b))


def gaussian_frechet(mean_a: np.ndarray, cov_a: np.ndarray, mean_b: np.ndarray, cov_b: np.ndarray) -> float:
    """Returns ‖μ_a - μ_b‖² + Tr(Σ_a + Σ_b - 2 (Σ_a^½ Σ_b Σ_a^½)^½), for means [D] and covariances [D, D]."""
    values, vectors = np.linalg.eigh(cov_a)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    between = np.linalg.eigvalsh(root @ cov_b @ root)
    cross = np.sqrt(np.maximum(between, 0.0)).sum()
    return float(max(((mean_a - mean_b) ** 2).sum() + np.trace(cov_a) + np.trace(cov_b) - 2.0 * cross, 0.0))


def shrunk_covariance(samples: np.ndarray) -> np.ndarray:
    """Returns the covariance [D, D] of samples [N, D], shrunk towards its mean variance times the identity.

    Source: Ledoit and Wolf 2004, "A well-conditioned estimator for large-dimensional covariance matrices", lemma 3.3.
    """
    # As sklearn.covariance.ledoit_wolf, because scikit-learn is only installed with the extra of the experiments.
    centred = samples - samples.mean(axis=0)
    count, size = centred.shape
    covariance = centred.T @ centred / count
    target = np.trace(covariance) / size * np.eye(size)
    spread = ((covariance - target) ** 2).sum()
    # Σ_n ‖x_n x_nᵀ - S‖² = Σ_n ‖x_n‖⁴ - N ‖S‖²
    noise = ((centred**2).sum(axis=1) ** 2).sum() / count**2 - (covariance**2).sum() / count
    share = 1.0 if spread <= 0 else min(1.0, max(noise, 0.0) / spread)
    return (1.0 - share) * covariance + share * target


def _check(windows: np.ndarray, labels: np.ndarray, num_labels: int | None) -> None:
    if windows.ndim != 3 or len(windows) != len(labels) or not len(labels):
        raise ValueError(f"`windows` must be [N, T, F] with N labels, got {windows.shape} and {labels.shape}.")
    if labels.min() < 0 or (num_labels is not None and labels.max() >= num_labels):
        raise ValueError(f"`labels` must lie in 0 to {num_labels}, got {labels.min()} to {labels.max()}.")


def _trained(classifier: StyleClassifier) -> dict:
    return {name: getattr(classifier, name) for name in ("filters", "weights", "biases")}


def _convolve(x: jax.Array, filters: jax.Array, bias: jax.Array) -> jax.Array:
    """Returns the ReLU of a convolution over time with stride 2: [N, T / 2, out] of [N, T, in]."""
    dimensions = ("NWC", "WIO", "NWC")
    y = jax.lax.conv_general_dilated(x, filters, (2,), "SAME", dimension_numbers=dimensions)
    return jax.nn.relu(y + bias[None, None])


def _layers(classifier: StyleClassifier, x: jax.Array, rate: float = 0.0, keys=None) -> jax.Array:
    """Returns the features [N, features] of normalised windows [N, T, F]; with `keys`, under dropout."""
    for filters, bias in zip(classifier.filters, classifier.biases[:2], strict=True):
        x = _convolve(x, filters, bias)
    pooled = x.mean(axis=1)
    if keys is not None:
        pooled = drop(keys[0], jnp.float32(rate), pooled)
    return jax.nn.relu(pooled @ classifier.weights[0] + classifier.biases[2][None])


@jax.jit
def _hidden(classifier: StyleClassifier, windows: jax.Array) -> jax.Array:
    return _layers(classifier, _normalised(classifier, windows))


def _normalised(classifier: StyleClassifier, windows: jax.Array) -> jax.Array:
    return (windows - classifier.mean[None, None]) / classifier.std[None, None]


@lru_cache
def _compiled(config: ClassifierConfig) -> Callable:
    """Returns compiled steps of training, (state, draws, data, frozen) -> (state, losses).

    The state is (trained arrays, state of Adam, steps taken), a draw (rows [B], key), data (windows, labels), and
    frozen (classifier, weight of each label, steps in all).
    """
    adam = optax.scale_by_adam()

    def loss(trained, windows, labels, key, classifier, weight):
        model = replace(classifier, **trained)
        keys = jax.random.split(key, 3)
        x = _normalised(model, windows)
        x = x + config.noise * jax.random.normal(keys[0], x.shape)
        hidden = drop(keys[1], jnp.float32(config.dropout), _layers(model, x, config.dropout, keys[2:]))
        logits = hidden @ model.weights[1] + model.biases[3][None]
        own = optax.softmax_cross_entropy_with_integer_labels(logits, labels)
        return jnp.mean(weight[labels] * own)

    def step(state, batch, frozen):
        trained, moments, taken = state
        classifier, weight, num_steps = frozen
        value, gradient = jax.value_and_grad(loss)(trained, *batch, classifier, weight)
        updates, moments = adam.update(gradient, moments)
        # cosine decay, not as a schedule of Optax, whose number of steps is compiled
        rate = config.learning_rate * 0.5 * (1.0 + jnp.cos(jnp.pi * taken / num_steps))
        trained = optax.apply_updates(trained, jax.tree.map(lambda leaf: -rate * leaf, updates))
        return (trained, moments, taken + 1), value

    def read(data: Any, draw: Any) -> Any:
        (windows, labels), (rows, key) = data, draw
        return windows[rows], labels[rows], key

    return scan_steps(step, read, rolled=False)  # convolutions


def _in_chunks(work, windows: np.ndarray) -> np.ndarray:
    parts: Sequence[np.ndarray] = [
        np.asarray(work(jnp.asarray(windows[start : start + CHUNK], jnp.float32)))
        for start in range(0, len(windows), CHUNK)
    ]
    return np.concatenate(parts)
