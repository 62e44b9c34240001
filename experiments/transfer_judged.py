"""How good is style transfer, by the field's own measures, next to real clips and to what other systems released?

Parent    Holden et al. 2017, whose results "are visually similar to the optimisation", without a number; Aberman et al.
          2020 and Park et al. 2021, whose released outputs are judged by the same functions.
Question  is the style of results recognised, and is their content, relative to real clips? How far are they from the
          same content in the target style, which was really recorded? Do feet slide, is motion jittery, do paths stay?
          What do projection, constraints and foot IK contribute, and what does strength trade?
Data      xia-test: 6 styles x 5 contents, one clip each, on which nothing was tuned. Pairs of different styles with a
          style clip of another content; of the same content, where the style clip is the ground truth; and pairs of one
          style, where the content itself is the right answer (CC of MoST). The pairs of Aberman 2020 and Park 2021 at
          30 fps.
Seen      by the optimisation: the pair, and what the run's autoencoder was trained on. By a fast network, one for each
          style and tested content: clips of xia-test of all other contents, the style's own as style, those of the
          other styles as content, and contents of Bandai-Namco-2 if asked for; no clip of the tested content. By the
          classifiers: `Folds.recognisers`. Recognition is relative to that of real clips of the same folds.
Expect    see docs/results_appendix.md.
Run       python -m experiments.transfer_judged --out runs/transfer_judged --limit 40
          Results are kept as BVH files in the folder `clips`, and are not made again: delete those of a method to
          make them again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tyro

from experiments.common.transfer_judged_report import write_results
from experiments.common.transfer_methods import ANCHORS, FINISHES, Methods
from experiments.common.transfer_pairs import (
    CLASSIFIER,
    OTHER_CONTENT,
    PEER_FPS,
    Folds,
    Pair,
    load_peers,
    load_xia,
    xia_pairs,
)
from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.style_classifier import ClassifierConfig
from pfnn_jax.evaluation.transfer_judge import Record, clips_frechet, judge_transfer
from pfnn_jax.io.files import json_text, write_whole
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.datasets.labelled import read_cut_clip
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips
from pfnn_jax.motion.length_unit import CENTIMETRE
from pfnn_jax.transfer.config import OptimisationConfig, TransformationTrainingConfig
from pfnn_jax.transfer.run import BASE_AUTOENCODER, load_transfer_run

DRAWN = 4
"""Pairs of each kind in the report's pictures."""


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        out: folder of results.
        mocap: folder of all motion capture, with `xia-test` and `bandai-namco-2`.
        peers: folder of the outputs that others released; without it they are left out.
        run: run of style transfer whose autoencoder is used.
        methods: rows of the table, of `ANCHORS` and `FINISHES`.
        limit: largest number of pairs of each kind; 0 for all.
        bandai: clips of Bandai-Namco-2 that fast networks learn from as well.
        networks: networks of each classifier.
        seed: of the draw of pairs, of noise and of training.
        classifier: of each fold.
        optimisation: settings.
        training: settings of fast networks.
    """

    out: Path
    mocap: Path = Path("../shared/mocap")
    peers: Path = Path("../shared/reference/transfer")
    run: Path = BASE_AUTOENCODER
    methods: tuple[str, ...] = (*ANCHORS, *(name for name in FINISHES if name.startswith("optimisation")))
    limit: int = 40
    bandai: int = 0
    networks: int = 3
    seed: int = 0
    classifier: ClassifierConfig = CLASSIFIER
    optimisation: OptimisationConfig = OptimisationConfig()
    training: TransformationTrainingConfig = TransformationTrainingConfig()

    def __post_init__(self):
        for name in self.methods:
            if name not in (*ANCHORS, *FINISHES):
                known = ", ".join((*ANCHORS, *FINISHES))
                raise InputError("transfer_judged", "methods", name, f"must be one of {known}")


def main(config: Config) -> dict[str, Any]:
    """Makes the missing results, judges all of them, and writes the report."""
    clips = load_xia(config.mocap / "xia-test")
    pairs = xia_pairs(clips, config.limit, config.seed)
    folds = Folds(tuple(clips), config.classifier, config.networks)
    more = list_clips(config.mocap / "bandai-namco-2")[:: max(462 // config.bandai, 1)] if config.bandai else []
    contents = [read_cut_clip(file).clip for file in more[: config.bandai]]
    methods = Methods(load_transfer_run(config.run), clips, contents, config.optimisation, config.training, config.seed)
    results = {name: make_results(name, pairs, methods, config.out) for name in config.methods}
    records = {name: judge(name, pairs, found, folds, config.out) for name, found in results.items()}
    peers = judge_peers(methods, folds, config) if config.peers.is_dir() else []
    found = {
        "config": {key: str(value) for key, value in asdict(config).items()},
        "accuracy on real clips": folds.accuracy(pairs),
        "records": records,
        "frechet": {name: frechet(folds, pairs, found) for name, found in results.items()},
        "peers": peers,
    }
    shown = {name: found for name, found in results.items() if name not in ("style clip",)}
    write_results(config.out, found, pairs, shown, DRAWN)
    return found


def make_results(name: str, pairs: Sequence[Pair], methods: Methods, out: Path) -> dict[str, MotionClip]:
    """Returns the results of a method by the name of the pair, read from disk where they have been made before."""
    found = {}
    for pair in pairs:
        file = out / "clips" / name.replace(" ", "_") / f"{pair.name}.bvh"
        if name not in ANCHORS and file.exists():
            stored = ClipFile(file, pair.style.style, pair.content.content, unit=CENTIMETRE)
            found[pair.name] = read_cut_clip(stored).clip
            continue
        clip = methods.result(name, pair)
        if clip is None:
            continue
        found[pair.name] = clip
        if name not in ANCHORS:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_bvh(file, clip)
    print(f"{name}: {len(found)} clips", flush=True)
    return found


def judge(
    name: str, pairs: Sequence[Pair], results: Mapping[str, MotionClip], folds: Folds, out: Path
) -> list[dict[str, Any]]:
    """Returns the measures of a method's results, each with the kind and the name of the pair, and writes them."""
    found = []
    for pair in pairs:
        if pair.name in results:
            record = judge_transfer(pair.content, pair.style, results[pair.name], pair.truth, folds.recognisers(pair))
            found.append({"pair": pair.name, "kind": pair.kind, **record})
    (out / "records").mkdir(parents=True, exist_ok=True)
    write_whole(out / "records" / f"{name.replace(' ', '_')}.json", json_text(found))
    print(f"{name}: judged", flush=True)
    return found


def judge_peers(methods: Methods, folds: Folds, config: Config) -> list[dict[str, Any]]:
    """Returns the measures of the outputs that others released, and of ours on the same pairs at the same rate."""
    found = []
    for peer in load_peers(config.peers, methods.clips):
        pair = peer.pair
        made = {name: make_results(name, [pair], methods, config.out).get(pair.name) for name in config.methods}
        for name, clip in (made | peer.results).items():
            if clip is not None:
                record: Record = judge_transfer(
                    pair.content, pair.style, clip, pair.truth, folds.recognisers(pair), fps=PEER_FPS
                )
                found.append({"pair": pair.name, "method": name, **record})
    return found


def frechet(folds: Folds, pairs: Sequence[Pair], results: Mapping[str, MotionClip]) -> float | None:
    """Returns the Fréchet distance of results from ground truths, for pairs whose style clip is of another content."""
    both = [pair for pair in pairs if pair.kind == OTHER_CONTENT and pair.name in results]
    real = [pair.truth for pair in both if pair.truth is not None]
    return clips_frechet(folds.of_all(), [results[pair.name] for pair in both], real) if real else None


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
