"""The losses of style transfer: what they see, what they do not see, and their gradients."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.motion.body_points import POINT_NAMES
from pfnn_jax.motion.ground import facing_of, to_local
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.transfer.clip_rows import FEET, encode_clip
from pfnn_jax.transfer.layout import CLIP_LAYOUTS, HOLDEN2017, LAYOUT_FPS, ClipLayout
from pfnn_jax.transfer.losses import (
    Constraints,
    bone_loss,
    content_constraints,
    content_loss,
    foot_loss,
    gram,
    style_loss,
    trajectory_loss,
)

ROUNDING = 1e-5  # relative, of sums of some hundred terms in single precision
STILL = 1e-6  # (m/s)²: differences of metres in single precision, times 60 frames per second
WALKING = 0.15  # (m/s)²: contacts reach to 0.76 m/s, feet that follow the root would have twenty times as much
FRAMES, FILTERS = 12, 5
EACH_LAYOUT = pytest.mark.parametrize("layout", CLIP_LAYOUTS.values(), ids=list(CLIP_LAYOUTS))


def hidden_units(seed: int = 0, frames: int = FRAMES) -> jax.Array:
    return jnp.abs(jax.random.normal(jax.random.key(seed), (frames, FILTERS)))


def walk_rows(layout: ClipLayout = HOLDEN2017, turn: float = 20.0, frames: int = 120) -> np.ndarray:
    clip, _ = synthesise("neutral", np.full(frames, np.deg2rad(turn)), np.full(frames, 1.2), fps=60, seed=0)
    return encode_clip(clip, layout)


def planted_rows(layout: ClipLayout, frames: int = 40) -> tuple[np.ndarray, Constraints]:
    """Returns rows of points that stand still in the world while the root wanders and turns, and full contact."""
    rng = np.random.default_rng(0)
    yaw, path = np.cumsum(rng.normal(0, 0.1, frames)), np.cumsum(rng.normal(0, 0.05, (frames, 2)), axis=0)
    facing, place = facing_of(yaw), rng.normal(size=(len(POINT_NAMES), 3))
    apart = np.repeat(place[None], frames, axis=0)
    apart[..., [0, 2]] -= path[:, None]
    rows = np.zeros((frames, layout.size))
    rows[:, layout.joint_position][:, -3 * len(POINT_NAMES) :] = to_local(apart, facing).reshape(frames, -1)
    rows[:-1, layout.root_velocity] = to_local(np.diff(path, axis=0), facing[1:])
    rows[:, : layout.root_velocity.stop] /= layout.length_unit
    rows[:-1, layout.root_yaw_rate] = -np.diff(yaw)[:, None]
    return rows, Constraints(np.ones((frames, 4)), np.ones(20), np.zeros((frames, 2)), np.zeros(frames))


def test_the_gram_matrix_is_symmetric_and_positive_semidefinite():
    found = np.asarray(gram(hidden_units()))
    np.testing.assert_allclose(found, found.T, rtol=ROUNDING)
    assert np.linalg.eigvalsh(found).min() > -ROUNDING * np.abs(found).max()


def test_the_gram_matrix_does_not_see_the_order_or_the_number_of_frames():
    hidden = hidden_units()
    order = np.random.default_rng(0).permutation(FRAMES)
    np.testing.assert_allclose(gram(hidden[order]), gram(hidden), rtol=ROUNDING)
    np.testing.assert_allclose(gram(jnp.concatenate([hidden, hidden])), gram(hidden), rtol=ROUNDING)


def test_the_gram_matrix_of_a_window_is_the_papers_sum():
    hidden = hidden_units(frames=120)
    np.testing.assert_allclose(gram(hidden), jnp.einsum("tf,tg->fg", hidden, hidden), rtol=ROUNDING)


@pytest.mark.parametrize("loss", ["content", "style"])
def test_masked_frames_do_not_count(loss):
    hidden, other = hidden_units(), hidden_units(1)
    padded = jnp.concatenate([hidden, 100 * other])
    mask = jnp.repeat(jnp.array([1.0, 0.0]), FRAMES)
    if loss == "content":
        found, expected = (
            content_loss(padded, jnp.zeros_like(padded), mask),
            content_loss(hidden, jnp.zeros_like(hidden)),
        )
    else:
        found, expected = (style_loss(units, gram(other), m) for units, m in ((padded, mask), (hidden, None)))
    np.testing.assert_allclose(found, expected, rtol=ROUNDING)


def test_the_style_loss_of_the_style_itself_is_zero_in_any_order():
    hidden = hidden_units()
    assert style_loss(hidden, gram(hidden)) == 0
    assert style_loss(hidden[::-1], gram(hidden)) < ROUNDING
    assert style_loss(hidden_units(1), gram(hidden)) > ROUNDING


@EACH_LAYOUT
def test_a_foot_that_stands_still_has_no_foot_loss_however_the_root_moves(layout):
    rows, constraints = planted_rows(layout)
    assert foot_loss(rows, constraints, layout) < STILL
    slid = rows.copy()
    slid[:, layout.root_velocity.start] += 0.01 / layout.length_unit  # all points move by 1 cm a frame: 0.6 m/s
    np.testing.assert_allclose(foot_loss(slid[:-1], tail(constraints), layout), 4 * 0.6**2, rtol=1e-3)


def tail(constraints: Constraints) -> Constraints:
    return Constraints(
        constraints.contacts[1:], constraints.bone_lengths, constraints.velocity[1:], constraints.yaw_rate[1:]
    )


@EACH_LAYOUT
def test_a_walk_keeps_its_own_constraints(layout):
    rows = walk_rows(layout)
    constraints = content_constraints(rows, layout)
    assert constraints.contacts.mean() > 0.3
    assert foot_loss(rows, constraints, layout) < WALKING
    assert bone_loss(rows, constraints, layout) < 1e-2  # cm²: the head's end turns with the head, no bone does
    assert trajectory_loss(rows, constraints, layout) < STILL


def test_feet_in_the_air_do_not_count():
    rows, constraints = planted_rows(HOLDEN2017)
    rows[:, HOLDEN2017.root_velocity] += 0.01
    lifted = Constraints(np.zeros_like(constraints.contacts), *list(vars(constraints).values())[1:])
    assert foot_loss(rows, lifted, HOLDEN2017) == 0


@EACH_LAYOUT
def test_the_bone_loss_is_the_squared_error_in_centimetres(layout):
    rows = walk_rows(layout)
    constraints = content_constraints(rows, layout)
    longer = constraints.replace(bone_lengths=constraints.bone_lengths + 0.03)  # type: ignore[attr-defined]
    np.testing.assert_allclose(bone_loss(rows, longer, layout), 9.0, rtol=0.05)


@EACH_LAYOUT
def test_the_trajectory_loss_is_in_metres_and_radians_per_second(layout):
    rows = walk_rows(layout)
    constraints = content_constraints(rows, layout)
    faster, turned = rows.copy(), rows.copy()
    faster[:, layout.root_velocity.start] += 0.5 / LAYOUT_FPS / layout.length_unit
    turned[:, layout.root_yaw_rate] += 0.3 / LAYOUT_FPS
    np.testing.assert_allclose(trajectory_loss(faster, constraints, layout), 0.25, rtol=1e-3)
    np.testing.assert_allclose(trajectory_loss(turned, constraints, layout), 0.09, rtol=1e-3)


def test_the_speed_ratio_scales_the_velocity_alone():
    rows = walk_rows()
    own, scaled = (content_constraints(rows, HOLDEN2017, ratio) for ratio in (1.0, 0.5))
    np.testing.assert_allclose(scaled.velocity, own.velocity / 2, rtol=ROUNDING)
    np.testing.assert_array_equal(scaled.yaw_rate, own.yaw_rate)
    np.testing.assert_array_equal(scaled.contacts, own.contacts)


@pytest.mark.parametrize("loss", [foot_loss, bone_loss, trajectory_loss])
def test_gradients_of_constraints(loss):
    with jax.enable_x64(True):
        rows = walk_rows(frames=8) + np.random.default_rng(0).normal(0, 0.01, (8, HOLDEN2017.size))
        constraints = content_constraints(walk_rows(frames=8), HOLDEN2017)
        mask = np.array([0.0, 1, 1, 1, 1, 1, 1, 0])
        check_grads(lambda x: loss(x, constraints, HOLDEN2017, mask), (jnp.asarray(rows),), order=1, modes=("rev",))


def test_gradients_of_content_and_style():
    with jax.enable_x64(True):
        hidden, other = (np.asarray(hidden_units(seed), np.float64) for seed in (0, 1))
        check_grads(
            lambda h: content_loss(h, other) + 1e-3 * style_loss(h, gram(other)), (hidden,), order=1, modes=("rev",)
        )


def test_a_bone_of_no_length_has_a_finite_gradient():
    rows = jnp.zeros((3, HOLDEN2017.size))
    constraints = Constraints(np.zeros((3, 4)), np.ones(20), np.zeros((3, 2)), np.zeros(3))
    assert jnp.isfinite(jax.grad(bone_loss)(rows, constraints, HOLDEN2017)).all()


def test_contacts_are_of_heels_and_toes():
    assert [POINT_NAMES[foot] for foot in FEET] == ["left_foot", "left_toe", "right_foot", "right_toe"]
