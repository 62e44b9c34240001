"""The seven models of Mason 2022, Table 2: training on takes in memory, saving and loading."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from experiments.common.seven_takes import Take, Takes, rows_of
from pfnn_jax.inference.predictor import Predictor, assemble_predictor
from pfnn_jax.io.checkpoint import load_record, save_record
from pfnn_jax.io.files import locate, read_note
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.film_generator import FiLMGenerator
from pfnn_jax.models.network import Network, init_network
from pfnn_jax.models.presets import LAYOUT_OF, TABLE2
from pfnn_jax.models.style import Style, init_bank
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser, fit_normaliser, load_normaliser, save_normaliser
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.data import Rows
from pfnn_jax.training.pretraining import pretrain, styles_of

NOTE = "model.json"


@dataclass(frozen=True, eq=False)
class Model:
    """One trained model.

    Attributes:
        name: key of `TABLE2`.
        config: training settings.
        layout, skeleton: frame layout and skeleton of its rows.
        styles: S names.
        normaliser: statistics of its rows.
        network: shared parameters.
        bank: the styles, leaves [S, ...]; for a FiLM model the mean FiLM parameters of each style.
        generator: parameters of the FiLM generator, or None.
        seconds: training time, with compilation.
        loss: mean loss of the last dispatch.
    """

    name: str
    config: PretrainConfig
    layout: FrameLayout
    skeleton: Skeleton
    styles: tuple[str, ...]
    normaliser: Normaliser
    network: Network
    bank: Any
    generator: FiLMGenerator | None
    seconds: float
    loss: float

    def style(self, name: str) -> Style:
        """Returns the parameters of one style."""
        index = self.styles.index(name)
        return jax.tree.map(lambda leaf: leaf[index], self.bank)

    def predictor(self, style: Style | str | None) -> Predictor:
        """Returns a predictor in a style of the model by name, in a style given by its parameters, or without style."""
        return assemble_predictor(self.network, self.style(style) if isinstance(style, str) else style, self.normaliser)


def layout_name(model: str) -> str:
    """Returns the name of the layout of a model of `TABLE2`."""
    return LAYOUT_OF[TABLE2[model].backbone]


def make_data(
    takes: Sequence[Take], styles: Sequence[str], layout: FrameLayout, normaliser: Normaliser, skeleton: Skeleton
) -> Rows:
    """Returns the rows of the takes as training data, mirror images included."""
    own = {style: [part for t in takes if t.style == style for part in t.parts(layout.name)] for style in styles}
    return Rows.from_features(own, layout, normaliser, skeleton.parents)


def train_model(name: str, takes: Takes, config: PretrainConfig) -> Model:
    """Trains one model on the training takes; `config.adapter` is replaced by the model's adapter."""
    layout = takes.layout(layout_name(name))
    own = replace(config, adapter=TABLE2[name].adapter)
    rows = rows_of(takes.train, layout.name)
    phase = rows.phase if layout.phase_size else None
    normaliser = fit_normaliser(rows.x, rows.y, layout, phase=phase)
    del rows
    data = make_data(takes.train, takes.styles, layout, normaliser, takes.skeleton)
    losses: list[float] = []
    started = time.perf_counter()
    state = pretrain(data, own, progress_callback=lambda progress: losses.append(progress.loss))
    seconds = time.perf_counter() - started
    bank = jax.tree.map(np.asarray, styles_of(state, data))
    generator = None if own.generator(layout) is None else jax.tree.map(np.asarray, state.params.modulation)
    network = jax.tree.map(np.asarray, state.params.shared)
    return Model(
        name, own, layout, takes.skeleton, takes.styles, normaliser, network, bank, generator, seconds, losses[-1]
    )


def save_model(folder: Path, model: Model) -> None:
    """Writes a model's parameters, statistics and settings into a folder."""
    note = {
        "name": model.name,
        "config": asdict(model.config),
        "styles": list(model.styles),
        "seconds": model.seconds,
        "loss": model.loss,
    }
    folder.mkdir(parents=True, exist_ok=True)
    save_normaliser(folder / "normaliser", model.normaliser)
    save_record(folder / "parameters", _tree(model.network, model.bank, model.generator), NOTE, note)


def load_model(folder: Path, takes: Takes) -> Model | None:
    """Loads a model that `save_model` wrote for the skeleton of these takes; returns None if there is none."""
    if locate(folder / "parameters") is None:
        return None
    note = read_note(folder / "parameters", NOTE, "must be a model saved by experiments.one_step_error")
    settings = note["config"]
    config = PretrainConfig(**{**settings, "adapter": AdapterConfig(**settings["adapter"])})
    layout, styles = takes.layout(layout_name(note["name"])), tuple(note["styles"])
    tree = load_record(folder / "parameters", jax.eval_shape(partial(_fresh, config, layout, len(styles))))
    return Model(
        note["name"],
        config,
        layout,
        takes.skeleton,
        styles,
        load_normaliser(folder / "normaliser"),
        tree["network"],
        tree["bank"],
        tree.get("generator"),
        note["seconds"],
        note["loss"],
    )


def _tree(network: Network, bank: Any, generator: Any) -> dict[str, Any]:
    tree = {"network": network, "bank": bank}
    return tree if generator is None else {**tree, "generator": generator}


def _fresh(config: PretrainConfig, layout: FrameLayout, num_styles: int) -> dict[str, Any]:
    key, sizes, generator = jax.random.key(0), config.network(layout), config.generator(layout)
    bank = init_bank(config.adapter, sizes, num_styles, key=key)
    made = None if generator is None else FiLMGenerator.init(generator, key=key)
    return _tree(init_network(sizes, key=key), bank, made)
