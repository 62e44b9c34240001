"""The experiment transfer_judged: what its classifiers and networks have seen, and a small run of it."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import pytest

from experiments import transfer_judged
from experiments.common import transfer_methods
from experiments.common.transfer_judged_report import relative
from experiments.common.transfer_methods import FINISHES, Methods, without_constraints
from experiments.common.transfer_pairs import (
    OTHER_CONTENT,
    PEER_FPS,
    SAME_CONTENT,
    SAME_STYLE,
    Folds,
    load_peers,
    load_xia,
    xia_pairs,
)
from pfnn_jax.evaluation.style_classifier import ClassifierConfig
from pfnn_jax.evaluation.transfer_judge import MEASURES, Spread
from pfnn_jax.motion.retargeting.retarget import same_bones
from pfnn_jax.transfer.config import LossWeights, OptimisationConfig
from tests.raising import assert_refused
from tests.transfer.test_run import make_run


@pytest.fixture(scope="module")
def clips(mocap):
    return load_xia(mocap / "xia-test")


def test_pairs_of_each_kind_have_the_ground_truth_of_their_kind(clips):
    pairs = xia_pairs(clips)
    assert len(clips) == 29 and len({pair.name for pair in pairs}) == len(pairs)
    for pair in pairs:
        labels = pair.content.style == pair.style.style, pair.content.content == pair.style.content
        assert {(False, False): OTHER_CONTENT, (False, True): SAME_CONTENT, (True, False): SAME_STYLE}[
            labels
        ] == pair.kind
        if pair.truth is None:
            assert (pair.style.style, pair.content.content) == ("old", "run")  # the clip that the split lacks
        else:
            assert (pair.truth.style, pair.truth.content) == (pair.style.style, pair.content.content)
            assert (pair.truth is pair.style) == (pair.kind == SAME_CONTENT)
            assert (pair.truth is pair.content) == (pair.kind == SAME_STYLE)
    some = xia_pairs(clips, 3)
    assert [sum(pair.kind == kind for pair in some) for kind in (OTHER_CONTENT, SAME_CONTENT, SAME_STYLE)] == [3] * 3


def test_classifiers_have_seen_neither_the_content_clip_nor_the_ground_truth(clips, monkeypatch):
    seen = {}
    monkeypatch.setattr(Folds, "_train", lambda self, own, label: seen.setdefault(label, own))
    for pair in xia_pairs(clips, 5):
        seen.clear()
        Folds(tuple(clips)).recognisers(pair)
        for own in seen.values():
            assert pair.content not in own and pair.truth not in own and len(own) >= 19
        assert {clip.style for clip in seen["style"]} == {clip.style for clip in clips}
        assert {clip.content for clip in seen["content"]} == {clip.content for clip in clips}


def test_fast_networks_have_seen_no_clip_of_the_tested_content(clips, tmp_path, monkeypatch):
    seen = []

    def remember(run, contents, styles, pairing, config):
        seen.extend([contents, styles])
        return None, {}

    monkeypatch.setattr(transfer_methods, "train_transformation", remember)
    monkeypatch.setattr(transfer_methods, "apply_network", lambda run, network, rows, **options: rows)
    pair = xia_pairs(clips, 1)[0]
    Methods(make_run(tmp_path / "run"), clips).result("fast", pair)
    contents, styles = seen
    assert pair.content.content not in {clip.content for clip in (*contents, *styles)}
    assert len(contents) + len(styles) == sum(clip.content != pair.content.content for clip in clips)
    assert {name for name in FINISHES if not name.startswith(("optimisation", "fast"))} == set()


def test_ablation_leaves_out_the_constraints_alone():
    weights = LossWeights()
    left = without_constraints(weights)
    assert replace(left, foot=weights.foot, bone=weights.bone, trajectory=weights.trajectory) == weights
    assert left.foot == left.bone == left.trajectory == 0.0


def test_released_outputs_are_on_one_skeleton_at_one_rate(clips, reference):
    peers = load_peers(reference / "transfer", clips)
    assert [len(peer.results) for peer in peers] == [2, 2, 2]
    for peer in peers:
        for clip in (peer.pair.content, peer.pair.style, *peer.results.values()):
            assert clip.fps == PEER_FPS and same_bones(clip.skeleton, clips[0].skeleton)
        for clip in peer.results.values():  # outputs end up to three frames early, as networks pool frames
            assert 0 <= peer.pair.content.num_frames - clip.num_frames <= 3


@pytest.mark.slow
def test_transfer_judged(mocap, reference, tmp_path):
    make_run(tmp_path / "run")
    config = transfer_judged.Config(
        tmp_path / "out",
        mocap,
        reference / "transfer",
        tmp_path / "run",
        methods=("content", "ground truth", "optimisation", "optimisation, no IK"),
        limit=1,
        networks=1,
        classifier=ClassifierConfig(filters=2, features=2, epochs=1),
        optimisation=OptimisationConfig(iterations=1, constraint_iterations=1),
    )
    result = transfer_judged.main(config)
    assert set(MEASURES) < set(result["records"]["optimisation"][0])
    assert {one["method"] for one in result["peers"]} > {"Aberman 2020, raw", "Park 2021, latent", "optimisation"}
    assert json.loads((config.out / "report.json").read_text())["records"]["content"][0]["CC, cm"] == 0.0
    table = (config.out / "table.md").read_text()
    assert all(f"Pairs: {kind}." in table for kind in (OTHER_CONTENT, SAME_CONTENT, SAME_STYLE))
    assert (config.out / "report.html").stat().st_size > 10_000
    clips = sorted((config.out / "clips" / "optimisation").glob("*.bvh"))
    assert len(clips) == 3 + 3  # one pair of each kind, and the pairs of released outputs


def test_recognition_is_relative_to_the_ground_truths_of_the_same_pairs():
    own, real = ({"style recognised": Spread(mean, 0.0, 1.0, 0.5, 4)} for mean in (0.3, 0.4))
    found = relative({"ground truth": real, "optimisation": own})
    assert found["ground truth"] == {"style recognised": 1.0}
    assert found["optimisation"]["style recognised"] == pytest.approx(0.75)
    assert relative({"optimisation": own}) == {}


def test_unknown_method_is_refused(tmp_path):
    make = partial(transfer_judged.Config, tmp_path, methods=("magic",))
    assert_refused(make, place="methods", value="magic", rule_mentions="optimisation")
