"""Does a style learned from any clip, on any network, come nearer to what the actor did than the network without it?

Parent    Mason 2018 §7-8 and Mason 2022 §5.3.2, where new styles come from the skeleton and often the actor of the
          pretraining data.
Question  for clips of any skeleton, put onto a network's own: by how many centimetres does the walk of a learned style
          differ from the actor's, next to the network without a style, the network's nearest style, what retargeting
          alone changes, and what two takes of the actor differ by?
Data      procedural walks, Bandai-Namco-1 and -2, 100STYLE, Xia, PFNN and files from the field, each on every given
          run. Which clips, and which takes they are judged on, follows from the rules of
          `experiments.common.any_clip_takes`; skipped styles are reported with the reason.
Measure   the character walks along the path of a real take at its speed, and is put back onto the actor's skeleton
          (`pfnn_jax.evaluation.actor_test`): mean distance of the joints between the mean gait cycles. A walk that
          diverges or does not follow the path counts as failed.
Expect    see docs/results_appendix.md.
Run       python -m experiments.any_clip --bases NAME=RUN [NAME=RUN ...] --mocap FOLDER --out runs/any_clip
          Runs are copied before they learn. Each row is written when it is finished; run again with the same --out to
          resume, or with more styles.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from experiments.common.any_clip_report import write_results
from experiments.common.any_clip_takes import SOURCES, Part, Source, Trial, find_trial, list_styles_of
from pfnn_jax.control.controller import Controller, make_controller
from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.actor_test import (
    Actor,
    ActorWalk,
    actor_distance,
    compare_walk,
    follow_actor,
    holding_distance,
    make_actor,
    one_step_distance,
    retargeting_distance,
    skating_of,
)
from pfnn_jax.inference.mixture import choice_weights
from pfnn_jax.inference.predictor import make_predictor
from pfnn_jax.io.files import json_text, write_whole
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.run import Run, load_run
from pfnn_jax.training.config import MASON2018_FEW_SHOT, FewShotConfig
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip
from pfnn_jax.viewer.draw.drawing import save_figure
from pfnn_jax.viewer.draw.filmstrip import filmstrip
from pfnn_jax.workflows.learn import default_config, learn_style, precompile

PREFIX = "learned "
"""Of the names of learned styles in the copy of a run, whose own styles may have any name."""


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        bases: runs, each as NAME=DIRECTORY.
        out: folder of results.
        mocap: folder of all motion capture, with the folders of `SOURCES`.
        seen: BASE:SOURCE for every source whose clips a base was trained on.
        paper: names of the bases whose styles are learned by the paper's recipe.
        sources: names of the sources; all by default.
        styles: largest number of styles of each source, in the order of names.
        field: the same for the files from the field, each of which is a style.
        only: styles to use, in place of that number; all by default.
    """

    bases: tuple[str, ...]
    out: Path
    mocap: Path = Path("../shared/mocap")
    seen: tuple[str, ...] = ()
    paper: tuple[str, ...] = ()
    sources: tuple[str, ...] = tuple(source.name for source in SOURCES)
    styles: int = 3
    field: int = 8
    only: tuple[str, ...] = ()

    def __post_init__(self):
        known = [source.name for source in SOURCES]
        for name in self.sources:
            if name not in known:
                raise InputError("any_clip", "sources", name, f"must be one of {', '.join(known)}")
        for base in self.bases:
            if not all(base.partition("=")):
                raise InputError("any_clip", "bases", base, "must be NAME=DIRECTORY")
        for pair in self.seen:
            base, _, source = pair.partition(":")
            if base not in self.runs or source not in known:
                raise InputError("any_clip", "seen", pair, "must be BASE:SOURCE, of the bases and sources")
        for name in self.paper:
            if name not in self.runs:
                raise InputError("any_clip", "paper", name, "must be names of the bases")

    @property
    def runs(self) -> dict[str, Path]:
        """Directories of the bases by name."""
        return {name: Path(folder) for name, _, folder in (base.partition("=") for base in self.bases)}


@dataclass(frozen=True, eq=False)
class Base:
    """A run that learns.

    Attributes:
        name: of the base.
        run: a copy, which receives the learned styles.
        few_shot: how they are learned.
        controllers: of its styles by name, and of the run without a style under None, each with the weights of its
            styles; filled as they are needed.
    """

    name: str
    run: Run
    few_shot: FewShotConfig
    controllers: dict[str | None, tuple[Controller, np.ndarray]]

    def controller(self, style: str | None) -> tuple[Controller, np.ndarray]:
        """Returns the controller of one style, or of the run without a style, and the weights [C] to run it with."""
        if style not in self.controllers:
            weights = choice_weights(self.run, style)
            controller = make_controller(self.run, tuple(weights))
            self.controllers[style] = controller, controller.style_weights(weights or 0)
        return self.controllers[style]


def main(config: Config) -> dict[str, Any]:
    """Learns and judges the missing rows; writes the report."""
    (config.out / "rows").mkdir(parents=True, exist_ok=True)
    trials = {source.name: choose_trials(source, config) for source in SOURCES if source.name in config.sources}
    for name, folder in config.runs.items():
        base = None
        for trial in (trial for found, _ in trials.values() for trial in found):
            file = row_file(config.out, name, trial)
            if not file.exists():
                base = open_base(name, folder, config) if base is None else base
                write_whole(file, json_text(run_trial(base, trial, config)))
            _print(json.loads(file.read_text()))
    rows = [json.loads(file.read_text()) for file in sorted((config.out / "rows").glob("*.json"))]
    skipped = {name: reasons for name, (_, reasons) in trials.items()}
    settings = {key: str(value) for key, value in asdict(config).items()}
    return write_results(config.out, [row for row in rows if row["base"] in config.runs], skipped, settings)


def choose_trials(source: Source, config: Config) -> tuple[list[Trial], dict[str, str]]:
    """Returns the trials of a source, and style -> reason for those that were tried and skipped."""
    most = config.field if source.name == "field" else config.styles
    trials, skipped = [], {}
    for style, files in list_styles_of(source, config.mocap, config.out / "procedural").items():
        if (config.only and style not in config.only) or len(trials) == most:
            continue
        found = find_trial(source, style, files)
        if isinstance(found, Trial):
            trials.append(found)
        else:
            skipped[style] = found
    return trials, skipped


def open_base(name: str, folder: Path, config: Config) -> Base:
    """Returns a base in a fresh copy of its run, with everything compiled that learning needs."""
    copy = config.out / "runs" / name
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(folder, copy, ignore=shutil.ignore_patterns("train_state"))
    run = load_run(copy)
    few_shot = default_config(run)
    if name in config.paper:
        few_shot = replace(MASON2018_FEW_SHOT, rank=few_shot.rank)
    precompile(run, few_shot)
    return Base(name, run, few_shot, {})


def row_file(out: Path, base: str, trial: Trial) -> Path:
    """Returns the file of a row."""
    return out / "rows" / f"{base}__{trial.source}__{trial.style}.json"


def run_trial(base: Base, trial: Trial, config: Config) -> dict[str, Any]:
    """Returns the row of one style on one base: learned, judged, and drawn."""
    started = time.perf_counter()
    run, name = base.run, PREFIX + trial.style
    row = {
        "base": base.name,
        "source": trial.source,
        "style": trial.style,
        "seen": f"{base.name}:{trial.source}" in config.seen,
        "how": trial.how,
        "learned": _about(trial.learned),
    }
    info = learn_style(run, _renamed(trial.learned, name), base.few_shot, overwrite=True)
    row["info"] = {
        key: info[key] for key in ("seconds", "choice", "error_without_style", "stable_on_turns", "mirrored")
    }
    row["info"] |= {"warnings": info["warnings"], "notes": info["notes"]}
    learned = make_actor(trial.learned.labelled, run)
    own, distances = nearest_style(base, learned)
    row |= {"own_style": own, "own_styles": distances}
    base.controllers.pop(name, None)
    styles = {"learned": name, "without": None, "own": own}
    row["judged"] = [judge(base, part, styles, learned, trial, config.out) for part in trial.judged]
    row["seconds"] = time.perf_counter() - started
    return row


def nearest_style(base: Base, learned: Actor) -> tuple[str | None, dict[str, float | None]]:
    """Returns the run's own style whose walk is nearest to the learned clip, and the distances of all in cm."""
    distances = {name: walk_of(base, name, learned)[0]["distance"] for name in base.run.config.styles}
    known = {name: distance for name, distance in distances.items() if distance is not None}
    return (min(known, key=lambda name: known[name]) if known else None), distances


def judge(
    base: Base, part: Part, styles: Mapping[str, str | None], learned: Actor, trial: Trial, out: Path
) -> dict[str, Any]:
    """Returns the measures of one take, and draws it."""
    run, actor = base.run, make_actor(part.labelled, base.run)
    found: dict[str, Any] = {
        **_about(part),
        "retargeting": retargeting_distance(actor, run),
        "actor": None if part is trial.learned else actor_distance(actor, learned),
        "skating": skating_of(actor.world),
        "hold": holding_distance(actor, run),
        "walks": {},
    }
    shown = [AnnotatedClip(f"{trial.source}: {part.file.path.stem}", actor.world.clip, note="what the actor did")]
    for kind, style in styles.items():
        measures, walk = walk_of(base, style, actor)
        measures["one_step"] = one_step_distance(make_predictor(run, style), actor, run)
        found["walks"][kind] = measures
        if walk is not None:
            shown.append(AnnotatedClip(_titles(kind, style), walk.clip, note=_note(measures)))
    picture = out / "pictures" / f"{base.name}__{trial.source}__{part.file.path.stem}.png"
    picture.parent.mkdir(exist_ok=True)
    save_figure(filmstrip(*shown, moments=6, title=f"{trial.style} on {base.name}"), picture, dpi=72)
    found["picture"] = picture.name
    return found


def walk_of(base: Base, style: str | None, actor: Actor) -> tuple[dict[str, Any], ActorWalk | None]:
    """Returns the measures of a walk in one style along an actor's path, and the walk unless there is none."""
    try:
        walk = follow_actor(*base.controller(style), base.run, actor)
    except InputError as error:
        return {"distance": None, "faults": [str(error.value)]}, None
    return compare_walk(actor, walk), walk


def _about(part: Part) -> dict[str, Any]:
    return {"file": part.file.path.name, "begin": part.begin, "part_seconds": part.seconds, "speed": part.speed}


def _renamed(part: Part, name: str) -> ClipFile:
    return replace(part.file, style=name)


def _titles(kind: str, style: str | None) -> str:
    return {"learned": "learned", "without": "without a style", "own": f"nearest style of the run: {style}"}[kind]


def _note(measures: Mapping[str, Any]) -> str:
    distance, faults = measures["distance"], "; ".join(measures["faults"])
    return ", ".join(filter(None, (f"{distance:.1f} cm" if distance is not None else "", faults)))


def _print(row: Mapping[str, Any]) -> None:
    for take in row["judged"]:
        cells = [f"{kind} {_note(walk) or '?'}" for kind, walk in take["walks"].items()]
        print(f"{row['base']}, {row['source']}, {row['style']} ({take['file']}): {', '.join(cells)}", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
