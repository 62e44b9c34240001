"""Is a style better transferred to a clip, or learned from seconds of it and walked by a character? (Mason 2018, §8.2)

Parent    Mason 2018 §8.2: a neutral clip is transferred to a style by Holden 2016, with one of the clips that few-shot
          learning uses; the trajectory of the result is the input of the controller. Compared in a video, no numbers:
          "in most cases our method is qualitatively at least as good or better"; not for unusual styles.
Question  given the same 5 seconds of a style, which walk is more recognisable, nearer to what an actor of that style
          does, and cleaner: that of the optimisation of 2016, of the fast network of 2017, or of a character with the
          style learned on the base network?
Data      Bandai-Namco-2, which neither the base network nor the base autoencoder has seen. Styles are all but normal;
          their clip is what `experiments.any_clip` learns from. Contents are straight walks and turns of the style
          normal. The takes of every style and content are dealt in turn into two halves: the style clip and what
          trains the classifier and the fast network (walks and turns of normal) are of one; contents, real walks to
          compare with and the classifier's accuracy are of the other.
Measure   all motion on the actors' skeleton at their frame rate, by the same functions
          (`experiments.common.style_walk_judge`): windows recognised as the style; distance of the mean gait cycle from
          real walks of the style with the same content; sliding, skating and jitter; speed, of that of real walks. Real
          walks are judged in the same way against the other real walks, and once more after retargeting to the base
          network's skeleton and back, which the walks of characters have behind them.
Expect    see docs/results_appendix.md.
Run       python -m experiments.transfer_against_few_shot --mocap FOLDER --out runs/transfer_against_few_shot
          Clips are kept in the folder `clips`; run again with the same --out to judge them again, or to resume.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from experiments.common.any_clip_takes import SOURCES, Trial, find_trial
from experiments.common.style_walk_judge import (
    Judge,
    Takes,
    deal_files,
    judge_clip,
    make_judge,
    read_takes,
)
from experiments.common.transfer_against_few_shot_table import write_results
from pfnn_jax.control.controller import Controller, make_controller
from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.actor_test import follow_clip
from pfnn_jax.inference.mixture import choice_weights
from pfnn_jax.io.files import json_text, write_whole
from pfnn_jax.motion.bvh import read_bvh, write_bvh
from pfnn_jax.motion.clip import MotionClip, resample
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.retargeting.body import humanoid_of
from pfnn_jax.motion.retargeting.retarget import retarget
from pfnn_jax.run import Run, load_run
from pfnn_jax.transfer.clip_rows import encode_clip, prepare_clip
from pfnn_jax.transfer.config import OptimisationConfig, TransformationTrainingConfig
from pfnn_jax.transfer.finish import finish_clip
from pfnn_jax.transfer.optimisation import optimise
from pfnn_jax.transfer.pairing import GaitClip, pair_by_gait
from pfnn_jax.transfer.run import BASE_AUTOENCODER, TransferRun, load_transfer_run
from pfnn_jax.transfer.transformation import TransformationNetwork
from pfnn_jax.transfer.transformation_training import apply_network, train_transformation
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip
from pfnn_jax.viewer.draw.drawing import save_figure
from pfnn_jax.viewer.draw.filmstrip import filmstrip
from pfnn_jax.workflows.base import BASE_NETWORK
from pfnn_jax.workflows.learn import default_config, learn_style, precompile

NEUTRAL = "normal"
"""Style of the contents."""

CONTENTS = ("walk", "walk-turn-left", "walk-turn-right")
"""Contents that are transferred."""

SOURCE = next(source for source in SOURCES if source.name == "bandai-namco-2")

NO_STYLE = "without a style"
"""Name of the character that walks without a style."""


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        out: folder of results.
        mocap: folder of all motion capture.
        base: run on which styles are learned; the package's by default.
        autoencoder: run whose autoencoder both methods of transfer use; the package's by default.
        styles: to transfer to; all but normal by default.
        takes: clips of each content that are transferred.
        real: real walks of each content that are judged.
        fast: also train and judge the fast network of each style.
        epochs: of its training.
        classifier_epochs: passes of the style classifier over its windows.
        seed: of both methods of transfer.
    """

    out: Path
    mocap: Path = Path("../shared/mocap")
    base: Path = BASE_NETWORK
    autoencoder: Path = BASE_AUTOENCODER
    styles: tuple[str, ...] = ()
    takes: int = 2
    real: int = 4
    fast: bool = True
    epochs: int = 100
    classifier_epochs: int = 2
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Characters:
    """A copy of the base network that learns, and its controllers by style, filled as they are needed."""

    run: Run
    controllers: dict[str | None, tuple[Controller, Any]]

    def walk(self, style: str | None, clip: MotionClip) -> tuple[MotionClip, float]:
        """Returns a walk in a style along the path of a clip, on its skeleton and at its rate, and its path error in m.

        Raises:
            InputError: if the character does not get to the path.
        """
        if style not in self.controllers:
            weights = choice_weights(self.run, style)
            controller = make_controller(self.run, tuple(weights))
            self.controllers[style] = controller, controller.style_weights(weights or 0)
        run, skeleton = self.run, clip.skeleton
        legs = [leg_length_of(body, humanoid_of(body)) for body in (run.skeleton, skeleton)]
        on_run = retarget(resample(clip, run.layout.fps), run.skeleton).clip
        made = follow_clip(*self.controllers[style], run, on_run, skeleton, legs[0] / legs[1])
        return resample(made.clip, clip.fps), made.path_error


def main(config: Config) -> dict[str, Any]:
    """Makes the missing clips, judges all, and writes the report."""
    for folder in ("clips", "pictures"):
        (config.out / folder).mkdir(parents=True, exist_ok=True)
    files = [file for file in list_clips(config.mocap / SOURCE.folder) if file.content in CONTENTS]
    trials = {style: find_style(style, files) for style in styles_of(files, config)}
    known, test = deal_files(files)
    takes = Takes(read_takes(known), read_takes(test))
    judge = make_judge(takes, config.classifier_epochs)
    methods = open_methods(takes, config)
    rows = []
    for style, trial in trials.items():
        makes = methods.learn(trial, config)
        example = replace(trial.learned.labelled.clip, style=style)
        rows += judge_real(example, takes, judge, methods.characters.run, config.real)
        for content in CONTENTS:
            for clip in takes.test[NEUTRAL, content][: config.takes]:
                rows += judge_content(clip, example, makes, takes, judge, config.out)
        print(f"{style}: done", flush=True)
    settings = {name: str(value) for name, value in asdict(config).items()}
    return write_results(config.out, rows, settings)


def styles_of(files: Sequence[ClipFile], config: Config) -> list[str]:
    """Returns the styles to transfer to."""
    known = sorted({file.style for file in files} - {NEUTRAL})
    for style in config.styles:
        if style not in known:
            raise InputError(config.mocap, "style", style, f"must be one of {', '.join(known)}")
    return list(config.styles) or known


def find_style(style: str, files: Sequence[ClipFile]) -> Trial:
    """Returns the clip of a style, by the rules of `experiments.any_clip`."""
    trial = find_trial(SOURCE, style, [file for file in files if file.style == style])
    if isinstance(trial, str):
        raise InputError(style, "style clip", "none", trial)
    return trial


Make = Callable[[MotionClip, Mapping[str, MotionClip]], tuple[MotionClip, float | None]]
"""Makes a walk from the content and the walks made before, and says how far it is from the path that it follows."""


@dataclass(frozen=True, eq=False)
class Methods:
    """What learns a style and makes walks in it.

    Attributes:
        characters: of few-shot learning.
        transfer: the run of both methods of transfer.
        contents: what fast networks are trained on.
    """

    characters: Characters
    transfer: TransferRun
    contents: Sequence[GaitClip]

    def learn(self, trial: Trial, config: Config) -> dict[str, Make]:
        """Returns what makes walks in a style, learned from its clip by each method."""
        style = GaitClip(self.rows_of(trial.learned.labelled.clip), trial.learned.file.content, trial.style)
        settings, key = OptimisationConfig(), jax.random.key(config.seed)
        makes = {
            "optimisation": self._transfer(lambda rows: optimise(self.transfer, rows, [style.rows], settings, key=key))
        }
        if config.fast:
            network: list[TransformationNetwork] = []  # trained when the first of its walks is missing

            def move(rows: np.ndarray) -> np.ndarray:
                if not network:
                    network.append(self._train(style, config))
                return apply_network(self.transfer, network[0], rows)

            makes["fast network"] = self._transfer(move)
        name, run = f"learned {trial.style}", self.characters.run
        if not (run.path / "styles" / name).exists():
            learn_style(run, replace(trial.learned.file, style=name))
        makes["few-shot"] = lambda _, made: self.characters.walk(name, made["optimisation"])
        makes[NO_STYLE] = lambda _, made: self.characters.walk(None, made["optimisation"])
        return makes

    def rows_of(self, clip: MotionClip) -> np.ndarray:
        """Returns the rows [T, D] of a clip."""
        return encode_clip(prepare_clip(clip, self.transfer.skeleton), self.transfer.layout)

    def _transfer(self, move: Callable[[np.ndarray], np.ndarray]) -> Make:
        run = self.transfer
        return lambda clip, _: (finish_clip(move(self.rows_of(clip)), clip, run.skeleton, run.layout), None)

    def _train(self, style: GaitClip, config: Config) -> TransformationNetwork:
        settings = TransformationTrainingConfig(epochs=config.epochs, seed=config.seed)
        pairing = pair_by_gait(self.contents, [style], self.transfer.layout)
        return train_transformation(self.transfer, self.contents, [style], pairing, settings)[0]


def open_methods(takes: Takes, config: Config) -> Methods:
    """Returns the methods; styles are learned on a copy of the base network, which is kept."""
    copy = config.out / "base"
    if not copy.exists():
        shutil.copytree(config.base, copy, ignore=shutil.ignore_patterns("train_state"))
    run = load_run(copy)
    precompile(run, default_config(run))
    methods = Methods(Characters(run, {}), load_transfer_run(config.autoencoder), ())
    clips = [clip for content in CONTENTS for clip in takes.known[NEUTRAL, content]] if config.fast else []
    return replace(methods, contents=[GaitClip(methods.rows_of(clip), clip.content, clip.source) for clip in clips])


def judge_content(
    clip: MotionClip, example: MotionClip, makes: Mapping[str, Make], takes: Takes, judge: Judge, out: Path
) -> list[dict[str, Any]]:
    """Returns the rows of one content: as it is, and by every method; makes what has not been made, and draws all.

    Args:
        clip: the content.
        example: the style clip.
        makes: what makes walks, by method.
        takes, judge: to compare with.
        out: folder of results.
    """
    style, name = example.style, Path(clip.source).stem
    key = style, clip.content
    made: dict[str, MotionClip] = {"content": clip}
    rows = [_row(key, name, "content", judge_clip(clip, clip, example, judge))]
    for method, make in makes.items():
        file = out / "clips" / f"{style}__{name}__{method.replace(' ', '_')}.bvh"
        note = file.with_suffix(".json")
        if not note.exists():
            write_whole(note, json_text(_make(make, clip, made, file)))
        about = json.loads(note.read_text())
        if about["fault"]:
            rows.append({**_row(key, name, method, {}), **about})
            continue
        made[method] = read_bvh(file)
        rows.append({**_row(key, name, method, judge_clip(made[method], clip, example, judge)), **about})
    real = takes.test[key][0]
    shown = [AnnotatedClip(f"real, {style}", real), *(AnnotatedClip(method, one) for method, one in made.items())]
    save_figure(
        filmstrip(*shown, moments=6, title=f"{name} as {style}"), out / "pictures" / f"{style}__{name}.png", dpi=72
    )
    return rows


def _make(make: Make, clip: MotionClip, made: Mapping[str, MotionClip], file: Path) -> dict[str, Any]:
    """Makes and writes a walk; returns what is known about it."""
    try:
        walk, path_error = make(clip, made)
    except InputError as error:
        return {"fault": f"{error.place}: {error.value}", "path_error": None}
    write_bvh(file, walk, overwrite=True)
    return {"fault": "", "path_error": None if path_error is None else 100.0 * path_error}


def judge_real(example: MotionClip, takes: Takes, judge: Judge, run: Run, most: int) -> list[dict[str, Any]]:
    """Returns the rows of `most` real walks of each content, compared with the others, as they are and retargeted."""
    rows = []
    for content in CONTENTS:
        key = example.style, content
        for number, clip in enumerate(takes.test[key][:most]):
            back = retarget(retarget(clip, run.skeleton).clip, clip.skeleton).clip
            for method, shown in (("real", clip), ("real, retargeted", back)):
                measures = judge_clip(shown, clip, example, judge, without=number)
                rows.append(_row(key, Path(clip.source).stem, method, measures))
    return rows


def _row(key: tuple[str, str], name: str, method: str, measures: Mapping[str, Any]) -> dict[str, Any]:
    return {"style": key[0], "content": key[1], "clip": name, "method": method, "fault": "", **measures}


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
