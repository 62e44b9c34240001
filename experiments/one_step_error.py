"""Which of the seven models of Mason 2022 is best, trained on the same frames for the same number of steps?

Parent    Mason 2022 §5.2.2, Figure 10: held-out error of seven models on seen styles, lowest for FiLM.
Question  is the order the same on unseen takes, for one step and for rollouts: are the walks stable, do bones keep
          their lengths, do feet stay planted, and is the style recognised?
Data      Bandai-Namco-2 by default: 7 styles, whole takes of each style and content held out. All models see the same
          rows: the frames that have a global phase, with their mirror images.
Expect    see docs/results_appendix.md.
Run       python -m experiments.one_step_error --data FOLDER --out runs/one_step_error
          FOLDER contains BVH files (Bandai-Namco, 100STYLE, folders of styles); `synthetic` needs no files. Each model
          is written when it is finished; run again with the same --out to resume. `--tiny` takes a minute.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from experiments.common.one_step_error_table import write_tables
from experiments.common.seven_measures import (
    Reference,
    held_out_takes,
    make_reference,
    one_step,
    pooled_frechet,
    real_motion,
    rollout_test,
)
from experiments.common.seven_models import Model, load_model, save_model, train_model
from experiments.common.seven_takes import Takes, load_takes, windows_of
from pfnn_jax.benchmarks.timing import machine, versions
from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.style_classifier import (
    ClassifierConfig,
    StyleClassifier,
    init_classifier,
    train_classifier,
)
from pfnn_jax.io.checkpoint import load_record, save_record
from pfnn_jax.io.files import json_text, locate, to_plain, write_whole
from pfnn_jax.models.presets import TABLE2
from pfnn_jax.training.config import PretrainConfig


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        data: folder of BVH files, or `synthetic`.
        out: folder of results and trained networks.
        json: file of the results; `results.json` in `out` by default.
        models: names of models of Table 2, all by default.
        seeds: number of repetitions: initialisation, shuffling and dropout; the split is the same for all.
        steps: training steps.
        batch_size: frames per minibatch.
        learning_rate: learning rate of Adam; the paper has 1e-4 with minibatches of 32 and 90 epochs of 4 million
            frames. At 1e-3 a FiLM generator collapses: it then returns the same FiLM parameters for every style.
        hidden: H.
        clips_per_batch: clips that a FiLM generator reads per minibatch.
        generator_filters, generator_hidden: sizes of the FiLM generator; the paper has 256 and 2048.
        dropout: drop probability.
        held_out: share of the takes of every style and content that is held out for testing.
        takes: largest number of takes of each style and content, 0 for all.
        circle_seconds: length of the walks.
        starts: number of first poses of the walks in each style, each walked to both sides.
        classifier_epochs: passes of the style classifier over its windows.
        seconds_per_style: seconds of procedural motion per style, for `synthetic`.
        tiny: use tiny sizes, for a trial of a minute.
    """

    data: str
    out: Path
    json: Path | None = None
    models: tuple[str, ...] = tuple(TABLE2)
    seeds: int = 2
    steps: int = 3000
    batch_size: int = 64
    learning_rate: float = 3e-4
    hidden: int = 512
    clips_per_batch: int = 2
    generator_filters: int = 64
    generator_hidden: int = 512
    dropout: float = 0.3
    held_out: float = 0.125
    takes: int = 0
    circle_seconds: float = 12.0
    starts: int = 3
    classifier_epochs: int = 6
    seconds_per_style: float = 60.0
    tiny: bool = False

    def __post_init__(self):
        unknown = sorted(set(self.models) - set(TABLE2))
        if unknown:
            raise InputError("one_step_error", "models", unknown[0], f"must be one of {', '.join(TABLE2)}")

    def sized(self) -> Config:
        """Returns the settings with the sizes of `tiny` if it is set."""
        if not self.tiny:
            return self
        return replace(
            self, seeds=1, steps=4, batch_size=16, hidden=16, clips_per_batch=2, generator_filters=2,
            generator_hidden=8, takes=2, circle_seconds=2.5, starts=1, classifier_epochs=1, seconds_per_style=20.0,
        )  # fmt: skip

    def pretraining(self, seed: int) -> PretrainConfig:
        """Returns the training settings of one model."""
        return PretrainConfig(
            hidden=self.hidden,
            clips_per_batch=self.clips_per_batch,
            generator_filters=self.generator_filters,
            generator_hidden=self.generator_hidden,
            steps=self.steps,
            batch_size=self.batch_size,
            learning_rate=self.learning_rate,
            dropout=self.dropout,
            pose_noise=0.0,
            seed=seed,
        )


def network_folder(out: Path, name: str, seed: int) -> Path:
    """Returns the folder of a trained model."""
    return out / "networks" / f"{name}_{seed}"


def get_classifier(out: Path, takes: Takes, epochs: int) -> StyleClassifier:
    """Loads the classifier of the styles from the folder of results, or trains and saves it."""
    folder, config = out / "classifier", ClassifierConfig(epochs=epochs)
    columns = 6 * takes.skeleton.num_joints
    if locate(folder) is not None:
        zeros = np.zeros(columns, np.float32)
        return load_record(folder, init_classifier(config, columns, len(takes.styles), zeros, zeros))
    windows, labels = windows_of(takes.train, takes.styles)
    classifier = train_classifier(windows, labels, len(takes.styles), config)
    save_record(folder, classifier, "classifier.json", {"styles": list(takes.styles), **asdict(config)})
    return classifier


def measure_model(model: Model, takes: Takes, reference: Reference, config: Config) -> dict[str, Any]:
    """Returns one entry of the results."""
    walks = {
        style: rollout_test(
            model,
            style,
            held_out_takes(takes, style),
            reference,
            seconds=config.circle_seconds,
            starts=config.starts,
        )
        for style in takes.styles
    }
    frechet = pooled_frechet(walks, reference)
    per_style = {style: {k: v for k, v in found.items() if k != "features"} for style, found in walks.items()}
    names = [name for name, value in next(iter(per_style.values())).items() if name != "taken_for"]
    means = {name: _mean([found[name] for found in per_style.values()]) for name in names}
    return {
        "train_seconds": model.seconds,
        "train_loss": model.loss,
        "test": one_step(model, takes.test),
        "train": one_step(model, takes.train[:: max(1, len(takes.train) // 60)]),
        "rollouts": {**means, "frechet": frechet, "per_style": per_style},
    }


def main(config: Config) -> dict[str, Any]:
    """Trains and measures the missing models; writes results, tables and plots after each."""
    used = config.sized()
    config.out.mkdir(parents=True, exist_ok=True)
    file = config.json or config.out / "results.json"
    result = _begin(file, used)
    started = time.perf_counter()
    takes = load_takes(used.data, used.held_out, used.takes, used.seconds_per_style)
    print(
        f"{len(takes.train)} training takes, {len(takes.test)} test takes: {time.perf_counter() - started:.0f} s",
        flush=True,
    )
    classifier = get_classifier(config.out, takes, used.classifier_epochs)
    reference = make_reference(classifier, takes.styles, takes.train)
    if "real" not in result:
        result["data"] = describe(takes)
        result["real"] = real_motion(takes.test, reference)
        _write(file, result)
    print(f"real test takes: {100 * result['real']['recognition']:.1f} % recognised", flush=True)
    for seed in range(used.seeds):
        for name in used.models:
            key = f"{name}_{seed}"
            if key in result["models"]:
                continue
            started = time.perf_counter()
            folder = network_folder(config.out, name, seed)
            model = load_model(folder, takes)
            if model is None:
                model = train_model(name, takes, used.pretraining(seed))
                save_model(folder, model)
            entry = {"model": name, "seed": seed, **measure_model(model, takes, reference, used)}
            entry["seconds"] = time.perf_counter() - started
            result["models"][key] = entry
            _write(file, result)
            write_tables(config.out, result)
            print(_line(entry), flush=True)
    write_tables(config.out, result)
    return result


def describe(takes: Takes) -> dict[str, Any]:
    """Returns the numbers of takes and rows."""
    frames = {
        split: {
            style: sum(len(part.x) for t in some if t.style == style for part in t.parts("mason2022"))
            for style in takes.styles
        }
        for split, some in (("train", takes.train), ("test", takes.test))
    }
    return {
        "styles": list(takes.styles),
        "joints": takes.skeleton.num_joints,
        "train_takes": len(takes.train),
        "test_takes": [take.name for take in takes.test],
        "rows": frames,
        "left_out": takes.left_out,
    }


def _begin(file: Path, used: Config) -> dict[str, Any]:
    """Returns the results so far; refuses results of other settings."""
    settings = to_plain({k: v for k, v in asdict(used).items() if k not in ("out", "json", "models", "seeds", "tiny")})
    if not file.exists():
        return {"settings": settings, "machine": machine(), "versions": versions(), "models": {}}
    result = json.loads(file.read_text())
    for key, value in settings.items():
        if result["settings"].get(key) != value:
            rule = f"must be {result['settings'].get(key)}, as in {file}; pass another --out for other settings"
            raise InputError("one_step_error", key, value, rule)
    return result


def _write(file: Path, result: dict[str, Any]) -> None:
    write_whole(file, json_text(result))


def _mean(values: list) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _line(entry: dict[str, Any]) -> str:
    rollouts, test = entry["rollouts"], entry["test"]
    recognised = rollouts["recognition"]
    return (
        f"{entry['model']} seed {entry['seed']}: mse {test['mse']:.4f}, bones {1000 * test['bones']:.2f} mm, "
        f"stable {rollouts['sound']:.2f}, recognised {'–' if recognised is None else f'{recognised:.2f}'}, "
        f"{entry['seconds']:.0f} s"
    )


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
