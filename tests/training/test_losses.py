"""The loss: values by hand, gradients against finite differences."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.motion.features.layout import mason2018, mason2022, pfnn2017
from pfnn_jax.motion.features.normaliser import Statistics
from pfnn_jax.training.losses import l1_penalty, make_bones, squared_error

FLOAT32 = 1e-6  # a few ulp over sums of six terms near one
LENGTHS = 1e-5  # single precision: differences of lengths, a tenth of the lengths themselves
PARENTS = np.array([-1, 0, 1, 1, 0])


def test_squared_error_is_the_mean_over_all_axes():
    prediction = jnp.array([[1.0, 2.0], [0.0, -1.0]])
    target = jnp.array([[0.0, 4.0], [0.0, 1.0]])
    assert squared_error(prediction, target) == (1 + 4 + 0 + 4) / 4


def test_squared_error_is_symmetric_and_zero_where_equal():
    first, second = jax.random.normal(jax.random.key(0), (2, 3, 4))
    assert squared_error(first, second) == squared_error(second, first) > 0
    assert squared_error(first, first) == 0


def test_squared_error_refuses_broadcasting():
    with pytest.raises(AssertionError):
        squared_error(jnp.zeros((3, 1)), jnp.zeros((3, 4)))


def test_l1_penalty_averages_within_arrays_and_then_over_arrays():
    tree = {"wide": jnp.array([1.0, -3.0, 2.0, -2.0]), "narrow": jnp.array([[-6.0]])}
    assert l1_penalty(tree) == (8 / 4 + 6) / 2


def test_l1_penalty_sums_where_asked():
    tree = {"wide": jnp.array([1.0, -3.0, 2.0, -2.0]), "narrow": jnp.array([[-6.0]])}
    assert l1_penalty(tree, "sum") == 14


@pytest.mark.parametrize("norm", ["mean", "sum"])
def test_l1_penalty_is_homogeneous(norm):
    tree = [jax.random.normal(jax.random.key(0), (2, 3)), jax.random.normal(jax.random.key(1), (5,))]
    scaled = jax.tree.map(lambda leaf: -3.0 * leaf, tree)
    np.testing.assert_allclose(l1_penalty(scaled, norm), 3.0 * l1_penalty(tree, norm), rtol=FLOAT32)


@pytest.mark.parametrize("norm", ["mean", "sum"])
def test_l1_penalty_does_not_push_a_zero(norm):
    gradient = jax.grad(lambda leaf: l1_penalty([leaf], norm))(jnp.zeros(3))
    assert jnp.all(gradient == 0)


def test_gradient_of_squared_error():
    with jax.enable_x64(True):
        prediction, target = jax.random.normal(jax.random.key(0), (2, 3, 4))
        check_grads(squared_error, (prediction, target), order=2, modes=("fwd", "rev"))


@pytest.mark.parametrize("norm", ["mean", "sum"])
def test_gradient_of_l1_penalty_away_from_zero(norm):
    with jax.enable_x64(True):
        signs = jnp.array([1.0, -1.0, -1.0, 1.0])
        tree = (signs * jnp.linspace(0.5, 2.0, 4), -jnp.ones((2, 2)))
        check_grads(lambda *leaves: l1_penalty(leaves, norm), tree, order=2, modes=("fwd", "rev"))


def bone_setup(make, seed=0):
    layout, rng = make(len(PARENTS)), np.random.default_rng(seed)
    prediction, target = rng.normal(size=(2, 6, layout.output_size))
    mean, std = rng.normal(size=layout.output_size), rng.uniform(0.5, 2, layout.output_size)
    return layout, prediction, target, std, mean


def bones_of(layout, std, mean):
    return make_bones(layout, PARENTS, Statistics(mean, std))


def bone_reference(layout, prediction, target, std, mean) -> float:
    """Frame by frame and bone by bone, in double precision."""
    columns, total = layout.output_slice("joint_position"), 0.0
    for pair in zip(prediction, target, strict=True):
        positions = [(y * std + mean)[columns].reshape(-1, 3) * layout.length_unit for y in pair]
        for child, parent in enumerate(PARENTS):
            if parent >= 0:
                first, second = (np.linalg.norm(p[child] - p[parent]) for p in positions)
                total += abs(first - second)
    return float(total) / len(prediction) / len(PARENTS)


@pytest.mark.parametrize("make", [mason2018, mason2022, pfnn2017])
def test_bone_length_loss_is_the_plain_sum_over_frames_and_bones(make):
    layout, prediction, target, std, mean = bone_setup(make)
    reference = bone_reference(layout, prediction, target, std, mean)
    with jax.enable_x64(True):
        found = bones_of(layout, std, mean).length_error(jnp.asarray(prediction), target)
        np.testing.assert_allclose(found, reference, rtol=1e-13)  # the same sum in another order
    single = [np.asarray(values, np.float32) for values in (prediction, target)]
    found = bones_of(layout, std, mean).length_error(jnp.asarray(single[0]), single[1])
    np.testing.assert_allclose(found, reference, rtol=LENGTHS)


def test_columns_serve_both_precisions_one_after_the_other():
    """Compiled in single and evaluated in double precision: interleaved columns are arrays that JAX keeps."""
    layout, prediction, target, std, mean = bone_setup(mason2022)
    loss = bones_of(layout, std, mean).length_error
    single = jax.jit(loss)(jnp.asarray(prediction, jnp.float32), target.astype(np.float32))
    with jax.enable_x64(True):
        np.testing.assert_allclose(single, loss(jnp.asarray(prediction), target), rtol=LENGTHS)


def test_bone_length_loss_is_zero_under_rigid_motion():
    layout, prediction, _, std, mean = bone_setup(mason2022)
    columns = layout.output_slice("joint_position")
    turned = prediction * std + mean
    points = turned[:, columns].reshape(6, -1, 3)
    turned[:, columns] = (points[..., [2, 1, 0]] * [1, 1, -1] + [3.0, -1.0, 2.0]).reshape(6, -1)
    with jax.enable_x64(True):
        moved = jnp.asarray((turned - mean) / std)
        assert bones_of(layout, std, mean).length_error(moved, prediction) < 1e-14  # rounding of doubles


def test_gradient_of_bone_length_loss():
    with jax.enable_x64(True):
        layout, prediction, target, std, mean = bone_setup(mason2022)
        check_grads(
            jax.jit(lambda prediction: bones_of(layout, std, mean).length_error(prediction, target)),
            (jnp.asarray(prediction),),
            order=1,
            modes=("fwd", "rev"),
        )


def test_the_gradient_is_finite_where_a_bone_has_no_length_or_the_right_one():
    layout, prediction, target, std, _ = bone_setup(mason2022)
    mean = np.zeros_like(std)
    gradient = jax.grad(lambda y: bones_of(layout, std, mean).length_error(y, jnp.asarray(target)))
    assert jnp.isfinite(gradient(jnp.zeros_like(jnp.asarray(prediction)))).all()
    assert jnp.all(gradient(jnp.asarray(target)) == 0)
