"""Methods of adding a style to the trained models of Mason 2022 from one clip (§5.3.2 and alternatives).

A method is a function of a trained model and the clip that returns the learned style. Settings are chosen on the last
part of the clip, then refit on all of it; nothing is chosen on the test takes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.common.seven_models import Model
from experiments.common.seven_takes import Take, common_columns
from pfnn_jax.control.stability import make_stability_check
from pfnn_jax.inference.rows import evaluate_rows
from pfnn_jax.models.film_generator import FiLMGenerator
from pfnn_jax.models.network import num_parameters
from pfnn_jax.models.style import Style
from pfnn_jax.motion.features.encode import Features, join_rows
from pfnn_jax.training.config import FewShotConfig, Method, TuningConfig
from pfnn_jax.training.data import Rows, hold_out, to_batch
from pfnn_jax.training.few_shot_learning import choose, refit, train_grid
from pfnn_jax.training.film_styles import window_styles
from pfnn_jax.training.tuning import tune_generator


@dataclass(frozen=True)
class Budget:
    """Lengths and rates of training.

    Attributes:
        eval_epochs: epochs at which candidates of the style's parameters are evaluated.
        learning_rates: candidate learning rates of the style's parameters.
        tuning_steps: steps of generator tuning at which it is evaluated, increasing.
        tuning_rate: learning rate of Adam for the generator.
        held_out: share of the clip, at its end, on which epochs and rates are chosen.
        tolerance: relative excess over the least error that is accepted: the most conservative candidate within it is
            chosen, as in few-shot learning by default; 0 chooses the best candidate.
    """

    eval_epochs: tuple[int, ...] = (5, 10, 25, 50, 100)
    learning_rates: tuple[float, ...] = (1e-4, 1e-3, 3e-3)
    tuning_steps: tuple[int, ...] = (25, 50, 100, 200)
    tuning_rate: float = 1e-4
    held_out: float = 0.2
    tolerance: float = 0.5


@dataclass(frozen=True, eq=False)
class Learned:
    """One style, learned by one method.

    Attributes:
        style: the style in which the model runs.
        trained: number of trained parameters.
        stored: number of parameters of the style at run time; 0 for a style that already exists.
        seconds: total time, including the choice of settings.
        choice: the chosen setting.
        generator: tuned parameters of the FiLM generator, or None.
    """

    style: Style | None
    trained: int
    stored: int
    seconds: float
    choice: str = ""
    generator: Any = None


Learner = Callable[[Model, Take, Budget, int], Learned]
"""(model, adaptation clip, budget, seed) -> learned style."""


def clip_data(model: Model, parts: Sequence[Features]) -> Rows:
    """Returns rows of one style as training data of a model."""
    return Rows.from_features({"new": parts}, model.layout, model.normaliser, model.skeleton.parents)


def mean_style(model: Model, clip: Take, budget: Budget, seed: int) -> Learned:
    """Returns the mean of the known styles without learning, or no style if they have no mean (CP)."""
    return Learned(average(model), 0, 0, 0.0)


def nearest_style(model: Model, clip: Take, budget: Budget, seed: int) -> Learned:
    """Returns the known style that predicts the clip best."""
    started = time.perf_counter()
    rows, columns = join_rows(clip.parts(model.layout.name)), common_columns(model.layout)
    std = np.asarray(model.normaliser.outputs.std)
    errors = {
        style: float(
            np.mean((((evaluate_rows(model.predictor(style), rows.x, rows.phase) - rows.y) / std)[:, columns]) ** 2)
        )
        for style in model.styles
    }
    best = min(errors, key=lambda style: errors[style])
    return Learned(model.style(best), 0, 0, time.perf_counter() - started, best)


def generated(model: Model, clip: Take, budget: Budget, seed: int) -> Learned:
    """Returns the mean FiLM parameters over the clip's windows, by the generator without tuning."""
    started = time.perf_counter()
    film = _mean(window_films(model, generator_of(model), [clip]))
    return Learned(film, 0, num_parameters(film), time.perf_counter() - started)


def tuned(model: Model, clip: Take, budget: Budget, seed: int) -> Learned:
    """Tunes the generator to the clip (§5.3.2), for the fewest steps whose held-out error is within the tolerance."""
    started = time.perf_counter()
    learn, held = hold_out(clip.parts(model.layout.name), budget.held_out, clip.name)
    rows, columns = join_rows(held), common_columns(model.layout)
    std = np.asarray(model.normaliser.outputs.std)[columns]
    generator, done, errors = generator_of(model), 0, {}
    for steps in budget.tuning_steps:
        tuning = _tuning(budget, steps - done, seed + done)
        found = tune_generator(model.network, generator, clip_data(model, learn), tuning)
        generator, done = found.generator, steps
        residual = evaluate_rows(model.predictor(found.style), rows.x, rows.phase)[:, columns] - rows.y[:, columns]
        errors[steps] = float(np.mean((residual / std) ** 2))
    limit = min(errors.values()) * (1 + budget.tolerance)
    steps = min(steps for steps, error in errors.items() if error <= limit)
    data = clip_data(model, clip.parts(model.layout.name))
    found = tune_generator(model.network, generator_of(model), data, _tuning(budget, steps, seed))
    film, generator = jax.tree.map(np.asarray, (found.style, found.generator))
    seconds = time.perf_counter() - started
    return Learned(film, num_parameters(generator), num_parameters(film), seconds, f"{steps} steps", generator)


def optimised(method: Method) -> Learner:
    """Returns a learner that trains the parameters of one style with a frozen network, by a few-shot `method`."""

    def learn_style(model: Model, clip: Take, budget: Budget, seed: int) -> Learned:
        started = time.perf_counter()
        config = FewShotConfig(
            method,
            rank=model.config.adapter.rank,
            learning_rates=budget.learning_rates,
            main_dropouts=(0.0,),
            adapter_dropouts=(0.3,),
            eval_epochs=budget.eval_epochs,
            held_out=budget.held_out,
            tolerance=budget.tolerance,
            seed=seed,
        )
        parts = clip.parts(model.layout.name)
        learn, held = (to_batch(some, model.normaliser) for some in hold_out(parts, budget.held_out, clip.name))
        size = min(config.batch_size, len(learn.x))
        config = replace(config, batch_size=size)
        start = average(model) if method in ("film", "dense", "one_hot") else None
        bones = clip_data(model, parts).bones()
        candidates = train_grid(model.network, learn, held, config, start=start, bones=bones)
        own = clip.rows[model.layout.name]
        is_stable = make_stability_check(model.network, model.normaliser, model.layout, own.x, own.y, own.phase)
        choice = choose(candidates, config.tolerance, is_stable if config.tolerance else None).choice
        style = refit(model.network, to_batch(parts, model.normaliser), choice, config, start=start, bones=bones)
        size, seconds = num_parameters(style), time.perf_counter() - started
        return Learned(style, size, size, seconds, f"lr {choice.learning_rate:g}, {choice.epochs} epochs")

    return learn_style


METHODS: dict[str, tuple[str, Learner]] = {
    "fine-tuned generator": ("lpn_film", tuned),
    "FiLM vector": ("lpn_film", optimised("film")),
    "dense adapter": ("lpn_resad", optimised("dense")),
    "CP adapter": ("pfnn_resad", optimised("cp")),
    "one-hot column": ("lpn_one_hot", optimised("one_hot")),
    "generator as it is": ("lpn_film", generated),
    "nearest known style": ("lpn_film", nearest_style),
    "nothing: mean style": ("lpn_film", mean_style),
    "nothing, LPN resad": ("lpn_resad", mean_style),
    "nothing, LPN one-hot": ("lpn_one_hot", mean_style),
    "nothing, PFNN resad": ("pfnn_resad", mean_style),
}
"""Row of the table -> pretrained model, and learner. The last rows are the starting points of the others."""


def average(model: Model) -> Style | None:
    """Returns the mean of a model's styles; None for CP adapters, whose factors have no mean."""
    return None if model.config.adapter.kind == "cp" else _mean(model.bank)


def generator_of(model: Model) -> FiLMGenerator:
    """Returns a FiLM model's generator."""
    if model.generator is None:
        raise ValueError(f"`model` must have a FiLM generator, got {model.name}.")
    return model.generator


def window_films(model: Model, generator: FiLMGenerator, takes: Sequence[Take]):
    """Returns FiLM styles, leaves [W, 2, H], of all windows of the takes, by a generator."""
    parts = [part for take in takes for part in take.parts(model.layout.name)]
    return window_styles(generator, clip_data(model, parts), 0)


def frames_of(clip: Take) -> int:
    """Returns the number of training frames of the clip, without mirror images."""
    return len(next(iter(clip.rows.values())).x)


def named(takes: Sequence[Take], name: str) -> list[Take]:
    """Returns the takes with another style name."""
    return [replace(take, style=name) for take in takes]


def _tuning(budget: Budget, steps: int, seed: int) -> TuningConfig:
    return TuningConfig(steps=steps, clips_per_batch=2, learning_rate=budget.tuning_rate, seed=seed)


def _mean(films: Any) -> Any:
    return jax.tree.map(lambda leaf: jnp.mean(jnp.asarray(leaf), axis=0), films)


def by_content(takes: Sequence[Take]) -> Mapping[str, list[Take]]:
    """Groups takes by motion: walk, side (walk-left and walk-right), back, run (and dash)."""
    groups: dict[str, list[Take]] = {}
    for take in takes:
        groups.setdefault(_kind(take.content), []).append(take)
    return groups


def _kind(content: str) -> str:
    if content.startswith(("run", "dash")):
        return "run"
    return {"walk-left": "side", "walk-right": "side", "walk-back": "back"}.get(content, "walk")
