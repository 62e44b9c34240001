"""Learning one style from a short clip, a whole grid of settings at once (Mason 2018 §7).

A *method* says what is trained: an adapter beside the frozen shared network, or, as the paper's baselines, a whole
network. Freezing means not differentiating: the frozen parameters are an argument of their own.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.layers import style_kinds
from pfnn_jax.models.network import Dropout, Network, config_of, init_network
from pfnn_jax.models.style import Style, init_style
from pfnn_jax.training.data import Batch
from pfnn_jax.training.steps import Bones, Objective, predict_batch

ROWS = 512
"""Frames to a multiple of which rows are padded: 4 seconds and their mirror image."""

EPOCHS = 5
"""Epochs between two calls of `progress_callback`."""

_LARGEST = np.iinfo(np.uint32).max


@struct.dataclass
class Setting:
    """One point of the grid, or the whole grid on a leading axis G."""

    learning_rate: jax.Array  # []
    main_dropout: jax.Array  # []
    adapter_dropout: jax.Array  # []


@struct.dataclass
class FewShotState:
    """What few-shot training changes, for one setting or, on a leading axis, for a grid or a bank."""

    trained: Any
    optimiser: Any


def init_few_shot_state(trained: Any) -> FewShotState:
    """A state at epoch 0 from the parameters to be trained."""
    return FewShotState(trained, optax.scale_by_adam().init(trained))


def assemble(trained: Any, shared: Network) -> tuple[Network, Style | None]:
    """The network and adapter to run: (shared, adapter), or (network, None) where a whole network was trained."""
    return (trained, None) if isinstance(trained, Network) else (shared, trained)


def few_shot_step(
    state: FewShotState, setting: Setting, shared: Network, batch: Batch, key: jax.Array, objective: Objective
) -> FewShotState:
    """One Adam step of one setting on one minibatch; only `state.trained` is differentiated."""
    dropout = Dropout(main=setting.main_dropout, adapter=setting.adapter_dropout)

    def loss(trained):
        network, style = assemble(trained, shared)
        return objective.loss(predict_batch(network, style, batch, dropout, key), batch.y, (trained,))[0]

    update, optimiser = optax.scale_by_adam().update(jax.grad(loss)(state.trained), state.optimiser)
    trained = jax.tree.map(lambda value, change: value - setting.learning_rate * change, state.trained, update)
    return FewShotState(trained, optimiser)


class EpochTrainer:
    """Trains a leading axis of states: settings over one style's frames, or styles under one setting.

    Args:
        shared: pretrained parameters, not changed.
        data: [N, ...] frames, or with `per_style` [S, N, ...].
        batch_size: frames of a minibatch; a last incomplete one is dropped.
        objective: the loss.
        key: of shuffling and dropout; the key of an epoch is folded from it and the epoch's number.
        per_style: whether states are of styles, each with its own frames.
    """

    def __init__(
        self,
        shared: Network,
        data: Batch,
        batch_size: int,
        objective: Objective,
        key: jax.Array,
        *,
        per_style: bool = False,
    ) -> None:
        axis = 1 if per_style else 0
        self._count = jax.tree.leaves(data)[0].shape[axis]
        self._inputs = _put((shared, pad_rows(data, axis, math.lcm(ROWS, batch_size))))
        self._key = key
        self._options = {
            "batch_size": batch_size,
            "objective": objective,
            "per_style": per_style,
            "sorts": sorts_of(self._count),
        }

    def train(
        self,
        states: FewShotState,
        settings: Setting,
        epochs: tuple[int, int],
        progress_callback: Callable[[int], Any] = lambda number: None,
    ) -> FewShotState:
        """Returns the states after the epochs [first, last); calls back with the number done, `EPOCHS` at a time."""
        shared, data = self._inputs
        states, settings = _put((states, settings))
        for first in range(*epochs, EPOCHS):
            last = min(first + EPOCHS, epochs[1])
            counts = np.asarray([first, last, self._count], np.int32)
            states = _train_many(states, settings, shared, data, counts, self._key, **self._options)
            jax.block_until_ready(states)
            progress_callback(last)
        return states


def row_errors(trained: Any, shared: Network, data: Batch) -> np.ndarray:
    """Squared normalised error [G, N], mean over outputs, of every setting on each of N frames, without dropout."""
    count = len(data.x)
    trained, shared, data = _put((trained, shared, pad_rows(data, 0, ROWS)))
    return np.asarray(_row_errors(trained, shared, data))[:, :count]


def pad_rows(data: Batch, axis: int, multiple: int) -> Batch:
    """Frames repeated along `axis` until their number is a multiple; those added are never trained on."""
    count = jax.tree.leaves(data)[0].shape[axis]
    rows = np.arange(-(-count // multiple) * multiple) % count
    return jax.tree.map(lambda leaf: np.take(np.asarray(leaf), rows, axis=axis), data)


def sorts_of(count: int) -> int:
    """How often a shuffle of `count` frames sorts by random bits, so that equal bits leave no trace."""
    return max(1, math.ceil(3 * math.log(max(count, 1)) / math.log(_LARGEST)))


def padded_permutation(key: jax.Array, size: int, count: jax.Array, sorts: int) -> jax.Array:
    """Numbers [size] of which the first `count` are those below `count`, in the order of `jax.random.permutation`.

    Args:
        key: of the order.
        size: fixed, at least `count`.
        count: [] how many are to be shuffled.
        sorts: as `sorts_of` tells for `count`.
    """
    numbers = jnp.arange(size, dtype=jnp.int32)
    order = numbers
    for _ in range(sorts):
        key, subkey = jax.random.split(key)
        bits = jax.random.bits(subkey, (size,), jnp.uint32)
        bits = jnp.where(numbers < count, bits, jnp.uint32(_LARGEST))  # stable: the padding stays last
        order = jax.lax.sort_key_val(bits, order)[1]
    return order


def _train_epochs(
    state: FewShotState, setting: Setting, shared: Network, data: Batch, counts, key, batch_size: int, objective, sorts
) -> FewShotState:
    """One setting trained on one style; counts [3]: first epoch, the one before which to end, frames."""
    size, (first, last, num_frames) = data.phase.shape[0], counts

    def one_epoch(epoch, state):
        order_key, step_key = jax.random.split(jax.random.fold_in(key, epoch))
        order = padded_permutation(order_key, size, num_frames, sorts)
        keys = jax.random.split(step_key, size // batch_size)

        def one_step(index, state):
            frames = jax.lax.dynamic_slice(order, (index * batch_size,), (batch_size,))
            batch = jax.tree.map(lambda leaf: leaf[frames], data)
            return few_shot_step(state, setting, shared, batch, keys[index], objective)

        return jax.lax.fori_loop(0, num_frames // batch_size, one_step, state)

    return jax.lax.fori_loop(first, last, one_epoch, state)


@partial(jax.jit, static_argnames=("batch_size", "objective", "per_style", "sorts"), donate_argnums=0)
def _train_many(states, settings, shared, data, counts, key, *, batch_size, objective, per_style, sorts):
    """A leading axis of states trained at once."""

    def one(state, setting, data):
        return _train_epochs(state, setting, shared, data, counts, key, batch_size, objective, sorts)

    return jax.vmap(one, in_axes=(0, None, 0) if per_style else (0, 0, None))(states, settings, data)


@jax.jit
def _row_errors(trained, shared: Network, data: Batch) -> jax.Array:
    def one(trained):
        y = predict_batch(*assemble(trained, shared), data, None, None)
        return jnp.mean((y - data.y) ** 2, axis=1)

    return jax.vmap(one)(trained)


def _put(tree: Any) -> Any:
    """The tree on the default device and bound to it: what is bound is compiled anew where it was not before."""
    return jax.device_put(tree, jax.devices()[0])


METHODS = (*style_kinds(), "fine_tune", "scratch")
"""Every kind of style, and training of all weights from the shared network's or from random ones."""

if TYPE_CHECKING:
    Method: TypeAlias = str
else:
    Method = Literal[METHODS]  # the command line lists these as choices


@dataclass(frozen=True)
class FewShotConfig:
    """How a style is learned from a clip.

    Every combination of rates is one setting of the grid; all are trained at once by `vmap`, each is looked at after
    every number of epochs in `eval_epochs`, and one (setting, stop) is chosen.

    Attributes:
        method: `cp`, `full`, `diagonal`, `bias` or `dense` adapters; `one_hot`, a shift of the first layer; `film`,
            the 4H numbers of a Film beside a network trained with FiLM; `fine_tune` (all shared weights, from the
            pretrained ones) and `scratch` (all weights, from a fresh network) are the baselines of §8.1.
        rank: R of a CP adapter.
        learning_rates: Adam's rates to try.
        main_dropouts: drop probabilities before the shared layers to try.
        adapter_dropouts: drop probabilities before the adapter to try (the variable dropout of §7.2).
        eval_epochs: numbers of epochs after which to look, increasing; the last is the length of training.
        batch_size: frames of a minibatch.
        l1: λ of Eq. 3 on what is trained; a Film, whose scales are one and not zero where nothing is changed, bears
            no penalty.
        bone_length: weight of the bone-length loss, where the rows' bones are known.
        held_out: share of the clip's frames, at its end, that choose among the settings.
        tolerance: how much larger than the best a setting's held-out error may be; of those within it the gentlest
            (least learning rate times epochs) is taken. The frames of a straight walk favour settings that fit
            straight walks; 0 takes the best of them.
        seed: of initialisation, shuffling and dropout.
    """

    method: Method = "cp"
    rank: int = 30
    learning_rates: tuple[float, ...] = (1e-4, 1e-3)
    main_dropouts: tuple[float, ...] = (0.0, 0.3)
    adapter_dropouts: tuple[float, ...] = (0.3,)
    eval_epochs: tuple[int, ...] = (5, 10, 25, 50, 100)
    batch_size: int = 32
    l1: float = 0.01
    bone_length: float = 1.0
    held_out: float = 0.2
    tolerance: float = 0.5
    seed: int = 0

    def __post_init__(self):
        if self.method not in METHODS:
            raise ValueError(f"FewShotConfig.method must be one of {', '.join(METHODS)}, got {self.method!r}.")
        if not self.eval_epochs or list(self.eval_epochs) != sorted(set(self.eval_epochs)) or self.eval_epochs[0] < 1:
            raise ValueError(
                f"FewShotConfig.eval_epochs must be increasing whole numbers from 1, got {self.eval_epochs}."
            )
        if not 0 < self.held_out < 1:
            raise ValueError(f"FewShotConfig.held_out must lie between 0 and 1, got {self.held_out}.")
        for name in ("tolerance", "l1", "bone_length"):
            if getattr(self, name) < 0:
                raise ValueError(f"FewShotConfig.{name} must not be negative, got {getattr(self, name)}.")
        for name in ("main_dropouts", "adapter_dropouts"):
            rates = getattr(self, name)
            if not rates or not all(0 <= rate < 1 for rate in rates):
                raise ValueError(f"FewShotConfig.{name} must be rates in [0, 1), got {rates}.")
        if not self.learning_rates or not all(rate > 0 for rate in self.learning_rates):
            raise ValueError(f"FewShotConfig.learning_rates must be positive, got {self.learning_rates}.")


MASON2018_FEW_SHOT = FewShotConfig(
    learning_rates=(1e-4,), main_dropouts=(0.3,), adapter_dropouts=(0.3, 0.5, 0.7), eval_epochs=(100,)
)
"""Mason 2018 §7.2: CP of rank 30, 100 epochs at 1e-4, a grid over the authors' rates of adapter dropout alone."""

FILM_FEW_SHOT = FewShotConfig("film", learning_rates=(1e-4, 1e-3, 3e-3), main_dropouts=(0.0,))
"""Beside a network trained with FiLM: the 4H numbers of a Film, at rates that move them in a few epochs."""


class Choice(NamedTuple):
    """A setting and its stopping point, with the error that ranked it."""

    learning_rate: float
    main_dropout: float
    adapter_dropout: float
    epochs: int
    held_out_error: float


class Candidate(NamedTuple):
    """A choice and what it trained: an adapter, or a whole network for the baselines."""

    choice: Choice
    trained: Any


def settings_grid(config: FewShotConfig) -> Setting:
    """All combinations of the configured rates; leaves [G]."""
    rows = list(itertools.product(config.learning_rates, config.main_dropouts, config.adapter_dropouts))
    return Setting(*(jnp.asarray(column, jnp.float32) for column in zip(*rows, strict=True)))


def initial_parameters(config: FewShotConfig, shared: Network, key: jax.Array, start: Style | None = None) -> Any:
    """What the method starts from: `start`, a fresh style, the pretrained network, or a fresh network.

    Args:
        config: the method.
        shared: pretrained parameters.
        key: of what is fresh.
        start: a style of the method's kind, e.g. for `film` the mean of the run's styles; None for a fresh one.
    """
    if start is not None and config.method not in ("fine_tune", "scratch"):
        return jax.tree.map(jnp.asarray, start)
    if config.method == "fine_tune":
        return shared
    sizes = config_of(shared)
    if config.method == "scratch":
        return init_network(sizes, key=key)
    return init_style(AdapterConfig(config.method, config.rank), sizes.hidden, sizes.num_control_points, key=key)


def train_grid(
    shared: Network,
    data: Batch,
    held_out: Batch,
    config: FewShotConfig,
    *,
    start: Style | None = None,
    bones: Bones | None = None,
    progress_callback: Callable[[int], Any] = lambda number: None,
) -> list[Candidate]:
    """Train every setting of the grid; the candidates of all eval_epochs, best held-out error first.

    Args:
        shared: pretrained style-agnostic parameters, not changed.
        data: [N, ...] normalised frames to learn from (mirrored ones included).
        held_out: [M, ...] frames of the same clip that rank the candidates.
        config: the grid.
        start: style to begin with, see `initial_parameters`.
        bones: of the rows, for the bone-length loss; None leaves it out.
        progress_callback: told, every few epochs, how many are done.

    Raises:
        ValueError: if there are fewer training frames than a minibatch.
    """
    if data.phase.shape[0] < config.batch_size:
        raise ValueError(f"`data` must have at least {config.batch_size} frames, got {data.phase.shape[0]}.")
    settings = settings_grid(config)
    count = settings.learning_rate.shape[0]
    init_key, train_key = jax.random.split(jax.random.key(config.seed))
    first = initial_parameters(config, shared, init_key, start)
    states = jax.vmap(lambda _: init_few_shot_state(first))(jnp.arange(count))
    trainer = EpochTrainer(shared, data, config.batch_size, _objective(config, bones), train_key)
    candidates, begin = [], 0
    for stop in config.eval_epochs:
        states = trainer.train(states, settings, (begin, stop), progress_callback)
        errors = row_errors(states.trained, shared, held_out).mean(axis=1)
        candidates += _candidates(states.trained, settings, stop, errors)
        begin = stop
    return sorted(candidates, key=lambda candidate: candidate.choice.held_out_error)


def _candidates(trained, settings: Setting, stop: int, errors: np.ndarray) -> list[Candidate]:
    rates = zip(*(np.asarray(leaf, float).tolist() for leaf in jax.tree.leaves(settings)), strict=True)
    host = jax.tree.map(np.asarray, trained)
    candidates = []
    for index, ((learning_rate, main, adapter), error) in enumerate(zip(rates, errors, strict=True)):
        ranked_by = float(error) if np.isfinite(error) else float("inf")
        choice = Choice(_decimal(learning_rate), _decimal(main), _decimal(adapter), stop, ranked_by)
        candidates.append(Candidate(choice, jax.tree.map(lambda leaf, i=index: leaf[i], host)))
    return candidates


def _decimal(rate: float) -> float:
    """A single-precision rate as it was written: 0.3, not 0.30000001."""
    return float(f"{rate:.6g}")


def choose(
    candidates: Sequence[Candidate], tolerance: float, is_stable: Callable[[Any], bool] | None = None
) -> Candidate:
    """The gentlest stable candidate among those almost as good as the best; else the best-ranked stable one.

    Args:
        candidates: best first, as `train_grid` returns them.
        tolerance: share by which a held-out error may exceed the best one's.
        is_stable: judges the trained parameters by rollouts on paths that turn; None passes all.

    Returns:
        The choice; the best-ranked candidate if none is stable.
    """
    limit = candidates[0].choice.held_out_error * (1 + tolerance)
    near = [candidate for candidate in candidates if candidate.choice.held_out_error <= limit]
    near.sort(key=lambda candidate: candidate.choice.learning_rate * candidate.choice.epochs)
    for candidate in (*(near if tolerance else ()), *candidates):
        if is_stable is None or is_stable(candidate.trained):
            return candidate
    return candidates[0]


def refit(
    shared: Network,
    data: Batch,
    choice: Choice,
    config: FewShotConfig,
    *,
    start: Style | None = None,
    bones: Bones | None = None,
    progress_callback: Callable[[int], Any] = lambda number: None,
) -> Any:
    """Train the chosen setting once more on all frames [N, ...], the held-out ones included."""
    data, options = jax.tree.map(lambda leaf: leaf[None], data), {"start": start, "bones": bones}
    bank = train_bank(shared, data, choice, config, progress_callback=progress_callback, **options)
    return jax.tree.map(lambda leaf: np.asarray(leaf[0]), bank)


def train_bank(
    shared: Network,
    data: Batch,
    choice: Choice,
    config: FewShotConfig,
    *,
    start: Style | None = None,
    bones: Bones | None = None,
    progress_callback: Callable[[int], Any] = lambda number: None,
) -> Any:
    """Many styles at once under one setting: data [S, N, ...] -> trained parameters [S, ...], by `vmap`."""
    init_key, train_key = jax.random.split(jax.random.key(config.seed))
    setting = Setting(*(jnp.asarray(rate, jnp.float32) for rate in choice[:3]))
    first = initial_parameters(config, shared, init_key, start)
    states = jax.vmap(lambda _: init_few_shot_state(first))(jnp.arange(data.phase.shape[0]))
    trainer = EpochTrainer(shared, data, config.batch_size, _objective(config, bones), train_key, per_style=True)
    return trainer.train(states, setting, (0, choice.epochs), progress_callback).trained


def _objective(config: FewShotConfig, bones: Bones | None) -> Objective:
    return Objective(l1=config.l1, bone_length=config.bone_length if bones is not None else 0.0, bones=bones)
