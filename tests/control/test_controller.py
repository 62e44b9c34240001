"""The controller on small networks: the published loop inside it, styles, standing, and how it is run."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control.controller import Controller, make_controller, rollout_commands, step, with_calibrated_speeds
from pfnn_jax.control.controller_state import ControllerState, standing_point, style_speed
from pfnn_jax.control.ik.foot_lock import FootLockConfig
from pfnn_jax.control.loop.state import ROOT, turn_state
from pfnn_jax.control.loop.step import Command, published_step
from pfnn_jax.control.vectors import length, orthonormal, running_sum
from pfnn_jax.errors import InputError
from pfnn_jax.inference.predictor import evaluate
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.layers.cp import CPLayer
from pfnn_jax.models.network import Network, init_network
from pfnn_jax.models.style import init_style
from pfnn_jax.motion.features.encode import clip_features
from pfnn_jax.motion.features.layout import LAYOUTS, FrameLayout
from pfnn_jax.motion.features.normaliser import fit_normaliser
from pfnn_jax.motion.skeleton import skeleton_to_json
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.run import Run, create_run, load_run, save_shared, save_style
from pfnn_jax.run_config import RunConfig
from tests.interop.small_runs import make_run

FLOAT32 = 2e-5  # metres: fused and unfused products of a walk of a few seconds
SAME_WALK = 1e-3  # metres: rounding of a walk of two seconds, grown by the feedback of the loop
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
        adapter = init_style(form, sizes, key=jax.random.key(index))
        save_style(path, name, jax.tree.map(lambda a: 0.3 * a, adapter), {"speed": SPEED} if index else {})
    return load_run(path)


@pytest.fixture(scope="module")
def controller(run) -> Controller:
    """Without feet held, which takes most of the compilation."""
    return make_controller(run, capacity=3, foot_ik=False)


@pytest.fixture(scope="module")
def held_film_controller(tmp_path_factory) -> Controller:
    """Of a network with local phases and FiLM styles, with feet held."""
    return make_controller(make_run(tmp_path_factory.mktemp("films") / "run", "mason2022", "film"))


def command(controller: Controller, speed: float, yaw: float = 0.0, style: str | int = "calm") -> Command:
    direction = jnp.asarray([np.sin(yaw), np.cos(yaw)], jnp.float32)
    return Command(velocity=speed * direction, direction=direction, style=jnp.asarray(controller.style_weights(style)))


@pytest.fixture(scope="module")
def held_controller(run) -> Controller:
    """With feet held."""
    return make_controller(run)


def repeated(one: Command, frames: int) -> Command:
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (frames, *leaf.shape)), one)


def test_spare_rows_are_zero_and_styles_have_names(controller):
    assert controller.styles == STYLES and controller.capacity == 3
    assert all(not np.asarray(leaf[2]).any() for leaf in jax.tree.leaves(controller.params.bank))
    np.testing.assert_allclose(controller.style_weights({"calm": 0.25, "wild": 0.75}), [0.25, 0.75, 0.0])
    np.testing.assert_array_equal(controller.style_weights(1), controller.style_weights("wild"))
    for wrong in ("other", 2, -1):
        with pytest.raises(InputError) as caught:
            controller.start(style=wrong)
        assert (caught.value.place, caught.value.value) == ("style", wrong)
    with pytest.raises(InputError) as caught:
        controller.style_weights({"calm": 0.5, "wild": 0.6})
    assert caught.value.place == "style weights"


def test_natural_speed_is_the_recorded_one_or_that_of_the_network(controller):
    recorded, unknown = (style_speed(controller.params, jnp.eye(3)[index]).natural for index in (1, 0))
    assert recorded == pytest.approx(SPEED)
    assert unknown == pytest.approx(SPEED, rel=0.2) and unknown != recorded  # the walk that the network repeats


def test_without_tracking_it_is_the_published_loop(run):
    plain = make_controller(run, ["wild"], foot_ik=False, tracking=None)
    state, commanded = plain.start(), command(plain, SPEED, 0.3, "wild")
    predictor = plain.params.mixed_predictor(jnp.ones(1))
    one = jax.jit(lambda motion: published_step(partial(evaluate, predictor), run.layout, motion, commanded)[0])
    motion = state.motion
    for _ in range(20):
        state, motion = plain.step(state, commanded), one(motion)
    np.testing.assert_allclose(state.motion.positions, motion.positions, atol=FLOAT32)
    np.testing.assert_allclose(state.motion.joint_positions, motion.joint_positions, atol=FLOAT32)
    np.testing.assert_allclose(state.joints[0], motion.joint_positions[0], atol=FLOAT32)
    assert state.time_scale == 1.0


def test_a_character_starts_standing_at_its_position_and_yaw(controller):
    state = controller.start((2.0, -3.0), np.pi / 2, "wild")
    np.testing.assert_allclose(state.root, [2.0, -3.0], atol=FLOAT32)
    np.testing.assert_allclose(state.joints[0, [0, 2]], [2.0, -3.0], atol=FLOAT32)
    np.testing.assert_allclose(state.facing, [1.0, 0.0], atol=FLOAT32)
    np.testing.assert_allclose(state.style, [0.0, 1.0, 0.0])
    still = controller.step(state, command(controller, 0.0, 1.0, "wild"))
    np.testing.assert_allclose(still.motion.joint_positions, state.motion.joint_positions, atol=FLOAT32)
    np.testing.assert_allclose(still.joints, state.joints, atol=FLOAT32)
    assert state.time_scale == still.time_scale == 0.0


def compilations() -> int:
    """How often `step` has been compiled."""
    return getattr(step, "_cache_size")()  # noqa: B009 - JAX has no public name for it


def test_a_step_keeps_shapes_and_types_of_the_state(controller):
    """A loop then compiles once, and a scan can carry the state."""
    state = controller.start()
    after = controller.step(state, command(controller, SPEED))
    assert jax.tree.map(jax.typeof, state) == jax.tree.map(jax.typeof, after)
    size = compilations()
    controller.step(after, command(controller, 0.7, 0.2, "wild"))
    assert compilations() == size


@pytest.mark.parametrize("which", ["controller", "held_film_controller"])
def test_loop_scan_and_vmap_agree(which, request):
    controller = request.getfixturevalue(which)
    frames, commanded = 40, [command(controller, SPEED, yaw, style) for yaw, style in ((0.4, 0), (-0.9, 1))]
    starts = [controller.start(style=index) for index in range(2)]
    loops = []
    for state, one in zip(starts, commanded, strict=True):
        for _ in range(frames):
            state = controller.step(state, one)
        loops.append(state)
    stack = partial(jax.tree.map, lambda *leaves: jnp.stack(leaves))
    commands = stack(*(repeated(one, frames) for one in commanded))
    many = jax.vmap(partial(rollout_commands, controller.setup, controller.params))(stack(*starts), commands)[0]
    for index, (state, one, loop) in enumerate(zip(starts, commanded, loops, strict=True)):
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


def test_a_style_changes_gradually(controller):
    state = controller.start(style="calm")
    weights = []
    for _ in range(150):
        state = controller.step(state, command(controller, SPEED, style="wild"))
        weights.append(np.asarray(state.style))
    weights = np.stack(weights)
    np.testing.assert_allclose(weights.sum(1), 1.0, atol=2e-3)  # while the last thousandth is snapped
    assert (np.diff(weights[:, 1]) >= 0).all() and np.abs(np.diff(weights, axis=0)).max() < 0.06
    np.testing.assert_array_equal(weights[-1], [0.0, 1.0, 0.0])


@pytest.mark.parametrize("standing", [[0], [1], [0, 1], []])
def test_a_heading_correction_turns_about_the_foot_that_stands(run, controller, standing):
    """So that it does not slide: without a foot in contact it is the root that keeps its place."""
    setup, params, motion = controller.setup, controller.params, controller.start((1.0, 2.0), 0.4).motion
    feet, lifted = np.array(setup.rig.feet), np.array([side not in standing for side in (0, 0, 1, 1)])
    motion = replace(  # this layout has no contacts: they are found by height and speed
        motion,
        joint_positions=motion.joint_positions.at[feet, 1].set(params.foot_heights + 0.5 * lifted),
        joint_velocities=jnp.zeros_like(motion.joint_velocities),
    )

    def place(motion):
        middles = motion.joint_positions[feet].reshape(2, 2, 3).mean(1)[:, np.array([0, 2])]
        return middles[np.array(standing)].mean(0) if standing else motion.positions[ROOT]

    centre = standing_point(setup, params, motion, jnp.zeros(run.layout.output_size))
    np.testing.assert_allclose(centre, place(motion), atol=FLOAT32)
    turned = turn_state(motion, jnp.float32(0.3), centre)
    np.testing.assert_allclose(place(turned), centre, atol=FLOAT32)
    moved = float(length(turned.positions[ROOT] - motion.positions[ROOT]))
    assert moved > 0.01 if len(standing) == 1 else moved < 0.1


def test_speeds_of_a_mixture_are_means_over_its_styles(controller):
    params = replace(controller.params, speeds=jnp.asarray([1.0, 2.0, 0.0]), speed_gains=jnp.asarray([0.5, 1.5, 1.0]))
    half = style_speed(params, jnp.asarray([0.5, 0.5, 0.0]))
    assert half.natural == pytest.approx(1.5)
    assert half.natural * half.gain == pytest.approx(0.5 * 0.5 + 0.5 * 3.0)
    extrapolated = style_speed(params, jnp.asarray([3.0, -2.0, 0.0]))
    assert extrapolated.natural > 0.0 and extrapolated.gain >= 0.0


MOVES = ((1.1, 0.0, 0.0), (1.3, 0.8, 0.8), (0.9, 2.2, 0.6), (0.0, 0.0, 0.0))
"""Commands of the laws below, half a second each: speed, heading and facing. They walk, turn, strafe and stop."""


def moves(controller: Controller, yaw: float = 0.0, mirror: bool = False) -> Command:
    """Returns the commands of `MOVES`, rotated by a yaw, or mirrored in the plane x = 0."""
    speed, heading, facing = (np.repeat(values, 30) for values in np.array(MOVES, np.float32).T)
    sign = -1.0 if mirror else 1.0
    velocity, direction = (
        np.stack([sign * np.sin(angle + yaw), np.cos(angle + yaw)], -1) for angle in (heading, facing)
    )
    style = np.tile(controller.style_weights({0: 0.3, 1: 0.7})[None], (len(speed), 1))
    return Command(
        velocity=jnp.asarray(speed[:, None] * velocity), direction=jnp.asarray(direction), style=jnp.asarray(style)
    )


def walk(controller: Controller, commands: Command, position=(0.0, 0.0), yaw: float = 0.0) -> ControllerState:
    """Returns the states of a walk. The feet of a network that was not trained are never in contact, so locks are
    made to hold them without, until they are too far away."""
    always = FootLockConfig(lock_threshold=0.0, release_threshold=0.0)
    controller = replace(controller, setup=replace(controller.setup, foot_lock=always))
    state = controller.start(position, yaw)
    return rollout_commands(controller.setup, controller.params, state, commands)[1]


def assert_walks(states: ControllerState) -> None:
    """The law is not one of a character that only stands: it moves, and feet are held and released."""
    assert float(states.time_scale.max()) > 0.1 and float(jnp.ptp(states.root, axis=0).max()) > 0.02
    assert bool(states.feet.held.any()) and not bool(states.feet.held.all())


@pytest.mark.parametrize("which", ["held_controller", "held_film_controller"])
def test_the_whole_controller_is_equivariant_under_rigid_motion_of_the_ground(which, request):
    """Start, tracking, styles and foot locks: a character moved and rotated with its commands walks the same walk."""
    controller, yaw, position = request.getfixturevalue(which), 0.7, np.array([2.0, -3.0])
    here, there = walk(controller, moves(controller)), walk(controller, moves(controller, yaw), position, yaw)
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])  # rows: what +X, +Y and +Z become
    expected = np.asarray(here.joints) @ turn + [position[0], 0.0, position[1]]
    np.testing.assert_allclose(there.joints, expected, atol=SAME_WALK)
    np.testing.assert_allclose(there.time_scale, here.time_scale, atol=SAME_WALK)
    np.testing.assert_allclose(there.feet.strength, here.feet.strength, atol=SAME_WALK)
    assert_walks(here)


def mirror_columns(layout: FrameLayout, inputs: bool, partners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns columns and signs that mirror a row in the plane x = 0: `row[columns] * signs`."""
    size, blocks = (layout.input_size, layout.input_blocks) if inputs else (layout.output_size, layout.output_blocks)
    columns, signs = np.arange(size), np.ones(size, np.float32)
    for name in blocks:
        at = layout.input_slice(name) if inputs else layout.output_slice(name)
        if name.startswith("joint_"):
            columns[at] = columns[at].reshape(-1, 3)[partners].reshape(-1)
            signs[at] = np.tile([-1.0, 1.0, 1.0], len(partners))
        elif name.endswith("_x") or name == "root_yaw_rate":
            signs[at] = -1.0
        elif name == "root_velocity":
            signs[at] = [-1.0, 1.0]
    return columns, signs


def mirrored(controller: Controller, partners: np.ndarray) -> Controller:
    """Returns a controller whose network is the mirror image of the controller's: left and right exchanged, and the
    phase shifted by half a cycle, so that control points move by two of four."""
    params, layout = controller.params, controller.setup.layout
    (i, i_signs), (o, o_signs) = (mirror_columns(layout, inputs, partners) for inputs in (True, False))
    first, second, last = jax.tree.map(lambda leaf: jnp.roll(leaf, 2, axis=0), params.predictor.network.layers)
    network = Network(
        (
            replace(first, weights=np.asarray(first.weights)[:, i] * i_signs[:, None]),
            second,
            replace(
                last, weights=last.weights[:, :, o] * o_signs[None, None], biases=last.biases[:, o] * o_signs[None]
            ),
        )
    )
    predictor = replace(
        params.predictor,
        network=network,
        input_mean=params.predictor.input_mean[i] * i_signs,
        input_std=params.predictor.input_std[i],
        output_mean=params.predictor.output_mean[o] * o_signs,
        output_std=params.predictor.output_std[o],
    )
    assert isinstance(params.bank, CPLayer)
    other = replace(
        controller,
        params=replace(
            params,
            predictor=predictor,
            bank=replace(params.bank, d=jnp.roll(params.bank.d, 2, axis=1)),
            initial_row=params.initial_row[i] * i_signs,
            initial_phase=params.initial_phase + np.float32(np.pi),
            foot_heights=params.foot_heights[np.array([2, 3, 0, 1])],
            speeds=jnp.asarray([0.0, SPEED]),  # as recorded, before they are calibrated
        ),
    )
    return with_calibrated_speeds(other)


def test_the_whole_controller_is_equivariant_under_mirroring(run, held_controller):
    """Start, tracking, styles and foot locks: the mirrored network walks the mirrored walk under mirrored commands."""
    partners, flip = run.skeleton.mirror, np.array([-1.0, 1.0, 1.0], np.float32)
    np.testing.assert_allclose(run.skeleton.offsets[partners] * flip, run.skeleton.offsets, atol=1e-6)  # same body
    other = mirrored(held_controller, partners)
    one, mirror = walk(held_controller, moves(held_controller)), walk(other, moves(other, mirror=True))
    np.testing.assert_allclose(mirror.joints, np.asarray(one.joints)[:, partners] * flip, atol=SAME_WALK)
    np.testing.assert_allclose(mirror.time_scale, one.time_scale, atol=SAME_WALK)
    np.testing.assert_allclose(mirror.feet.strength, one.feet.strength[:, np.array([2, 3, 0, 1])], atol=SAME_WALK)
    assert_walks(one)


def test_running_sum_is_that_of_numpy():
    steps = np.random.default_rng(0).normal(size=(50, 2))
    np.testing.assert_allclose(running_sum(jnp.float32(steps)), np.cumsum(steps, axis=0), atol=FLOAT32)


@pytest.mark.parametrize("up", [[0.0, 0.0, 2.0], [0.0, 0.0, 0.0]])
def test_axes_without_a_direction_become_finite(up):
    forward, found = orthonormal(jnp.asarray([0.0, 0.0, 1.0]), jnp.asarray(up))
    np.testing.assert_allclose(forward, [0.0, 0.0, 1.0])
    assert np.isfinite(found).all()
