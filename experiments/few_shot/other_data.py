"""Does few-shot's default hold on data that nothing was chosen on, from other recordings and another skeleton?

Question  methods were chosen and confirmed on styles of Bandai-Namco-2. How far from the actor are characters whose
          style was learned from other data?
Method    two networks of all styles of Bandai-Namco-2, trained once: one as in the paper and one with the pose noise
          that belongs to the default. Learned from:
          - Bandai-Namco-1, every style: 5 s of its first straight walk; judged on the second one and on its side steps.
            The skeleton is the network's. The side steps go ahead at an angle of 20 to 40 degrees to the facing, which
            the judge does not ask for: characters face along the path.
          - 100STYLE, `Angry_FW`, put onto the network's skeleton. No 5 s of this take are straight: its straightest 5 s
            turn by 100 degrees. Learned are its first 5 s of straight frames (`straight_frames`: 6 pieces) and, as a
            user may do it, its first 5 s as they are, which turn; judged on its other turns.
          Driven and judged are no adapter and the paper's recipe on the plain network; restyled rows by an adapter of
          the second layer, and by one of the output, which is the default, on the noisy one; on 100STYLE also, as a
          bound, an adapter of the learned frames and of the other half of the turns, in both directions.
Verdict   seed 0, cm, controller / loop, no adapter, the paper's recipe, the default. 100STYLE, 9 turns, from straight
          frames 9.42 / 9.98, 6.79 / 7.23, 6.14 / 6.05; 7 turns, from its first 5 s 9.23 / 9.80, 8.58 / 8.39,
          6.44 / 6.33. Bandai-Namco-1, mean of 8 styles: another walk 6.69 / 6.49, 5.03 / 5.06, 4.36 / 4.35; side steps
          7.22 / 7.02, 5.93 / 5.93, 5.59 / 5.58. In the controller the default is nearer than the paper's recipe in all
          18 cases, in the loop in 14; there its *angry* runs at 1.8 times the commanded speed (6.07, the paper's recipe
          4.66). Measured with networks that had not seen every second turning take of *elderly*; the second layer and
          the bound were not measured.
Run       python -m experiments.few_shot.other_data --mocap FOLDER --out runs/other_data
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import numpy as np
import tyro

from experiments.common.few_shot_recipes import evenly
from experiments.common.markdown import markdown_table
from experiments.common.straight_and_turning import cut_parts, straight_frames, travel_of, turns_of
from experiments.common.style_takes import Take, TrainedNetwork, balanced, load_takes, pretrain_on, rows_of
from experiments.common.turning_folds import load_network, no_style, save_network
from experiments.common.turning_judged import WAYS, Body, JudgedWalks, StyledNetwork, drive, judge_walks
from experiments.common.turning_table import NONE, OWN_TURNS, PAPER, load_judged, save_judged
from experiments.few_shot.restyled_turns import DEFAULT, MIDDLE, NOISY_RESTYLED
from pfnn_jax.evaluation.driven_takes import DrivenTake, make_driven_take
from pfnn_jax.evaluation.turning_judge import mean_measures
from pfnn_jax.io.files import locate, write_whole
from pfnn_jax.models.style import Style
from pfnn_jax.motion.datasets.clip_rows import labelled_features, load_for_skeleton
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips
from pfnn_jax.motion.features.decode import median_speed
from pfnn_jax.motion.features.encode import Features, join_rows, select_rows
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.training.config import MASON2018_FEW_SHOT, RESTYLED_FEW_SHOT, FewShotConfig, PretrainConfig
from pfnn_jax.training.data import Rows
from pfnn_jax.training.few_shot_learning import fit_style
from pfnn_jax.training.pretraining import POSE_NOISE
from pfnn_jax.training.restyling import StyleDifferences, find_differences
from pfnn_jax.workflows.pretrain import DIFFERENCE_ROWS

PRETRAINING, SAME_SKELETON, OTHER_SKELETON = "bandai-namco-2", "bandai-namco-1", "100style"
"""Folders of the data sets."""

STRAIGHT, SIDE_STEPS, TURNS = "another walk", "side steps", "turns"
"""What a style is judged on."""

METHODS = (NONE, PAPER, NOISY_RESTYLED, DEFAULT, OWN_TURNS)
"""Methods in the order of the tables."""

SHOWN = ("distance", "turning", "path", "turn rate", "speed", "contacts", "flicker", "sliding", "failed")
"""Measures that have a table."""

Judged = Mapping[str, Mapping[str, JudgedWalks]]
"""Measures by what was judged and by way."""


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        mocap: folder of the data sets.
        out: folder of networks, judged walks and tables.
        hidden, steps, batch_size, learning_rate: of all pretraining, as in the other experiments of this folder.
        seconds: that are learned.
        seed: of networks and learning.
        limit: largest number of takes of each style and content of the pretraining data, 0 for all.
        sources: data sets that are learned from and judged on.
    """

    mocap: Path
    out: Path
    hidden: int = 512
    steps: int = 2000
    batch_size: int = 256
    learning_rate: float = 1e-3
    seconds: float = 5.0
    seed: int = 0
    limit: int = 0
    sources: tuple[str, ...] = (SAME_SKELETON, OTHER_SKELETON)


@dataclass(frozen=True, eq=False)
class Networks:
    """What all styles are learned with.

    Attributes:
        layout, skeleton: of the pretraining data.
        plain, noisy: the networks.
        differences: of the styles that the noisy network knows.
    """

    layout: FrameLayout
    skeleton: Skeleton
    plain: TrainedNetwork
    noisy: TrainedNetwork
    differences: StyleDifferences

    def body(self, network: TrainedNetwork) -> Body:
        """Returns what a network was trained on."""
        return Body(self.layout, self.skeleton, network.normaliser)


@dataclass(frozen=True, eq=False)
class Trial:
    """A style that is learned from one clip.

    Attributes:
        name: of the style and its data set.
        clip: rows of the clip and of its mirror image.
        judged: real takes by what they show.
        turns: rows of every take in `judged[TURNS]`, for the bound; empty without one.
    """

    name: str
    clip: tuple[Features, ...]
    judged: Mapping[str, Sequence[DrivenTake]]
    turns: tuple[Features, ...] = ()


def load_networks(config: Config) -> Networks:
    """Returns both networks: those that were kept, or pretrained and kept now."""
    takes, layout, skeleton = load_takes(config.mocap / PRETRAINING, config.limit)
    styles = sorted({take.style for take in takes})
    plain = _network(config, "plain", takes, layout, 0.0)
    noisy = _network(config, f"noise{POSE_NOISE:g}", takes, layout, POSE_NOISE)
    rows = {s: evenly(rows_of([take for take in takes if take.style == s]), DIFFERENCE_ROWS) for s in styles}
    differences = find_differences(rows, layout, noisy.normaliser, seed=config.seed)
    assert differences is not None  # these styles turn
    return Networks(layout, skeleton, plain, noisy, differences)


def _network(
    config: Config, name: str, takes: Sequence[Take], layout: FrameLayout, pose_noise: float
) -> TrainedNetwork:
    settings = PretrainConfig(
        hidden=config.hidden,
        steps=config.steps,
        batch_size=config.batch_size,
        learning_rate=config.learning_rate,
        pose_noise=pose_noise,
        seed=config.seed,
    )
    folder, styles = config.out / "networks" / name, sorted({take.style for take in takes})
    if locate(folder / "parameters") is None:
        save_network(folder, pretrain_on(balanced(takes, styles, config.seed), layout, settings))
    return load_network(folder, settings, layout, len(styles))


def list_trials(config: Config, networks: Networks) -> Iterator[Trial]:
    """Yields what is learned and judged, one style after another."""
    if SAME_SKELETON in config.sources:
        files = list_clips(config.mocap / SAME_SKELETON)
        for style in sorted({file.style for file in files}):
            own = [_load(file, networks) for file in files if file.style == style and "walk" in file.content]
            yield straight_trial(f"{SAME_SKELETON} {style}", own, networks, config.seconds)
    if OTHER_SKELETON in config.sources:
        (file,) = (file for file in list_clips(config.mocap / OTHER_SKELETON) if file.path.stem == "Angry_FW")
        whole = _load(file, networks)
        frames = straight_frames(travel_of(whole), config.seconds)
        yield turning_trial(f"{OTHER_SKELETON} Angry, straight frames", whole, frames, networks)
        frames = np.arange(round(config.seconds * networks.layout.fps))
        yield turning_trial(f"{OTHER_SKELETON} Angry, first {config.seconds:g} s", whole, frames, networks)


def _load(file: ClipFile, networks: Networks) -> LabelledClip:
    return load_for_skeleton(file, networks.layout, networks.skeleton)


def straight_trial(name: str, own: Sequence[LabelledClip], networks: Networks, seconds: float) -> Trial:
    """Returns the trial that learns the first straight walk of a style."""
    walks = [labelled for labelled in own if labelled.clip.content == "walk"]
    aside = [labelled for labelled in own if labelled.clip.content in ("walk-left", "walk-right")]
    frames = np.arange(round(seconds * networks.layout.fps))
    judged = {STRAIGHT: _driven(walks[1:], networks), SIDE_STEPS: _driven(aside, networks)}
    return Trial(name, _rows(walks[0], frames, networks), judged)


def turning_trial(name: str, whole: LabelledClip, learned: np.ndarray, networks: Networks) -> Trial:
    """Returns the trial that learns some frames of a long take, and is judged on its turns."""
    parts = turns_of(travel_of(whole), learned)
    turns = tuple(join_rows(_rows(whole, np.arange(*part), networks)) for part in parts)
    judged = {TURNS: _driven(cut_parts(whole, parts), networks)}
    return Trial(name, _rows(whole, learned, networks), judged, turns)


def _rows(labelled: LabelledClip, frames: np.ndarray, networks: Networks) -> tuple[Features, ...]:
    """Returns the rows of some frames and of their mirror images."""
    both = labelled_features(labelled, networks.layout, mirror=True)
    return tuple(select_rows(rows, np.isin(rows.frames, frames)) for rows in both)


def _driven(clips: Sequence[LabelledClip], networks: Networks) -> list[DrivenTake]:
    return [make_driven_take(labelled, networks.body(networks.plain)) for labelled in clips]


def judge_trial(trial: Trial, networks: Networks, config: Config) -> None:
    """Learns and judges all methods of a trial that were not judged before."""
    plain, noisy = networks.plain, networks.noisy

    def learned(network: TrainedNetwork, recipe: FewShotConfig) -> Judged:
        return judge(trial, network, learn(trial.clip, network, networks, recipe, config), networks)

    methods: dict[str, Callable[[], Judged]] = {
        NONE: lambda: judge(trial, plain, no_style(plain), networks),
        PAPER: lambda: learned(plain, MASON2018_FEW_SHOT),
        NOISY_RESTYLED: lambda: learned(noisy, MIDDLE),
        DEFAULT: lambda: learned(noisy, RESTYLED_FEW_SHOT),
    }
    if trial.turns:
        methods[OWN_TURNS] = lambda: judge_own_turns(trial, noisy, networks, config)
    for method, run in methods.items():
        if all(judged_file(config, trial.name, kind, method).exists() for kind in trial.judged):
            continue
        for kind, judged in run().items():
            save_judged(judged_file(config, trial.name, kind, method), judged)
            found = ", ".join(f"{way} {walks.means()['distance']:.2f}" for way, walks in judged.items())
            print(f"{trial.name}, {kind}, {method}: {found} cm", flush=True)


def learn(
    parts: Sequence[Features], network: TrainedNetwork, networks: Networks, recipe: FewShotConfig, config: Config
) -> Style:
    """Returns the style that a recipe learns from rows."""
    rows = Rows.from_features({"style": list(parts)}, networks.layout, network.normaliser)
    differences = networks.differences if recipe.restyled else None
    return fit_style(network.shared, rows, recipe, key=jax.random.key(config.seed), differences=differences).style


def judge(trial: Trial, network: TrainedNetwork, style: Style, networks: Networks) -> Judged:
    """Returns the measures of a style along all takes of a trial, which are driven at once."""
    speed = float(median_speed(networks.layout, trial.clip[0].y))
    styled = StyledNetwork(network.shared, jax.tree.map(np.asarray, style), networks.body(network), speed)
    driven = drive(styled, [take for takes in trial.judged.values() for take in takes])
    found, first = {}, 0
    for kind, takes in trial.judged.items():
        walks = [own[first : first + len(takes)] for own in driven]
        found[kind] = {way: judge_walks(takes, own) for way, own in zip(WAYS, walks, strict=True)}
        first += len(takes)
    return found


def judge_own_turns(trial: Trial, network: TrainedNetwork, networks: Networks, config: Config) -> Judged:
    """Returns the measures on each half of the turns of a style that was learned from the clip and the other half."""
    takes, halves = trial.judged[TURNS], []
    recipe = replace(RESTYLED_FEW_SHOT, restyled=False)
    for half in (0, 1):
        tested = np.concatenate([rows.frames for rows in trial.turns[half::2]])
        turns = join_rows([select_rows(rows, ~np.isin(rows.frames, tested)) for rows in trial.turns[1 - half :: 2]])
        style = learn([*trial.clip, turns], network, networks, recipe, config)
        halves.append(judge(replace(trial, judged={TURNS: takes[half::2]}), network, style, networks)[TURNS])
    return {TURNS: {way: _joined([half[way] for half in halves]) for way in WAYS}}


def _joined(halves: Sequence[JudgedWalks]) -> JudgedWalks:
    return JudgedWalks([take for half in halves for take in half.takes], mean_measures([half.style for half in halves]))


def judged_file(config: Config, trial: str, kind: str, method: str) -> Path:
    """Returns where the measures of a method are kept."""
    return config.out / "judged" / f"{trial}, {kind}" / f"{method}.json"


def load_results(config: Config) -> dict[str, dict[str, dict[str, JudgedWalks]]]:
    """Returns all measures in the folder of results, by case (what was learned and judged on) and method."""
    cases = sorted((config.out / "judged").iterdir())
    return {
        case.name: {
            method: load_judged(case / f"{method}.json") for method in METHODS if (case / f"{method}.json").exists()
        }
        for case in cases
    }


def table(results: Mapping[str, Mapping[str, Mapping[str, JudgedWalks]]], measure: str = "distance") -> str:
    """Returns a measure of every case (rows) and method (columns), controller / loop, and the means of cases alike."""
    rows, kinds = [], {}
    for case, found in results.items():
        rows.append([case, *(pair([found[method]], measure) if method in found else None for method in METHODS)])
        kinds.setdefault(case.rpartition(", ")[2], []).append(found)
    for kind, cases in kinds.items():
        if len(cases) > 1:
            means = (
                pair([found[method] for found in cases], measure) if method in cases[0] else None for method in METHODS
            )
            rows.append([f"mean, {kind}", *means])
    return markdown_table([f"{measure}, controller / loop", *METHODS], rows)


def pair(found: Sequence[Mapping[str, JudgedWalks]], measure: str) -> str:
    """Returns the mean of a measure over cases in both ways, the controller first."""
    means = [mean_measures([walks[way].means() for walks in found])[measure] for way in WAYS[::-1]]
    return " / ".join("–" if np.isnan(mean) else f"{mean:.2f}" for mean in means)


def main(config: Config) -> None:
    """Judges what is missing, and writes the tables."""
    networks = load_networks(config)
    for trial in list_trials(config, networks):
        judge_trial(trial, networks, config)
    results = load_results(config)
    text = "\n".join(table(results, measure) for measure in SHOWN)
    write_whole(config.out / "other_data.md", text)
    print(text)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
