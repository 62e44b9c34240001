"""Which method of adding an unseen style to the pretrained models of Mason 2022, from one walk, works best?

Parent    Mason 2022 §5.3.2 and Figure 11: the FiLM generator is fine-tuned on data of the new style, the rest frozen.
Question  what does each method of adding a style need (parameters, seconds, frames), and what is its error on takes
          that it was not trained on: another walk, side steps, walking backward, running? Does fine-tuning separate the
          new styles?
Data      Bandai-Namco-1: active, angry, happy, old, tired, on the skeleton of Bandai-Namco-2, with which
          `experiments.one_step_error` pretrained the models. Learned from the first walk and its mirror image.
Expect    see docs/results_appendix.md.
Run       python -m experiments.new_styles --pretrained runs/one_step_error --data OLD --new NEW --out runs/new_styles
          OLD is the data folder of one_step_error, NEW that of the new styles. Each style is written when it is
          finished; run again with the same --out to resume.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from experiments.common.markdown import markdown_table
from experiments.common.new_style_methods import (
    METHODS,
    Budget,
    Learned,
    by_content,
    frames_of,
    generator_of,
    named,
    window_films,
)
from experiments.common.new_style_plot import film_map
from experiments.common.new_style_table import MEASURES, ratios, summary, table
from experiments.common.seven_measures import (
    Reference,
    make_reference,
    one_step,
    pooled_frechet,
    real_motion,
    rollout_test,
)
from experiments.common.seven_models import Model, load_model
from experiments.common.seven_takes import Take, Takes, load_takes, windows_of
from experiments.one_step_error import network_folder
from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.plots import error_bars
from pfnn_jax.evaluation.style_classifier import ClassifierConfig, train_classifier
from pfnn_jax.io.files import json_text, write_whole
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.viewer.draw.drawing import save_figure

LEARN = "walk"
"""Content of the takes, the first of which is the adaptation clip."""

MAP_OF = "lpn_film"
"""The model whose FiLM vectors are mapped; one of the methods must tune its generator."""


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        pretrained: folder of results of `experiments.one_step_error`.
        data: their training data.
        new: folder of BVH files of the new styles.
        out: folder of results.
        styles: the new styles.
        methods: rows of the table, from `METHODS`, which names the network that each one needs.
        seed: seed of the pretrained models and of learning.
        held_out, takes, seconds_per_style: settings of `one_step_error`.
        budget: length of training.
        circle_seconds: length of the walks.
        starts: number of first poses of the walks, each walked to both sides.
        classifier_epochs: passes of the style classifier over its windows.
        windows: clips of each style in the map of FiLM vectors (50 in the paper).
        perplexity: perplexity of t-SNE.
    """

    pretrained: Path
    data: str
    new: Path
    out: Path
    styles: tuple[str, ...] = ("active", "angry", "happy", "old", "tired")
    methods: tuple[str, ...] = tuple(METHODS)
    seed: int = 0
    held_out: float = 0.125
    takes: int = 0
    seconds_per_style: float = 60.0
    budget: Budget = field(default_factory=Budget)
    circle_seconds: float = 12.0
    starts: int = 2
    classifier_epochs: int = 6
    windows: int = 50
    perplexity: float = 30.0


@dataclass(frozen=True, eq=False)
class NewStyle:
    """One new style.

    Attributes:
        name: label for the classifier, which distinguishes it from a known style of the same name.
        clip: the adaptation clip.
        others: takes that are not used in training.
    """

    name: str
    clip: Take
    others: tuple[Take, ...]


def new_styles(config: Config) -> dict[str, NewStyle]:
    """Returns the takes of the new styles; the first walk is the adaptation clip."""
    takes = load_takes(str(config.new), held=0, styles=config.styles).train
    found = {}
    for style in config.styles:
        own = named([take for take in takes if take.style == style], f"new {style}")
        walks = [take for take in own if take.content == LEARN]
        if not walks:
            raise InputError(config.new, "style", style, f"must have a take with content {LEARN}")
        found[style] = NewStyle(f"new {style}", walks[0], tuple(take for take in own if take is not walks[0]))
    return found


def make_judge(known: Takes, styles: Mapping[str, NewStyle], config: Config) -> tuple[Reference, dict[str, Any]]:
    """Returns a classifier of known and new styles, and its accuracy on held-out real takes.

    The last walk of every new style is held out.
    """
    names = (*known.styles, *(style.name for style in styles.values()))
    last = [[take for take in style.others if take.content == LEARN][-1:] for style in styles.values()]
    kept = [take for some in last for take in some]
    own = [take for style in styles.values() for take in (style.clip, *style.others)]
    learn = [*known.train, *(take for take in own if take not in kept)]
    windows, labels = windows_of(learn, names)
    classifier = train_classifier(windows, labels, len(names), ClassifierConfig(epochs=config.classifier_epochs))
    reference = make_reference(classifier, names, [*known.train, *own])
    return reference, {
        "styles": names,
        "known": real_motion(known.test, reference),
        "new": real_motion(kept, reference) if kept else None,
    }


def measure(
    model: Model, learned: Learned, style: NewStyle, reference: Reference, config: Config
) -> tuple[dict[str, Any], np.ndarray | None]:
    """Returns one row of one style, and the features of its generated windows."""
    errors = {}
    for kind, takes in {**by_content(style.others), "all": list(style.others)}.items():
        found = one_step(model, takes, {style.name: learned.style})
        errors[kind] = {key: found[key] for key in ("mse", "bones")}
    walks = rollout_test(
        model,
        style.name,
        [style.clip, *style.others],
        reference,
        seconds=config.circle_seconds,
        starts=config.starts,
        predictor=model.predictor(learned.style),
    )
    generated = walks.pop("features")
    row = {
        "trained": learned.trained,
        "stored": learned.stored,
        "seconds": learned.seconds,
        "frames": frames_of(style.clip),
        "choice": learned.choice,
        "errors": errors,
        "walks": walks,
    }
    return row, generated


def main(config: Config) -> dict[str, Any]:
    """Learns and measures the missing styles; writes the table, the bars and the map."""
    config.out.mkdir(parents=True, exist_ok=True)
    known = load_takes(config.data, config.held_out, config.takes, config.seconds_per_style)
    styles = new_styles(config)
    models = {
        name: _need(config, name, known)
        for name in dict.fromkeys((MAP_OF, *(METHODS[method][0] for method in config.methods)))
    }
    reference, judged = make_judge(known, styles, config)
    print(f"real walks of new styles: {100 * judged['new']['recognition']:.0f} % recognised", flush=True)
    rows: dict[str, dict[str, Any]] = {}
    for number, (style, new) in enumerate(styles.items()):
        file = config.out / f"style_{style}.json"
        if not file.exists():
            write_whole(file, json_text(run_style(new, models, reference, config, number)))
        rows[style] = json.loads(file.read_text())
        errors = {method: row["errors"]["all"]["mse"] for method, row in rows[style].items()}
        print(f"{style}: " + ", ".join(f"{method} {error:.3f}" for method, error in errors.items()), flush=True)
    result = {"config": {k: str(v) for k, v in asdict(config).items()}, "real": judged, "styles": rows}
    result["summary"] = summary(rows)
    result["map"] = draw_map(models[MAP_OF], known, styles, config)
    write_whole(config.out / "results.json", json_text(result))
    write_whole(config.out / "table.md", table(result["summary"]))
    write_whole(config.out / "ratios.md", markdown_table(["method", *MEASURES], ratios(rows)))
    bars = {name: {m: row["mse"][m] for m in MEASURES if m in row["mse"]} for name, row in result["summary"].items()}
    save_figure(error_bars(bars, "New styles, held-out takes", "normalised squared error"), config.out / "errors.png")
    return result


def run_style(
    style: NewStyle, models: Mapping[str, Model], reference: Reference, config: Config, number: int
) -> dict[str, Any]:
    """Applies every method to one style."""
    rows = {}
    for method in config.methods:
        name, learn = METHODS[method]
        learned = learn(models[name], style.clip, config.budget, config.seed)
        row, generated = measure(models[name], learned, style, reference, config)
        row["network"] = name
        row["frechet"] = pooled_frechet({style.name: {"features": generated}}, reference)
        rows[method] = row
        if learned.generator is not None:
            films = window_films(models[name], learned.generator, [style.clip, *style.others])
            np.save(config.out / f"films_{style.clip.style.removeprefix('new ')}.npy", _vectors(films))
    return rows


def draw_map(model: Model, known: Takes, styles: Mapping[str, NewStyle], config: Config) -> dict[str, dict[str, float]]:
    """Draws t-SNE of the windows' FiLM vectors before and after fine-tuning; returns the silhouettes of the styles."""
    rng = np.random.default_rng(config.seed)

    def some(films: FiLMStyle | np.ndarray) -> np.ndarray:
        vectors = films if isinstance(films, np.ndarray) else _vectors(films)
        return vectors[np.sort(rng.permutation(len(vectors))[: config.windows])]

    before = {style: some(window_films(model, generator_of(model), _of(known.train, style))) for style in known.styles}
    after = dict(before)
    for style, new in styles.items():
        before[new.name] = some(window_films(model, generator_of(model), [new.clip, *new.others]))
        after[new.name] = some(np.load(config.out / f"films_{style}.npy"))
    figure, apart = film_map({"before fine-tuning": before, "after": after}, config.perplexity, config.seed)
    save_figure(figure, config.out / "film_vectors.png")
    return apart


def _need(config: Config, name: str, known: Takes) -> Model:
    folder = network_folder(config.pretrained, name, config.seed)
    model = load_model(folder, known)
    if model is None:
        raise InputError(folder, "network", "absent", "train it with experiments.one_step_error and this seed")
    return model


def _of(takes: Sequence[Take], style: str) -> list[Take]:
    return [take for take in takes if take.style == style]


def _vectors(films: FiLMStyle) -> np.ndarray:
    """Returns vectors [W, 4H] of FiLM styles with leaves [W, 2, H]."""
    return np.asarray(jax.vmap(FiLMStyle.to_vector)(films))


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
