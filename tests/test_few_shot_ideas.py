"""The experiments on few-shot learning that turns: folds, tables, and the laws of what they vary."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.common.few_shot_recipes import Learning, clip_rows, learn_rows, learning_data, minimise, style_loss
from experiments.common.turning_folds import (
    FULL,
    WITHOUT,
    Fold,
    FoldConfig,
    NetworkKind,
    TurningFolds,
    load_results,
    no_style,
    style_of,
)
from experiments.common.turning_judged import WAYS, JudgedWalks
from experiments.common.turning_table import FULL_DATA, PAPER, closed, distance_table, load_judged, save_judged
from experiments.common.varied_restyling import restyle_turns, straight_and_turning
from experiments.few_shot.style_space import mixture_loss
from experiments.few_shot.unrolled import feedback, pose_columns, sequence_starts
from pfnn_jax.control.stability import predictor_of
from pfnn_jax.evaluation.turning_judge import MEASURES, STYLE_MEASURES
from pfnn_jax.inference.rows import evaluate_rows
from pfnn_jax.training.data import to_batch

pytestmark = pytest.mark.slow

STYLES = ("elderly", "normal", "youthful")
SAME = 1e-4  # float32 rows through a normaliser and back
LEARNING = Learning(steps=3, batch_size=8)


@pytest.fixture(scope="module")
def fold(mocap, tmp_path_factory) -> Fold:
    folder = tmp_path_factory.mktemp("takes")
    for style in STYLES:
        for content, count in (("walk", 2), ("walk-turn-left", 3)):
            for file in sorted((mocap / "bandai-namco-2").glob(f"dataset-2_{content}_{style}_*.bvh"))[:count]:
                (folder / file.name).symlink_to(file)
    config = FoldConfig(folder, tmp_path_factory.mktemp("out"), ("elderly",), hidden=8, steps=2, batch_size=16)
    return next(TurningFolds(config).folds())


def names(takes) -> set[str]:
    return {take.name for take in takes}


def test_no_method_and_no_network_sees_a_test_take(fold):
    tested = names(fold.test_takes)
    assert tested and tested.isdisjoint(names(fold.other_turns)) and tested.isdisjoint(names(fold.walks))
    for kind in (WITHOUT, FULL):
        assert all(tested.isdisjoint(names(takes)) for takes in fold.known_takes(kind).values())


def test_network_without_the_held_out_style_knows_all_others(fold):
    assert fold.known_styles(WITHOUT) == ("normal", "youthful")
    assert fold.known_styles(FULL) == STYLES
    assert fold.known_styles(NetworkKind(num_known=1)) == ("normal",)


def test_another_seed_has_another_clip(fold):
    assert fold.walks[0].name != replace(fold, seed=1).walks[0].name


def test_network_is_kept_to_the_last_bit(fold):
    first, again = fold.network(), fold.network()
    leaves = zip(jax.tree.leaves((first.shared, first.bank)), jax.tree.leaves((again.shared, again.bank)), strict=True)
    assert all(np.array_equal(*pair) for pair in leaves) and first.loss == again.loss


def test_no_style_is_the_network_alone(fold):
    network, rows = fold.network(), fold.clip[0]
    zero, alone = (
        evaluate_rows(predictor_of(style, network.shared, network.normaliser), rows.x[:5], rows.phase[:5])
        for style in (no_style(network), None)
    )
    np.testing.assert_allclose(zero, alone, atol=SAME)


def test_turns_restyled_by_their_own_straight_walk_stay_as_they_are(fold):
    network, parts = fold.network(), straight_and_turning(fold.known_takes())
    straight, turning = parts["normal"]
    clip = to_batch([straight], network.normaliser)
    options = {"clip": clip, "by_joint": False}
    same = restyle_turns(fold, network, parts, {"normal": turning}, **options)
    expected = to_batch([turning], network.normaliser)
    for name in ("x", "y", "phase"):
        np.testing.assert_allclose(getattr(same, name), getattr(expected, name), atol=SAME)


def test_mixture_of_one_style_is_that_style(fold):
    network = fold.network()
    data = learning_data(fold, network, clip_rows(fold, network), network.bank)
    key, weights = jax.random.key(0), jnp.array([0.0, 1.0])
    learning = replace(LEARNING, main_dropout=0.0)
    mixed = mixture_loss(weights, data, learning, key)
    np.testing.assert_allclose(mixed, style_loss(style_of(network, 1), data, learning, key), rtol=SAME)


def test_learning_lowers_the_error_on_its_rows(fold):
    network, learning = fold.network(), Learning(steps=60, batch_size=32, main_dropout=0.0)
    rows = clip_rows(fold, network)
    start, learned = no_style(network), learn_rows(fold, network, rows, learning)
    data, whole = learning_data(fold, network, rows), replace(learning, batch_size=2000)
    before, after = (style_loss(style, data, whole, jax.random.key(1)) for style in (start, learned))
    assert after < before


def squared(params: jax.Array, data, learning: Learning, key: jax.Array) -> jax.Array:
    return jnp.sum((params - 1.0) ** 2)


def test_average_over_the_last_step_is_the_last_step():
    last, averaged = (
        minimise(squared, np.zeros(3, np.float32), None, replace(LEARNING, average=share), jax.random.key(0))
        for share in (0.0, 1 / LEARNING.steps)
    )
    np.testing.assert_array_equal(last, averaged)


def test_average_lies_between_the_first_and_the_last_step():
    last, averaged = (
        minimise(squared, np.zeros(3, np.float32), None, replace(LEARNING, average=share), jax.random.key(0))
        for share in (0.0, 1.0)
    )
    assert (averaged > 0).all() and (averaged < last).all()


def test_sequences_do_not_cross_the_ends_of_takes():
    frames = np.concatenate([np.arange(5, 9), np.arange(20, 23), np.arange(23, 24) + 7])
    assert sequence_starts(frames, 3).tolist() == [0, 1, 4]
    assert sequence_starts(frames, 1).tolist() == list(range(8))


def test_predicted_pose_is_read_as_the_same_pose(fold):
    network = fold.network()
    x_columns, y_columns = pose_columns(fold.layout)
    factor, offset = feedback(fold.layout, network.normaliser)
    y = np.random.default_rng(0).normal(size=fold.layout.output_size)
    x = y[y_columns] * factor + offset
    inputs, outputs = network.normaliser.inputs, network.normaliser.outputs
    expected = y[y_columns] * outputs.std[y_columns] + outputs.mean[y_columns]
    np.testing.assert_allclose(x * inputs.std[x_columns] + inputs.mean[x_columns], expected, rtol=SAME)


def judged(distance: float) -> dict[str, JudgedWalks]:
    takes = [{**dict.fromkeys(MEASURES, 1.0), "distance": distance + take, "turning": np.nan} for take in range(4)]
    return {way: JudgedWalks(takes, dict.fromkeys(STYLE_MEASURES, 0.5)) for way in WAYS}


@pytest.fixture
def config(tmp_path) -> FoldConfig:
    """A folder of results in which a method lies halfway between the paper's recipe and the full-data network."""
    found = FoldConfig(tmp_path, tmp_path, ("elderly", "normal"))
    for style in found.styles:
        for method, distance in ((PAPER, 4.0), ("halfway", 3.0), (FULL_DATA, 2.0)):
            save_judged(tmp_path / "judged" / f"{style}_0" / f"{method}.json", judged(distance), seconds=1.0)
    return found


def test_share_closed_is_0_for_the_papers_recipe_and_1_for_the_full_data(config):
    results = load_results(config, (PAPER, "halfway", FULL_DATA))
    for way in WAYS:
        shares = [closed(results, method, way) for method in (PAPER, "halfway", FULL_DATA)]
        assert [share.share for share in shares if share] == pytest.approx([0.0, 0.5, 1.0])


def test_measures_on_disk_are_the_same_measures(config, tmp_path):
    walks = load_judged(tmp_path / "judged" / "normal_0" / "halfway.json")["loop"]
    np.testing.assert_equal(walks.takes, judged(3.0)["loop"].takes)
    assert walks.style == judged(3.0)["loop"].style


def test_table_shows_the_methods_that_were_judged(config):
    table = distance_table(load_results(config, (PAPER, "never judged", FULL_DATA)))
    assert table.count("\n") == 2 + 2 and "| 5.50 / 5.50 |" in table
