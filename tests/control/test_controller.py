"""The controller on small networks: the published loop inside it, styles, standing, and how it is run."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control.controller import Controller, make_controller, rollout_commands, step
from pfnn_jax.control.controller_state import style_speed
from pfnn_jax.control.ground import orthonormal
from pfnn_jax.control.loop.state import ROOT
from pfnn_jax.control.loop.step import Command, published_step
from pfnn_jax.errors import InputError
from pfnn_jax.inference.predictor import evaluate
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.network import init_network
from pfnn_jax.models.style import init_style
from pfnn_jax.motion.features.encode import clip_features
from pfnn_jax.motion.features.layout import LAYOUTS
from pfnn_jax.motion.features.normaliser import fit_normaliser
from pfnn_jax.motion.skeleton import skeleton_to_json
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.run import Run, RunConfig, create_run, load_run, save_shared, save_style
from tests.interop.small_runs import make_run

FLOAT32 = 2e-5  # metres: fused and unfused products of a walk of a few seconds
SPEED = 1.1
STYLES = ("calm", "wild")


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Run:
    """A run whose network barely moves about the mean of a straight walk, with two CP styles."""
    clip, labels = synthesise("neutral", np.zeros(150), np.full(150, SPEED), seed=2)
    layout = LAYOUTS["mason2018"](clip.skeleton.num_joints)
    rows = clip_features(clip, layout, labels)
    sizes, form = NetworkConfig(layout.input_size, layout.output_size, hidden=16), AdapterConfig(rank=2)
    config = RunConfig(sizes, form, layout.name, layout.num_joints, STYLES, skeleton_to_json(clip.skeleton))
    path = create_run(tmp_path_factory.mktemp("runs") / "run", config, fit_normaliser(rows.x, rows.y, layout))
    save_shared(path, jax.tree.map(lambda a: 0.1 * a, init_network(sizes, key=jax.random.key(0))))
    for index, name in enumerate(STYLES):
        adapter = init_style(form, 16, sizes.num_control_points, key=jax.random.key(index))
        save_style(path, name, jax.tree.map(lambda a: 0.3 * a, adapter), {"speed": SPEED} if index else {})
    return load_run(path)


@pytest.fixture(scope="module")
def controller(run) -> Controller:
    """Without feet held, which takes most of the compilation."""
    return make_controller(run, capacity=3, foot_ik=False)


@pytest.fixture(scope="module")
def held_film_controller(tmp_path_factory) -> Controller:
    """Of a network with local phases and Films, feet held: whatever a controller can be made of."""
    return make_controller(make_run(tmp_path_factory.mktemp("films") / "run", "mason2022", "film"))


def command(controller: Controller, speed: float, yaw: float = 0.0, style: str | int = "calm") -> Command:
    direction = jnp.asarray([np.sin(yaw), np.cos(yaw)], jnp.float32)
    return Command(velocity=speed * direction, direction=direction, style=jnp.asarray(controller.style_weights(style)))


def repeated(one: Command, frames: int) -> Command:
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (frames, *leaf.shape)), one)


def test_spare_rows_are_zero_and_styles_have_names(controller):
    assert controller.styles == STYLES and controller.capacity == 3
    assert all(not np.asarray(leaf[2]).any() for leaf in jax.tree.leaves(controller.params.bank))
    np.testing.assert_allclose(controller.style_weights({"calm": 0.25, "wild": 0.75}), [0.25, 0.75, 0.0])
    np.testing.assert_array_equal(controller.style_weights(1), controller.style_weights("wild"))
    for wrong in ("other", 2, -1):
        with pytest.raises(InputError, match="must be one of calm, wild"):
            controller.start(style=wrong)
    with pytest.raises(InputError, match="must sum to one"):
        controller.style_weights({"calm": 0.5, "wild": 0.6})


def test_natural_speed_is_the_recorded_one_or_that_of_the_network(controller):
    recorded, unknown = (style_speed(controller.params, jnp.eye(3)[index]).natural for index in (1, 0))
    assert recorded == pytest.approx(SPEED)
    assert unknown == pytest.approx(SPEED, rel=0.2) and unknown != recorded  # the walk that the network repeats


def test_without_tracking_it_is_the_published_loop(run):
    plain = make_controller(run, ["wild"], foot_ik=False, tracking=None)
    state, asked = plain.start(), command(plain, SPEED, 0.3, "wild")
    predictor = plain.params.mixed_predictor(jnp.ones(1))
    one = jax.jit(lambda motion: published_step(partial(evaluate, predictor), run.layout, motion, asked)[0])
    motion = state.motion
    for _ in range(20):
        state, motion = plain.step(state, asked), one(motion)
    np.testing.assert_allclose(state.motion.positions, motion.positions, atol=FLOAT32)
    np.testing.assert_allclose(state.motion.joint_positions, motion.joint_positions, atol=FLOAT32)
    np.testing.assert_allclose(state.joints[0], motion.joint_positions[0], atol=FLOAT32)
    assert state.time_scale == 1.0


def test_the_start_stands_where_it_is_told(controller):
    state = controller.start((2.0, -3.0), np.pi / 2, "wild")
    np.testing.assert_allclose(state.motion.positions[ROOT], [2.0, -3.0], atol=FLOAT32)
    np.testing.assert_allclose(state.motion.directions[ROOT], [1.0, 0.0], atol=FLOAT32)
    np.testing.assert_allclose(state.style, [0.0, 1.0, 0.0])
    still = controller.step(state, command(controller, 0.0, 1.0, "wild"))
    np.testing.assert_allclose(still.motion.joint_positions, state.motion.joint_positions, atol=0.0)
    assert state.time_scale == still.pace == 0.0


def compilations() -> int:
    """How often `step` has been compiled."""
    return getattr(step, "_cache_size")()  # noqa: B009 - JAX tells it under no public name


def test_a_step_returns_what_it_takes(controller):
    """The same shapes and types: a loop compiles once, and a scan carries the state."""
    state = controller.start()
    after = controller.step(state, command(controller, SPEED))
    assert jax.tree.map(jax.typeof, state) == jax.tree.map(jax.typeof, after)
    size = compilations()
    controller.step(after, command(controller, 0.7, 0.2, "wild"))
    assert compilations() == size


@pytest.mark.parametrize("which", ["controller", "held_film_controller"])
def test_loop_scan_and_vmap_agree(which, request):
    controller = request.getfixturevalue(which)
    frames, asked = 40, [command(controller, SPEED, yaw, style) for yaw, style in ((0.4, 0), (-0.9, 1))]
    starts = [controller.start(style=index) for index in range(2)]
    loops = []
    for state, one in zip(starts, asked, strict=True):
        for _ in range(frames):
            state = controller.step(state, one)
        loops.append(state)
    stack = partial(jax.tree.map, lambda *leaves: jnp.stack(leaves))
    commands = stack(*(repeated(one, frames) for one in asked))
    many = jax.vmap(partial(rollout_commands, controller.setup, controller.params))(stack(*starts), commands)[0]
    for index, (state, one, loop) in enumerate(zip(starts, asked, loops, strict=True)):
        scanned, seen = rollout_commands(controller.setup, controller.params, state, repeated(one, frames))
        np.testing.assert_allclose(scanned.joints, loop.joints, atol=FLOAT32)
        np.testing.assert_allclose(many.joints[index], loop.joints, atol=10 * FLOAT32)
        assert seen.joints.shape == (frames, *loop.joints.shape)


def test_bones_are_rigid(controller):
    _, seen = rollout_commands(
        controller.setup, controller.params, controller.start(), repeated(command(controller, SPEED, 0.5), 60)
    )
    parents = np.array(controller.setup.rig.parents[1:])
    lengths = np.linalg.norm(seen.joints[:, 1:] - seen.joints[:, parents], axis=-1)
    np.testing.assert_allclose(
        lengths, np.broadcast_to(np.linalg.norm(controller.setup.rig.offsets[1:], axis=-1), lengths.shape), atol=1e-5
    )


def test_a_style_changes_by_and_by(controller):
    state = controller.start(style="calm")
    weights = []
    for _ in range(150):
        state = controller.step(state, command(controller, SPEED, style="wild"))
        weights.append(np.asarray(state.style))
    weights = np.stack(weights)
    np.testing.assert_allclose(weights.sum(1), 1.0, atol=2e-3)  # while the last thousandth is snapped
    assert (np.diff(weights[:, 1]) >= 0).all() and np.abs(np.diff(weights, axis=0)).max() < 0.06
    np.testing.assert_array_equal(weights[-1], [0.0, 1.0, 0.0])


def test_speeds_of_a_mixture_are_means_over_its_styles(controller):
    params = replace(controller.params, speeds=jnp.asarray([1.0, 2.0, 0.0]), speed_gains=jnp.asarray([0.5, 1.5, 1.0]))
    half = style_speed(params, jnp.asarray([0.5, 0.5, 0.0]))
    assert half.natural == pytest.approx(1.5)
    assert half.natural * half.gain == pytest.approx(0.5 * 0.5 + 0.5 * 3.0)
    extrapolated = style_speed(params, jnp.asarray([3.0, -2.0, 0.0]))
    assert extrapolated.natural > 0.0 and extrapolated.gain >= 0.0


@pytest.mark.parametrize("up", [[0.0, 0.0, 2.0], [0.0, 0.0, 0.0]])
def test_a_row_without_axes_leaves_numbers(up):
    forward, found = orthonormal(jnp.asarray([0.0, 0.0, 1.0]), jnp.asarray(up))
    np.testing.assert_allclose(forward, [0.0, 0.0, 1.0])
    assert np.isfinite(found).all()
