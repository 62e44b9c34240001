"""Few-shot learning: one style from a short clip, by training a whole grid of settings at once (Mason 2018 §7).

A *method* says what is trained: an adapter for the frozen shared network or, as in the paper's baselines, a whole
network. Freezing means not differentiating: the frozen parameters are a separate argument.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.dropout import Dropout
from pfnn_jax.models.network import Network, config_of, init_network
from pfnn_jax.models.placement import commit
from pfnn_jax.models.style import Style, init_style
from pfnn_jax.training.config import FewShotConfig
from pfnn_jax.training.data import Batch, Rows, join_batches
from pfnn_jax.training.loop import TrainState, chunks, no_progress, train_steps
from pfnn_jax.training.losses import Bones, Objective
from pfnn_jax.training.precision import at_precision
from pfnn_jax.training.restyling import StyleDifferences, restyle
from pfnn_jax.training.steps import descend, predict_batch

ROWS = 512
"""Frames to a multiple of which rows are padded whose errors are measured: 4 seconds and their mirror image."""

TRAINING_ROWS = 4096
"""Frames to a multiple of which rows are padded that are trained on, or as many more as fill minibatches: 20 seconds,
their mirror image, and the restyled rows. Padding costs memory and the sorting of a few more numbers in each epoch;
another size would be compiled again."""

EPOCHS = 5
"""Epochs between two calls of `progress_callback`."""

_LARGEST = np.iinfo(np.uint32).max


class Choice(NamedTuple):
    """A setting and its number of epochs, with the error that ranked it."""

    learning_rate: float
    main_dropout: float
    adapter_dropout: float
    epochs: int
    held_out_error: float


class Candidate(NamedTuple):
    """A choice and the parameters it trained: an adapter, or a whole network for the baselines."""

    choice: Choice
    trained: Any


class FewShotResult(NamedTuple):
    """A learned style, the choice that led to it, and the ranking behind the choice."""

    style: Any
    choice: Choice
    ranking: tuple[Choice, ...]  # best held-out error first
    stable_on_turns: bool | None  # the judgement of `is_stable` on the style; None without one
    error_without_style: float  # held-out error of the network without a style, or with the style it began with


def few_shot(
    network: Network,
    rows: Rows,
    config: FewShotConfig | None = None,
    *,
    key: jax.Array | None = None,
    start: Style | None = None,
    differences: StyleDifferences | None = None,
    is_stable: Callable[[Any], bool] | None = None,
    progress_callback: Callable[[float, str], Any] = no_progress,
) -> Any:
    """Learns a style from the rows of its clip, for a frozen network; see `fit_style`, which also returns its choice.

    Returns:
        The style, or a whole network for the methods `fine_tune` and `scratch`.
    """
    options = {"key": key, "start": start, "is_stable": is_stable, "progress_callback": progress_callback}
    return fit_style(network, rows, config, differences=differences, **options).style


def fit_style(
    network: Network,
    rows: Rows,
    config: FewShotConfig | None = None,
    *,
    key: jax.Array | None = None,
    start: Style | None = None,
    differences: StyleDifferences | None = None,
    is_stable: Callable[[Any], bool] | None = None,
    progress_callback: Callable[[float, str], Any] = no_progress,
) -> FewShotResult:
    """Tries a grid of settings on the first part of a clip, chooses by its last part, and trains the choice on all.

    Args:
        network: pretrained parameters, not changed.
        rows: of the clip and, where that belongs to the style, of its mirror image (S = 1).
        config: how to learn; `FewShotConfig()`, the paper's recipe, by default.
        key: of initialisation, shuffling and dropout; by default from `config.seed`.
        start: style to begin with, see `initial_parameters`.
        differences: of the styles that the network knows, for a config that is `restyled`.
        is_stable: judges trained parameters, e.g. by rollouts on paths that turn; None accepts all.
        progress_callback: called with the share that is done, 0 to 1, and what is being done.

    Raises:
        InputError: if the clip is too short to hold out a part.
        ValueError: if fewer frames than a minibatch remain to learn from, or `differences` are needed and absent.
    """
    config = FewShotConfig() if config is None else config
    key = jax.random.key(config.seed) if key is None else key
    has_bones = rows.layout.next_frame and rows.parents is not None and rows.normaliser is not None
    options = {"key": key, "start": start, "bones": rows.bones() if has_bones else None}
    learn, held = rows.hold_out(config.held_out)
    learn = _with_restyled(learn, rows, config, differences)
    trying = _part_of(progress_callback, 0.03, 0.5, config.eval_epochs[-1], "trying settings")
    candidates = train_grid(network, learn, held, config, progress_callback=trying, **options)
    judged = itertools.count()

    def judge(trained: Any) -> bool:
        progress_callback(0.5 + 0.1 * min(next(judged) / len(candidates), 1.0), "walking in circles")
        return is_stable is None or is_stable(trained)

    error = error_without_style(network, held, start)
    chosen = choose(candidates, config.tolerance, judge, without=error)
    learning = _part_of(progress_callback, 0.6, 0.95, chosen.choice.epochs, "learning")
    everything = _with_restyled(rows.in_memory().parts[0], rows, config, differences)
    style = refit(network, everything, chosen.choice, config, progress_callback=learning, **options)
    ranking = tuple(candidate.choice for candidate in candidates)
    return FewShotResult(style, chosen.choice, ranking, None if is_stable is None else is_stable(style), error)


def _with_restyled(clip: Batch, rows: Rows, config: FewShotConfig, differences: StyleDifferences | None) -> Batch:
    """Returns the frames of a clip and, for a config that is `restyled`, the restyled rows of the known styles."""
    if not config.restyled:
        return clip
    if differences is None or rows.normaliser is None:
        raise ValueError("`differences`, and rows with a `normaliser`, are needed where `config.restyled` is set.")
    return join_batches([clip, restyle(differences, clip, rows.layout, rows.normaliser)])


def error_without_style(network: Network, held_out: Batch, start: Style | None = None) -> float:
    """Returns the error of a network on held-out frames [M, ...] without a style, or with the one to begin with."""
    without = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], network if start is None else start)
    return float(row_errors(without, network, held_out).mean())


def _part_of(
    progress_callback: Callable[[float, str], Any], begin: float, end: float, epochs: int, what: str
) -> Callable[[int], Any]:
    """Returns a callback for the epochs done that reports them as a part of the full work."""
    return lambda done: progress_callback(begin + (end - begin) * done / epochs, what)


def train_grid(
    shared: Network,
    data: Batch,
    held_out: Batch,
    config: FewShotConfig,
    *,
    key: jax.Array | None = None,
    start: Style | None = None,
    bones: Bones | None = None,
    progress_callback: Callable[[int], Any] = no_progress,
) -> list[Candidate]:
    """Trains every setting of the grid; returns the candidates of all `eval_epochs`, best held-out error first.

    Args:
        shared: pretrained style-agnostic parameters, not changed.
        data: [N, ...] normalised frames to learn from (mirrored ones included).
        held_out: [M, ...] frames of the same clip that rank the candidates.
        config: the grid.
        key: of initialisation, shuffling and dropout; by default from `config.seed`.
        start: style to begin with, see `initial_parameters`.
        bones: of the rows, for the bone-length loss; None leaves it out.
        progress_callback: called with the number of epochs done, every few epochs.

    Raises:
        ValueError: if there are fewer training frames than a minibatch.
    """
    if data.phase.shape[0] < config.batch_size:
        raise ValueError(f"`data` must have at least {config.batch_size} frames, got {data.phase.shape[0]}.")
    settings = settings_grid(config)
    init_key, train_key = _keys(config, key)
    states = _stack(initial_parameters(config, shared, start, key=init_key), len(settings.learning_rate))
    trainer = EpochTrainer(shared, data, config, bones, key=train_key)
    candidates, begin = [], 0
    for end in config.eval_epochs:
        states = trainer.train(states, settings, (begin, end), progress_callback)
        errors = row_errors(states.params, shared, held_out).mean(axis=1)
        candidates += _candidates(states.params, settings, end, errors)
        begin = end
    return sorted(candidates, key=lambda candidate: candidate.choice.held_out_error)


def choose(
    candidates: Sequence[Candidate],
    tolerance: float,
    is_stable: Callable[[Any], bool] | None = None,
    *,
    without: float = math.inf,
) -> Candidate:
    """Returns the most conservative stable candidate among those almost as good as the best.

    The most conservative has the least learning rate times epochs. Where none of them is stable, the best-ranked
    stable candidate is chosen, and the best-ranked of all where no candidate is stable.

    Args:
        candidates: best first, as `train_grid` returns them.
        tolerance: share by which a held-out error may exceed the best one's.
        is_stable: judges the trained parameters by rollouts on paths that turn; None accepts all.
        without: held-out error of the network alone (`error_without_style`), if known. Candidates that remove less
            than half as much of it as the best are left out: where the network nearly fits the clip by itself, the
            tolerance alone would let the most conservative learn nothing.
    """
    best = candidates[0].choice.held_out_error
    limit = max(best, min(best * (1 + tolerance), (best + without) / 2))
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
    key: jax.Array | None = None,
    start: Style | None = None,
    bones: Bones | None = None,
    progress_callback: Callable[[int], Any] = no_progress,
) -> Any:
    """Trains the chosen setting once more on all frames [N, ...], the held-out ones included.

    It is a grid of one setting, so that a grid of one is compiled once for both trainings.
    """
    init_key, train_key = _keys(config, key)
    settings = Setting(*(jnp.asarray([rate], jnp.float32) for rate in choice[:3]))
    states = _stack(initial_parameters(config, shared, start, key=init_key), 1)
    trainer = EpochTrainer(shared, data, config, bones, key=train_key)
    trained = trainer.train(states, settings, (0, choice.epochs), progress_callback).params
    return jax.tree.map(lambda leaf: np.asarray(leaf)[0], trained)


def train_bank(
    shared: Network,
    data: Batch,
    choice: Choice,
    config: FewShotConfig,
    *,
    key: jax.Array | None = None,
    start: Style | None = None,
    bones: Bones | None = None,
    progress_callback: Callable[[int], Any] = no_progress,
) -> Any:
    """Trains many styles at once under one setting, by `vmap`: data [S, N, ...] -> trained parameters [S, ...]."""
    init_key, train_key = _keys(config, key)
    setting = Setting(*(jnp.asarray(rate, jnp.float32) for rate in choice[:3]))
    states = _stack(initial_parameters(config, shared, start, key=init_key), data.phase.shape[0])
    trainer = EpochTrainer(shared, data, config, bones, key=train_key, per_style=True)
    return trainer.train(states, setting, (0, choice.epochs), progress_callback).params


def initial_parameters(config: FewShotConfig, shared: Network, start: Style | None = None, *, key: jax.Array) -> Any:
    """Returns what the method starts from: `start`, a fresh style, the pretrained network, or a fresh network.

    Args:
        config: the method.
        shared: pretrained parameters.
        start: a style of the method's kind, e.g. for `film` the mean of the run's styles; None for a fresh one.
        key: of fresh parameters.
    """
    if start is not None and config.method not in ("fine_tune", "scratch"):
        return jax.tree.map(jnp.asarray, start)
    if config.method == "fine_tune":
        return shared
    sizes = config_of(shared)
    if config.method == "scratch":
        return init_network(sizes, key=key)
    return _init_style_now(AdapterConfig(config.method, config.rank), sizes, key=key)


_init_style_now = jax.jit(init_style, static_argnums=(0, 1))  # one program instead of ten small ones


def assemble(trained: Any, shared: Network) -> tuple[Network, Style | None]:
    """Returns the network and style to run: (shared, style), or (network, None) where a whole network was trained."""
    return (trained, None) if isinstance(trained, Network) else (shared, trained)


@struct.dataclass
class Setting:
    """One point of the grid, or the whole grid on a leading axis G."""

    learning_rate: jax.Array  # []
    main_dropout: jax.Array  # []
    adapter_dropout: jax.Array  # []


def decayed(setting: Setting, done: jax.Array) -> Setting:
    """Returns a setting whose learning rate has fallen along half a cosine: all of it at `done` 0, none at 1."""
    return replace(setting, learning_rate=setting.learning_rate * (1 + jnp.cos(jnp.pi * done)) / 2)


def settings_grid(config: FewShotConfig) -> Setting:
    """Returns all combinations of the configured rates; leaves [G]."""
    rows = list(itertools.product(config.learning_rates, config.main_dropouts, config.adapter_dropouts))
    return Setting(*(jnp.asarray(column, jnp.float32) for column in zip(*rows, strict=True)))


def init_few_shot_state(params: Any) -> TrainState:
    """Returns the state at step 0 from the parameters to be trained."""
    # The state of Adam does not depend on its rate.
    return TrainState(params, optax.adam(1.0).init(params), jnp.zeros((), jnp.int32))


def few_shot_step(
    state: TrainState,
    setting: Setting,
    shared: Network,
    batch: Batch,
    objective: Objective,
    bones: Bones | None = None,
    *,
    key: jax.Array,
) -> TrainState:
    """Takes one Adam step of one setting on one minibatch; only `state.params` is differentiated."""
    dropout = Dropout(main=setting.main_dropout, adapter=setting.adapter_dropout)

    def loss(params):
        network, style = assemble(params, shared)
        return objective.loss(predict_batch(network, style, batch, dropout, key), batch.y, (params,), bones)[0]

    # The rate is a traced argument, one for each setting under `vmap`; `optax.inject_hyperparams` would only store it
    # in every state.
    tx = optax.adam(setting.learning_rate)
    params, opt_state = descend(tx, jax.grad(loss)(state.params), state.opt_state, state.params)
    return TrainState(params, opt_state, state.step + 1)


class EpochTrainer:
    """Trains a leading axis of states: settings over one style's frames, or styles under one setting.

    Args:
        shared: pretrained parameters, not changed.
        data: [N, ...] frames, or with `per_style` [S, N, ...].
        config: its `batch_size` (a last incomplete minibatch is dropped) and the weights of its loss.
        bones: for the bone-length loss, or None.
        key: of shuffling and dropout; the key of an epoch is folded from it and the epoch's number.
        per_style: whether the states are of styles, each with its own frames.
    """

    def __init__(
        self,
        shared: Network,
        data: Batch,
        config: FewShotConfig,
        bones: Bones | None = None,
        *,
        key: jax.Array,
        per_style: bool = False,
    ) -> None:
        axis = 1 if per_style else 0
        self._count = jax.tree.leaves(data)[0].shape[axis]
        self._epochs = config.eval_epochs[-1]
        self._inputs = commit((shared, pad_rows(data, axis, _padded_size(config.batch_size)), bones))
        self._key = key
        self._train = at_precision(_train_many, config.precision)
        self._options = {
            "batch_size": config.batch_size,
            "objective": Objective(l1=config.l1, bone_length=config.bone_length),
            "decay": config.decay,
            "per_style": per_style,
            "sorts": sorts_of(self._count),
        }

    def train(
        self,
        states: TrainState,
        settings: Setting,
        epochs: tuple[int, int],
        progress_callback: Callable[[int], Any] = no_progress,
    ) -> TrainState:
        """Returns the states after the epochs [first, last); calls back with the number done, `EPOCHS` at a time."""
        states, settings = commit((states, settings))

        def scan(states: TrainState, first: int, count: int) -> tuple[TrainState, None]:
            counts = np.asarray([first, first + count, self._epochs, self._count], np.int32)
            return self._train(states, settings, *self._inputs, counts, self._key, **self._options), None

        return train_steps(states, scan, chunks(*epochs, EPOCHS), lambda _, done, __: progress_callback(done))


def row_errors(trained: Any, shared: Network, data: Batch) -> np.ndarray:
    """Returns squared normalised errors [G, N], mean over outputs, of every setting on N frames, without dropout."""
    count = len(data.x)
    trained, shared, data = commit((trained, shared, pad_rows(data, 0, ROWS)))
    return np.asarray(_row_errors(trained, shared, data))[:, :count]


def pad_rows(data: Batch, axis: int, multiple: int) -> Batch:
    """Repeats frames along `axis` until their number is a multiple; those added are never trained on."""
    count = jax.tree.leaves(data)[0].shape[axis]
    rows = np.arange(-(-count // multiple) * multiple) % count
    return jax.tree.map(lambda leaf: np.take(np.asarray(leaf), rows, axis=axis), data)


def _padded_size(batch_size: int) -> int:
    """Returns the number of rows, of whole minibatches, to a multiple of which rows are padded that are trained on."""
    return -(-TRAINING_ROWS // batch_size) * batch_size


def sorts_of(count: int) -> int:
    """Returns how often a shuffle of `count` frames sorts by random bits, so that equal bits leave no trace."""
    return max(1, math.ceil(3 * math.log(max(count, 1)) / math.log(_LARGEST)))


def padded_permutation(size: int, count: jax.Array, sorts: int, *, key: jax.Array) -> jax.Array:
    """Returns numbers [size]: first those below `count`, in the order of `jax.random.permutation`, then the others.

    Args:
        size: fixed, at least `count`.
        count: [] how many are shuffled.
        sorts: as `sorts_of` returns it for `count`.
        key: of the order.
    """
    numbers = jnp.arange(size, dtype=jnp.int32)
    order = numbers
    for _ in range(sorts):
        key, subkey = jax.random.split(key)
        bits = jax.random.bits(subkey, (size,), jnp.uint32)
        bits = jnp.where(numbers < count, bits, jnp.uint32(_LARGEST))  # stable: the padding stays last
        order = jax.lax.sort_key_val(bits, order)[1]
    return order


@partial(jax.jit, static_argnames=("batch_size", "objective", "decay", "per_style", "sorts"), donate_argnums=0)
def _train_many(states, settings, shared, data, bones, counts, key, *, batch_size, objective, decay, per_style, sorts):
    """Trains a leading axis of states.

    counts [4]: first epoch, the epoch before which to end, epochs in all (for `decay`), number of frames.
    """
    size, (first, last, epochs, num_frames) = data.phase.shape[1 if per_style else 0], counts
    num_steps = epochs * (num_frames // batch_size)

    def train(state: TrainState, setting: Setting, data: Batch) -> TrainState:
        def one_epoch(epoch, state):
            order_key, step_key = jax.random.split(jax.random.fold_in(key, epoch))
            order = padded_permutation(size, num_frames, sorts, key=order_key)
            keys = jax.random.split(step_key, size // batch_size)

            def one_step(index, state):
                frames = jax.lax.dynamic_slice(order, (index * batch_size,), (batch_size,))
                batch = jax.tree.map(lambda leaf: leaf[frames], data)
                now = decayed(setting, state.step / num_steps) if decay else setting
                return few_shot_step(state, now, shared, batch, objective, bones, key=keys[index])

            # Loops of traced length, so that clips of other lengths and other numbers of epochs share a compilation.
            return jax.lax.fori_loop(0, num_frames // batch_size, one_step, state)

        return jax.lax.fori_loop(first, last, one_epoch, state)

    return jax.vmap(train, in_axes=(0, None, 0) if per_style else (0, 0, None))(states, settings, data)


@jax.jit
def _row_errors(trained, shared: Network, data: Batch) -> jax.Array:
    def one(trained):
        y = predict_batch(*assemble(trained, shared), data, None, None)
        return jnp.mean((y - data.y) ** 2, axis=1)

    return jax.vmap(one)(trained)


@partial(jax.jit, static_argnums=1)
def _stack(params: Any, count: int) -> TrainState:
    """Returns `count` equal states at step 0 on a leading axis."""
    return jax.vmap(lambda _: init_few_shot_state(params))(jnp.arange(count))


def _keys(config: FewShotConfig, key: jax.Array | None) -> jax.Array:
    """Returns the keys of initialisation and of training."""
    return jax.random.split(jax.random.key(config.seed) if key is None else key)


def _candidates(params: Any, settings: Setting, epochs: int, errors: np.ndarray) -> list[Candidate]:
    rates = zip(*(np.asarray(leaf, float).tolist() for leaf in jax.tree.leaves(settings)), strict=True)
    host = jax.tree.map(np.asarray, params)
    candidates = []
    for index, ((learning_rate, main, adapter), error) in enumerate(zip(rates, errors, strict=True)):
        ranked_by = float(error) if np.isfinite(error) else float("inf")
        choice = Choice(_decimal(learning_rate), _decimal(main), _decimal(adapter), epochs, ranked_by)
        candidates.append(Candidate(choice, jax.tree.map(lambda leaf, i=index: leaf[i], host)))
    return candidates


def _decimal(rate: float) -> float:
    """Returns a single-precision rate as it was written: 0.3, not 0.30000001."""
    return float(f"{rate:.6g}")
