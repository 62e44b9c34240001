"""The controller on small networks: the published loop inside it, styles, standing, and how it is run."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control import calibration as standing
from pfnn_jax.control.character import mixed_style, own_share, own_speed
from pfnn_jax.control.controller import Controller, drive, make_controller, step
from pfnn_jax.control.ground import angle_between, length, orthonormal
from pfnn_jax.control.loop.state import ROOT, initial_state, turn_state
from pfnn_jax.control.loop.step import CONTROLLERS, Command, published_step
from pfnn_jax.control.tracking import STANDARD, ask, begin, hold_back, keep_pace, observe, turning
from pfnn_jax.errors import InputError
from pfnn_jax.inference.predictor import evaluate
from pfnn_jax.models.adapters import AdapterConfig, init_style
from pfnn_jax.models.network import NetworkConfig, init_network
from pfnn_jax.motion.features.encode import clip_features
from pfnn_jax.motion.features.layout import LAYOUTS
from pfnn_jax.motion.features.normaliser import fit_normaliser
from pfnn_jax.motion.skeleton import skeleton_to_json
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.run import Run, RunConfig, create_run, load_run, save_shared, save_style
from tests.control.walkers import LAYOUT, WALK, input_row
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


def test_styles_walk_at_the_speed_that_they_tell_or_at_that_of_their_network(controller):
    told, untold = (own_speed(controller.params, jnp.eye(3)[index]) for index in (1, 0))
    assert told == pytest.approx(SPEED)
    assert untold == pytest.approx(SPEED, rel=0.2) and untold != told  # the walk that the network was made to repeat


def test_without_regulation_it_is_the_published_loop(run):
    plain = make_controller(run, ["wild"], foot_ik=False, regulated=False)
    state, asked = plain.start(), command(plain, SPEED, 0.3, "wild")
    predictor = replace(plain.params.predictor, style=mixed_style(plain.params.bank, jnp.ones(1)))
    one = jax.jit(lambda motion: published_step(partial(evaluate, predictor), run.layout, motion, asked)[0])
    motion = state.motion
    for _ in range(20):
        state, motion = plain.step(state, asked), one(motion)
    np.testing.assert_allclose(state.motion.positions, motion.positions, atol=FLOAT32)
    np.testing.assert_allclose(state.motion.joint_positions, motion.joint_positions, atol=FLOAT32)
    np.testing.assert_allclose(state.joints[0], motion.joint_positions[0], atol=FLOAT32)
    assert state.pace == 1.0


def test_the_start_stands_where_it_is_told(controller):
    state = controller.start((2.0, -3.0), np.pi / 2, "wild")
    np.testing.assert_allclose(state.motion.positions[ROOT], [2.0, -3.0], atol=FLOAT32)
    np.testing.assert_allclose(state.motion.directions[ROOT], [1.0, 0.0], atol=FLOAT32)
    np.testing.assert_allclose(state.style, [0.0, 1.0, 0.0])
    still = controller.step(state, command(controller, 0.0, 1.0, "wild"))
    np.testing.assert_allclose(still.motion.joint_positions, state.motion.joint_positions, atol=0.0)
    assert state.pace == still.pace == 0.0


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
    many = jax.vmap(partial(drive, controller.setup, controller.params))(stack(*starts), commands)[0]
    for index, (state, one, loop) in enumerate(zip(starts, asked, loops, strict=True)):
        scanned, seen = drive(controller.setup, controller.params, state, repeated(one, frames))
        np.testing.assert_allclose(scanned.joints, loop.joints, atol=FLOAT32)
        np.testing.assert_allclose(many.joints[index], loop.joints, atol=10 * FLOAT32)
        assert seen.joints.shape == (frames, *loop.joints.shape)


def test_bones_are_rigid(controller):
    _, seen = drive(
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


MIRROR = np.array([-1.0, 1.0], np.float32)
WORLD = np.array([-1.0, 1.0, 1.0], np.float32)


def mirrored(tree):
    """Vectors [..., 2] and [..., 3] reflected in the plane x = 0."""

    def flip(leaf):
        if leaf.ndim and leaf.shape[-1] in (2, 3):
            return jnp.asarray(np.asarray(leaf) * (MIRROR if leaf.shape[-1] == 2 else WORLD))
        return leaf

    return jax.tree.map(flip, tree)


def test_regulation_of_a_mirrored_character_is_mirrored():
    layout = LAYOUT["mason2018"]
    before = initial_state(layout, input_row(layout, WALK), jnp.float32(0.3), jnp.asarray([0.4, 1.0]), jnp.float32(0.2))
    after = replace(before, positions=jnp.roll(before.positions, -1, 0), directions=jnp.roll(before.directions, -1, 0))
    asked = Command(velocity=jnp.asarray([0.9, 0.4]), direction=jnp.asarray([0.8, -0.6]))
    clearance = jnp.float32(0.02)
    regulated = replace(begin(jnp.asarray([0.2, 1.1]), clearance, 0.8), off=jnp.float32(0.1), astray=jnp.float32(1.3))

    def all_of(before, after, asked, regulated):
        wanted = ask(asked, jnp.float32(1.0), jnp.float32(0.8), before, regulated, CONTROLLERS["mason2018"], STANDARD)
        found = observe(regulated, before, after, asked, clearance, 60.0, STANDARD)
        angle = turning(found, asked.velocity, 60.0, STANDARD)
        return wanted, turn_state(after, angle), found.velocity, found.off, angle

    one = all_of(before, after, asked, regulated)
    other = all_of(mirrored(before), mirrored(after), mirrored(asked), replace(mirrored(regulated), off=-regulated.off))
    for a, b in zip(jax.tree.leaves(mirrored(one[:3])), jax.tree.leaves(other[:3]), strict=True):
        np.testing.assert_allclose(a, b, atol=FLOAT32)
    np.testing.assert_allclose(jnp.stack(one[3:]), -jnp.stack(other[3:]), atol=FLOAT32)
    assert one[4] != 0.0


def test_angles_go_the_short_way():
    a, b = jnp.asarray([0.0, 1.0]), jnp.asarray([1.0, 0.0])
    assert angle_between(a, b) == pytest.approx(np.pi / 2) and angle_between(b, a) == pytest.approx(-np.pi / 2)


def test_the_way_ahead_is_nowhere_faster_than_a_style_allows():
    layout = LAYOUT["mason2018"]
    state = initial_state(layout, input_row(layout, WALK), jnp.float32(0.0), jnp.asarray([0.4, 1.0]), jnp.float32(0.2))
    steps = 60.0 * length(jnp.diff(state.positions[ROOT:], axis=0))
    for own in (0.5 * float(steps.mean()), 2.0 * float(steps.max())):
        held = hold_back(state, jnp.float32(own), 60.0, STANDARD)
        found = 60.0 * length(jnp.diff(held.positions[ROOT:], axis=0))
        np.testing.assert_allclose(found, np.minimum(steps, STANDARD.haste * own), rtol=1e-3)
        np.testing.assert_array_equal(held.positions[: ROOT + 1], state.positions[: ROOT + 1])


def test_who_cannot_go_aside_faces_where_it_goes_after_a_while():
    layout = LAYOUT["mason2018"]
    state = initial_state(layout, input_row(layout, WALK), jnp.float32(0.0), jnp.zeros(2), jnp.float32(0.0))
    aside = Command(velocity=jnp.asarray([1.0, 0.0]), direction=jnp.asarray([0.0, 1.0]))
    fresh = begin(jnp.asarray([0.0, 1.0]), jnp.float32(0.0), 1.0)

    def asked_yaw(regulated) -> float:
        found = ask(aside, jnp.float32(1.0), jnp.float32(1.0), state, regulated, CONTROLLERS["mason2018"], STANDARD)
        return float(angle_between(state.directions[ROOT], found.direction))

    def after(seconds: float, off: float):
        regulated = replace(fresh, off=jnp.float32(off))
        for _ in range(round(seconds * 60)):
            regulated = observe(regulated, state, state, aside, jnp.float32(0.0), 60.0, STANDARD)
            regulated = replace(regulated, off=jnp.float32(off))
        return regulated

    assert asked_yaw(after(0.9 * STANDARD.patience, 1.5)) == pytest.approx(0.0, abs=1e-6)
    assert asked_yaw(after(1.2 * STANDARD.patience, 1.5)) == pytest.approx(0.2 * np.pi / 2, abs=0.06)
    assert asked_yaw(after(2.5 * STANDARD.patience, 1.5)) == pytest.approx(STANDARD.most_asked, abs=1e-6)
    assert asked_yaw(after(2.5 * STANDARD.patience, 0.1)) == pytest.approx(0.0, abs=1e-6)
    given_up = after(2.5 * STANDARD.patience, 1.5)
    assert observe(given_up, state, state, aside, jnp.float32(0.0), 60.0, STANDARD).astray >= given_up.astray
    for _ in range(300):  # one that strays now and then gives up nothing
        fresh = observe(replace(fresh, off=jnp.float32(1.5)), state, state, aside, jnp.float32(0.0), 60.0, STANDARD)
        for _ in range(2):
            fresh = observe(replace(fresh, off=jnp.float32(0.0)), state, state, aside, jnp.float32(0.0), 60.0, STANDARD)
    assert fresh.astray < STANDARD.patience


def test_walks_are_found_among_trials_that_hold(controller, monkeypatch):
    """A speed at which a network falls apart is no neighbour to walk beside; a style that never holds is left alone."""
    answer = {"nan_at": slice(0, 0)}

    def settle(setup, params, styles, own, asked):
        found = np.array(asked, np.float32)
        found[:, answer["nan_at"]] = np.nan
        return found

    monkeypatch.setattr(standing, "settle", settle)
    setup, params = controller.setup, replace(controller.params, speeds=jnp.asarray([1.0, 2.0, 0.0]))
    tried = np.asarray(standing.SHARES)
    for nan_at, expected in ((slice(0, 0), 1.0), (slice(5, 8), tried[3]), (slice(0, 8), 1.0)):
        answer["nan_at"] = nan_at
        own, shares = standing.find_walks(setup, params, [0, 1])
        np.testing.assert_allclose(own, [1.0, 2.0])
        np.testing.assert_allclose(shares, expected, rtol=1e-6)
    own, shares = standing.find_walks(setup, params, [2])
    np.testing.assert_allclose([own[0], shares[0]], [params.speed, 1.0], rtol=1e-6)
    assert all(not len(found) for found in standing.find_walks(setup, params, []))


def test_a_mixture_walks_at_a_speed_and_asks_for_the_mean_of_what_its_styles_ask_for(controller):
    params = replace(controller.params, speeds=jnp.asarray([1.0, 2.0, 0.0]), shares=jnp.asarray([0.5, 1.5, 1.0]))
    half = jnp.asarray([0.5, 0.5, 0.0])
    assert own_speed(params, half) == pytest.approx(1.5)
    assert own_speed(params, half) * own_share(params, half) == pytest.approx(0.5 * 0.5 + 0.5 * 3.0)
    beyond = jnp.asarray([3.0, -2.0, 0.0])
    assert own_speed(params, beyond) > 0.0 and own_share(params, beyond) >= 0.0


def test_a_slow_walk_halts_as_soon_as_a_quick_one():
    layout = LAYOUT["mason2018"]
    state = initial_state(layout, input_row(layout, WALK), jnp.float32(0.0), jnp.zeros(2), jnp.float32(0.0))
    stand = Command(velocity=jnp.zeros(2), direction=jnp.asarray([0.0, 1.0]))
    for pace in (STANDARD.slowest, 1.0):
        regulated, owed, frames = begin(jnp.asarray([0.0, 1.0]), jnp.float32(0.0), pace), 0.0, 0
        while float(regulated.pace) > 0.0 and frames < 240:  # one foot stays 5 cm up
            owed, frames = owed + float(regulated.pace), frames + 1
            if owed >= 1.0:
                owed -= 1.0
                regulated = observe(regulated, state, state, stand, jnp.float32(0.05), 60.0, STANDARD)
            regulated = keep_pace(regulated, stand.velocity, STANDARD)
        assert frames < 120


def test_a_step_is_taken_to_its_end_before_it_halts():
    """Told to stand with a foot in the air, it goes on until that comes down, and then slows down without a jump."""
    layout = LAYOUT["mason2018"]
    state = initial_state(layout, input_row(layout, WALK), jnp.float32(0.0), jnp.zeros(2), jnp.float32(0.0))
    stand = Command(velocity=jnp.zeros(2), direction=jnp.asarray([0.0, 1.0]))
    regulated, paces = begin(jnp.asarray([0.0, 1.0]), jnp.float32(0.0), 1.0), []
    for frame in range(90):
        clearance = jnp.float32(0.08 if frame < 30 else 0.0)
        regulated = observe(regulated, state, state, stand, clearance, 60.0, STANDARD)
        regulated = keep_pace(regulated, stand.velocity, STANDARD)
        paces.append(float(regulated.pace))
    assert min(paces[:30]) > 0.95 * STANDARD.stopping and paces[30] < paces[29] and paces[-1] == 0.0
    assert np.abs(np.diff(paces)).max() < 1.1 * STANDARD.landing_rate * STANDARD.stopping
    walking = keep_pace(regulated, jnp.asarray([0.0, 1.0]), STANDARD)
    assert walking.pace > 0.0 and not walking.landing


@pytest.mark.parametrize("up", [[0.0, 0.0, 2.0], [0.0, 0.0, 0.0]])
def test_a_row_without_axes_leaves_numbers(up):
    forward, found = orthonormal(jnp.asarray([0.0, 0.0, 1.0]), jnp.asarray(up))
    np.testing.assert_allclose(forward, [0.0, 0.0, 1.0])
    assert np.isfinite(found).all()
