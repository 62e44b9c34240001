"""The optimisation of 2016: what it lowers, what it leaves alone, and clips of many lengths."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.motion.features.normaliser import Statistics
from pfnn_jax.motion.skeleton import skeleton_to_json
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.transfer.autoencoder import init_autoencoder
from pfnn_jax.transfer.autoencoder_training import fit_statistics
from pfnn_jax.transfer.clip_rows import encode_clip
from pfnn_jax.transfer.config import AutoencoderConfig, LossWeights, OptimisationConfig
from pfnn_jax.transfer.layout import HOLDEN2017
from pfnn_jax.transfer.losses import style_loss
from pfnn_jax.transfer.optimisation import (
    MARGIN,
    add_change,
    descend,
    loss_mask,
    make_task,
    optimise,
    padded_length,
    speed_ratio,
    step_length,
    style_gram,
)
from pfnn_jax.transfer.run import TransferRun, TransferRunConfig

ROUNDING = 2e-4  # metres and radians: single precision, through some steps of Adam, which divides by small numbers
PADDING = 2e-3  # likewise; sums over padded clips round in another order
SIZES = AutoencoderConfig(filters=16, width=25)
SHORT = OptimisationConfig(weights=LossWeights(style=0.1), iterations=20, constraint_iterations=10)
KEY = jax.random.key(0)


def walk(style: str = "neutral", frames: int = 90, turn: float = 0.0, speed: float = 1.2) -> np.ndarray:
    clip, _ = synthesise(style, np.full(frames, np.deg2rad(turn)), np.full(frames, speed), fps=60, seed=0)
    return encode_clip(clip, HOLDEN2017)


def make_run() -> TransferRun:
    """Returns a run that is on no disk, with random filters: every law here holds for any autoencoder."""
    autoencoder, skeleton = init_autoencoder(SIZES, HOLDEN2017.size, key=KEY), synthetic_skeleton()
    statistics: Statistics = fit_statistics(walk(), HOLDEN2017)
    config = TransferRunConfig(HOLDEN2017.name, SIZES, skeleton_to_json(skeleton))
    return TransferRun(Path("none"), config, HOLDEN2017, skeleton, statistics, autoencoder, "none")


RUN, CONTENT, STYLE = make_run(), walk(turn=30.0), walk("zombie")


def test_descending_lowers_a_loss():
    value, losses = descend(lambda v: jnp.sum(jnp.square(v - 1.0)), jnp.zeros(3), jnp.float32(0.1), 100)
    assert jnp.all(jnp.diff(losses[:10]) < 0)
    np.testing.assert_allclose(value, 1.0, atol=0.05)


def test_the_optimisation_moves_the_gram_matrix_to_the_styles():
    found = optimise(RUN, CONTENT, [STYLE], replace(SHORT, constraint_iterations=0, keep_detail=False), key=KEY)
    target = style_gram(RUN, [STYLE])
    assert found.shape == CONTENT.shape and np.isfinite(found).all()
    assert gram_error(found, target) < gram_error(CONTENT, target)


def gram_error(rows: np.ndarray, target: jax.Array) -> float:
    return float(jnp.mean(jnp.square(style_gram(RUN, [rows]) - target)))


def test_without_style_and_constraints_the_content_comes_back():
    still = replace(SHORT, weights=LossWeights(style=0.0), constraint_iterations=0)
    np.testing.assert_allclose(optimise(RUN, CONTENT, [STYLE], still, key=KEY), CONTENT, atol=ROUNDING)


def test_without_style_and_detail_the_content_comes_back_as_the_autoencoder_sees_it():
    plain = replace(SHORT, weights=LossWeights(style=0.0), constraint_iterations=0, keep_detail=False)
    task = make_task(RUN, CONTENT, [STYLE])
    seen = RUN.statistics.invert(np.asarray(RUN.autoencoder.decode(task.content)))[MARGIN : MARGIN + len(CONTENT)]
    np.testing.assert_allclose(optimise(RUN, CONTENT, [STYLE], plain, key=KEY), seen, atol=ROUNDING)


@pytest.mark.parametrize("start", ["content", "noise"])
def test_equal_keys_give_equal_results(start):
    config = replace(SHORT, start=start)
    first, second, other = (optimise(RUN, CONTENT, [STYLE], config, key=jax.random.key(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, second)
    assert np.array_equal(first, other) == (start == "content")


def test_padding_does_not_change_the_result(monkeypatch):
    expected = optimise(RUN, CONTENT, [STYLE], SHORT, key=KEY)
    length = padded_length(len(CONTENT))
    monkeypatch.setattr("pfnn_jax.transfer.optimisation.padded_length", lambda frames: length + 64)
    np.testing.assert_allclose(optimise(RUN, CONTENT, [STYLE], SHORT, key=KEY), expected, atol=PADDING)


def test_constraints_bring_the_bones_back():
    plain = replace(SHORT, keep_detail=False, iterations=0)
    with_bones = replace(plain, constraint_iterations=40, weights=LossWeights(foot=0, bone=1, trajectory=0))
    before, after = (
        optimise(RUN, CONTENT, [STYLE], c, key=KEY) for c in (replace(plain, constraint_iterations=0), with_bones)
    )
    assert bone_error(after) < 0.9 * bone_error(before)


def bone_error(rows: np.ndarray) -> float:
    thigh, shin = (rows[:, 3 * k : 3 * k + 3] for k in (1, 2))
    own = np.linalg.norm(CONTENT[:, 3:6] - CONTENT[:, 6:9], axis=1)
    return float(np.abs(np.linalg.norm(thigh - shin, axis=1) - own).mean())


@pytest.mark.parametrize("frames", [1, 25, 90, 240, 1000, 72000])
def test_clips_are_padded_to_few_even_lengths(frames):
    length = padded_length(frames)
    assert length % 2 == 0 and frames + 2 * MARGIN <= length < 2 * (frames + 2 * MARGIN)
    lengths = {padded_length(count) for count in range(240, 480)}
    assert len(lengths) <= 2


def test_losses_see_the_hidden_units_that_the_clip_is_decoded_from():
    mask = np.zeros(80, np.float32)
    mask[30:50] = 1
    assert list(np.flatnonzero(loss_mask(mask))) == list(range(15 - MARGIN // 4, 25 + MARGIN // 4))


def test_speed_is_scaled_by_the_ratio_of_step_lengths_within_bounds():
    slow, fast = walk(frames=240, speed=0.8), walk(frames=240, speed=1.6)
    lengths = [step_length(rows, HOLDEN2017) for rows in (slow, fast)]
    assert lengths[0] is not None and lengths[1] is not None and 0.2 < lengths[0] < lengths[1] < 1.2
    np.testing.assert_allclose(speed_ratio(fast, [slow], HOLDEN2017), lengths[0] / lengths[1], rtol=1e-6)
    assert speed_ratio(slow, [scaled(fast, 9)], HOLDEN2017) == 2.0


def test_a_step_is_as_long_at_any_frame_rate_of_steps():
    rows = walk(frames=240)
    quick = scaled(rows[::2], 2)  # twice the steps a second at twice the speed
    assert step_length(quick, HOLDEN2017) == pytest.approx(step_length(rows, HOLDEN2017), rel=0.05)


def test_clips_without_steps_keep_their_speed():
    standing, moving = scaled(walk(frames=240), 0), walk(frames=240)
    assert step_length(standing, HOLDEN2017) is step_length(walk()[:10], HOLDEN2017) is None
    assert speed_ratio(moving, [standing], HOLDEN2017) == speed_ratio(standing, [moving], HOLDEN2017) == 1.0


def scaled(rows: np.ndarray, factor: float) -> np.ndarray:
    rows = rows.copy()
    rows[:, HOLDEN2017.root_velocity] *= factor
    return rows


def test_several_style_clips_count_by_their_frames():
    first, second = walk("zombie", 60), walk("neutral", 120)
    expected = (style_gram(RUN, [first]) + 2 * style_gram(RUN, [second])) / 3
    np.testing.assert_allclose(style_gram(RUN, [first, second]), expected, rtol=1e-5)


def test_only_a_smooth_change_is_added():
    x, change = jnp.zeros((40, 2)), jnp.ones((40, 2))
    np.testing.assert_allclose(add_change(x, x, change), change, atol=1e-6)
    flicker = jnp.where(jnp.arange(40)[:, None] % 2 == 0, 1.0, -1.0) * change
    np.testing.assert_allclose(add_change(x, x, flicker)[8:-8], 0.0, atol=1e-6)


def test_the_style_clip_as_its_own_content_has_no_style_loss():
    task = make_task(RUN, STYLE, [STYLE])
    assert style_loss(task.content, task.target, loss_mask(task.mask)) < 1e-6
