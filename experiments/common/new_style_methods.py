"""Ways of adding a style to the trained models of Mason 2022, each learned from one clip (§5.3.2 and what it compares).

A way is a function of a trained model and the clip; it returns what the model then runs in. Settings are chosen on the
last part of the clip and trained once more on all of it; nothing is chosen on the takes that are tested.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.common.seven_measures import predict
from experiments.common.seven_models import Model
from experiments.common.seven_takes import Take, common_columns
from pfnn_jax.control.stability import make_stability_check
from pfnn_jax.models.config import GeneratorConfig
from pfnn_jax.models.film_generator import film_generator
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
    """How long is trained.

    Attributes:
        eval_epochs: epochs after which the styles' parameters are looked at.
        learning_rates: to try, for styles' parameters.
        tuning_steps: steps of generator tuning after which it is looked at, increasing.
        tuning_rate: Adam's, for the generator.
        held_out: share of the clip, at its end, by which epochs and rates are chosen.
        tolerance: by what share the error there may exceed the best: of those within it the gentlest is taken, as
            few-shot learning does by default; 0 takes the best.
    """

    eval_epochs: tuple[int, ...] = (5, 10, 25, 50, 100)
    learning_rates: tuple[float, ...] = (1e-4, 1e-3, 3e-3)
    tuning_steps: tuple[int, ...] = (25, 50, 100, 200)
    tuning_rate: float = 1e-4
    held_out: float = 0.2
    tolerance: float = 0.5


@dataclass(frozen=True, eq=False)
class Learned:
    """One style, learned in one way.

    Attributes:
        style: what the model runs in.
        trained: number of parameters that were trained.
        stored: number of parameters of the style at run time; 0 where it is one that is there already.
        seconds: of everything, choices included.
        choice: what was chosen.
        generator: tuned parameters of the FiLM generator, or None.
    """

    style: Style | None
    trained: int
    stored: int
    seconds: float
    choice: str = ""
    generator: Any = None


Way = Callable[[Model, Take, Budget, int], Learned]
"""(model, the clip to learn from, budget, seed) -> what was learned."""


def clip_data(model: Model, parts: Sequence[Features]) -> Rows:
    """Rows of one style as training data of a model."""
    return Rows.from_features({"new": parts}, model.layout, model.normaliser, model.skeleton.parents)


def mean_style(model: Model, clip: Take, budget: Budget, seed: int) -> Learned:
    """Nothing is learned: the mean of the known styles, or none at all where styles cannot be averaged (CP)."""
    return Learned(average(model), 0, 0, 0.0)


def nearest_style(model: Model, clip: Take, budget: Budget, seed: int) -> Learned:
    """The known style that predicts the clip best."""
    started = time.perf_counter()
    rows, columns = join_rows(clip.parts(model.layout.name)), common_columns(model.layout)
    std = np.asarray(model.normaliser.outputs.std)
    errors = {
        style: float(np.mean((((predict(model.predictor(style), rows.x, rows.phase) - rows.y) / std)[:, columns]) ** 2))
        for style in model.styles
    }
    best = min(errors, key=lambda style: errors[style])
    return Learned(model.style(best), 0, 0, time.perf_counter() - started, best)


def generated(model: Model, clip: Take, budget: Budget, seed: int) -> Learned:
    """The generator as it was pretrained reads the clip: the mean Film over its windows."""
    started = time.perf_counter()
    film = _mean(window_films(model, model.generator, [clip]))
    return Learned(film, 0, num_parameters(film), time.perf_counter() - started)


def tuned(model: Model, clip: Take, budget: Budget, seed: int) -> Learned:
    """The generator tuned to the clip (§5.3.2), for the least number of steps that is good enough on its last part."""
    started = time.perf_counter()
    sizes = generator_sizes(model)
    learn, held = hold_out(clip.parts(model.layout.name), budget.held_out, clip.name)
    rows, columns = join_rows(held), common_columns(model.layout)
    std = np.asarray(model.normaliser.outputs.std)[columns]
    parameters, done, errors = model.generator, 0, {}
    for stop in budget.tuning_steps:
        found = tune_generator(
            model.network, sizes, parameters, clip_data(model, learn), _tuning(budget, stop - done, seed + done)
        )
        parameters, done = found.generator, stop
        off = predict(model.predictor(found.style), rows.x, rows.phase)[:, columns] - rows.y[:, columns]
        errors[stop] = float(np.mean((off / std) ** 2))
    limit = min(errors.values()) * (1 + budget.tolerance)
    steps = min(stop for stop, error in errors.items() if error <= limit)
    data = clip_data(model, clip.parts(model.layout.name))
    found = tune_generator(model.network, sizes, model.generator, data, _tuning(budget, steps, seed))
    film, generator = jax.tree.map(np.asarray, (found.style, found.generator))
    seconds = time.perf_counter() - started
    return Learned(film, num_parameters(generator), num_parameters(film), seconds, f"{steps} steps", generator)


def optimised(method: Method) -> Way:
    """The parameters of one style, optimised beside the frozen network by `method` of few-shot learning."""

    def way(model: Model, clip: Take, budget: Budget, seed: int) -> Learned:
        started = time.perf_counter()
        config = FewShotConfig(
            method,
            rank=model.config.adapter.rank,
            learning_rates=budget.learning_rates,
            main_dropouts=(0.0,),
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

    return way


WAYS: dict[str, tuple[str, Way]] = {
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
"""Row of the table -> the pretrained model it stands on, and the way. The last rows are what the others start from."""


def average(model: Model) -> Style | None:
    """The mean of a model's styles; None for CP adapters, whose factors have no mean."""
    return None if model.config.adapter.kind == "cp" else _mean(model.bank)


def generator_sizes(model: Model) -> GeneratorConfig:
    """Sizes of a FiLM model's generator."""
    sizes = model.config.generator(model.layout)
    if sizes is None or model.generator is None:
        raise ValueError(f"`model` must have a FiLM generator, got {model.name}.")
    return sizes


def window_films(model: Model, parameters: Any, takes: Sequence[Take]):
    """Films, leaves [W, 2, H], of all windows of some takes, by a generator with these parameters."""
    parts = [part for take in takes for part in take.parts(model.layout.name)]
    return window_styles(film_generator(generator_sizes(model)), parameters, clip_data(model, parts), 0)


def frames_of(clip: Take) -> int:
    """Frames of the clip that were learned from, without their mirror images."""
    return len(next(iter(clip.rows.values())).x)


def named(takes: Sequence[Take], name: str) -> list[Take]:
    """The takes under another style's name."""
    return [replace(take, style=name) for take in takes]


def _tuning(budget: Budget, steps: int, seed: int) -> TuningConfig:
    return TuningConfig(steps=steps, clips_per_batch=2, learning_rate=budget.tuning_rate, seed=seed)


def _mean(films: Any) -> Any:
    return jax.tree.map(lambda leaf: jnp.mean(jnp.asarray(leaf), axis=0), films)


def by_content(takes: Sequence[Take]) -> Mapping[str, list[Take]]:
    """The takes by what they show: walk, side (walk-left and walk-right), back, run (and dash)."""
    groups: dict[str, list[Take]] = {}
    for take in takes:
        groups.setdefault(_kind(take.content), []).append(take)
    return groups


def _kind(content: str) -> str:
    if content.startswith(("run", "dash")):
        return "run"
    return {"walk-left": "side", "walk-right": "side", "walk-back": "back"}.get(content, "walk")
