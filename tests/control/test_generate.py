"""From rollouts to clips: recorded motion comes back whole; a run's motion reaches a BVH file at the right scale."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control.generation import clip_from_frames, default_speed, generate
from pfnn_jax.control.loop.rollout import rollout
from pfnn_jax.control.loop.state import initial_state
from pfnn_jax.control.loop.step import LOOP_CONFIGS, Command
from pfnn_jax.errors import InputError
from pfnn_jax.models.adapters import AdapterConfig, init_style
from pfnn_jax.models.network import NetworkConfig, init_network
from pfnn_jax.motion.bvh import read_bvh, write_bvh
from pfnn_jax.motion.clip import cut
from pfnn_jax.motion.features.encode import clip_features
from pfnn_jax.motion.features.layout import LAYOUTS
from pfnn_jax.motion.features.normaliser import fit_normaliser
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.paths import circle, read_path, straight
from pfnn_jax.motion.skeleton import skeleton_to_json
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.run import Run, RunConfig, create_run, load_run, save_shared, save_style

# Metres: the clip's root path is filled in by chords before the first frame; the pose forgets half of it every frame.
FORGOTTEN, MILLIMETRE = 20, 1e-3
# Metres: Euler angles in a BVH file are written in degrees with six decimals.
DECIMALS = 1e-5
SPEED = 1.1


def recorded(params, x, phase):
    """(y [T, Dy], phase [T]) of less than one cycle -> the recorded output of the frame at this phase."""
    y, phases = params
    return y[jnp.argmax(jnp.cos(phases - phase))]


@pytest.mark.parametrize("name", ["mason2018", "pfnn2017", "mason2022_pfnn"])
def test_recorded_motion_comes_back(name):
    """A network that repeats a clip's outputs gives back the clip: joints, and rotations on rigid bones."""
    frames = 200
    clip, labels = synthesise("neutral", np.full(frames, 0.4), np.full(frames, SPEED), seed=1)
    layout = LAYOUTS[name](clip.skeleton.num_joints)
    rows = clip_features(clip, layout, labels)
    first, count = 60, 50  # less than a cycle, so that the phase tells the frame
    y, phase = jnp.asarray(rows.y[first : first + count]), jnp.asarray(rows.phase[first : first + count])
    state = initial_state(layout, rows.x[first], phase[0], jnp.zeros(2), jnp.zeros(()))
    ahead = jnp.tile(jnp.asarray([[0.0, 1.0]]), (count, 1))
    # Under the next-frame rule a root is mixed with what stood there; here it is to be the recorded one.
    config = replace(LOOP_CONFIGS[name], trajectory_rate=1.0)
    found = rollout(
        recorded, (y, phase), layout, state, Command(velocity=SPEED * ahead, direction=ahead), config=config
    )
    again = clip_from_frames(clip.skeleton, layout, found)
    begin = int(rows.frames[first]) + layout.next_frame
    truth = cut(clip, begin, begin + count)
    expected = forward_kinematics(clip.skeleton, truth.root_positions, truth.rotations)[0]
    got = forward_kinematics(clip.skeleton, again.root_positions, again.rotations)[0]
    # `pfnn2017` counts heights from the ground it finds under the feet.
    assert abs(got[0, 0, 1] - expected[0, 0, 1]) < (1e-2 if layout.has_input("terrain_height") else MILLIMETRE)
    for positions in (got, np.asarray(found.joint_positions)):
        np.testing.assert_allclose(aligned(positions), aligned(expected), atol=MILLIMETRE)


def aligned(positions):
    """World joints [T, J, 3] without the frames that still forget, turned and moved so that the hips agree."""
    positions = np.asarray(positions, np.float64)[FORGOTTEN:]
    ground = positions[..., [2, 0]] @ np.array([1.0, 1.0j])
    ground = ground - ground[0, 0]
    turned = ground / ground[-1, 0] * abs(ground[-1, 0])
    return np.stack([turned.real, positions[..., 1] - positions[0, 0, 1], turned.imag], -1)


@pytest.fixture(scope="module", params=["mason2018", "pfnn2017", "mason2022_pfnn"])
def run(request, tmp_path_factory) -> Run:
    """A run whose network barely moves about the mean of a straight walk."""
    clip, labels = synthesise("neutral", np.zeros(150), np.full(150, SPEED), seed=2)
    layout = LAYOUTS[request.param](clip.skeleton.num_joints)
    rows = clip_features(clip, layout, labels)
    network = NetworkConfig(layout.input_size, layout.output_size, hidden=16)
    config = RunConfig(
        network, AdapterConfig(rank=2), layout.name, layout.num_joints, (), skeleton_to_json(clip.skeleton)
    )
    path = create_run(tmp_path_factory.mktemp("runs") / layout.name, config, fit_normaliser(rows.x, rows.y, layout))
    quiet = jax.tree.map(lambda a: 0.1 * a, init_network(network, key=jax.random.key(0)))
    save_shared(path, quiet)
    adapter = init_style(AdapterConfig(rank=2), 16, 4, key=jax.random.key(1))
    save_style(path, "brisk", adapter, {"speed": 1.4})
    return load_run(path)


def test_generated_motion_follows_its_path_into_a_file(run, tmp_path):
    (tmp_path / "path.csv").write_text("x,z\n3,1\n8,1\n")
    made = generate(run, "brisk", read_path(tmp_path / "path.csv"), speed=SPEED, seconds=1.5)
    clip, roots = made.clip, np.asarray(made.frames.root_positions)
    assert clip.num_frames == 90 and clip.fps == 60.0 and clip.style == "brisk"
    np.testing.assert_allclose(roots[0], [3.0, 1.0], atol=DECIMALS)
    # The quiet network walks on at about the mean speed, along +X from its first frame.
    assert roots[-1, 0] - 3.0 == pytest.approx(1.5 * SPEED, rel=0.2)
    np.testing.assert_allclose(made.frames.root_yaw, np.pi / 2, atol=0.3)
    np.testing.assert_allclose(clip.root_positions, made.frames.joint_positions[:, 0], atol=DECIMALS)
    write_bvh(tmp_path / "clip.bvh", clip)
    back = read_bvh(tmp_path / "clip.bvh", unit=0.01)
    expected = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0]
    found = forward_kinematics(back.skeleton, back.root_positions, back.rotations)[0]
    order = [back.skeleton.names.index(name) for name in clip.skeleton.names]
    np.testing.assert_allclose(found[:, order], expected, atol=DECIMALS)
    # Centimetres in the file: the first line of motion holds the hips' height.
    height = float((tmp_path / "clip.bvh").read_text().split("Frame Time:")[1].split("\n")[1].split()[1])
    assert height == pytest.approx(100.0 * clip.root_positions[0, 1], abs=0.01)


def test_modes_are_close_and_differ(run):
    made = [
        generate(run, "brisk", circle(2.0), seconds=0.5, mode=mode) for mode in ("cubic", "nearest50", "constant50")
    ]
    outputs = [np.asarray(each.frames.outputs) / run.normaliser.outputs.std for each in made]
    for other in outputs[1:]:
        assert 0.0 < np.abs(outputs[0] - other).max() < 1.0
    assert np.abs(outputs[1] - outputs[2]).max() > 0.0


def test_speed_and_time_by_default(run):
    assert default_speed(run, "brisk") == 1.4
    assert default_speed(run, None) == pytest.approx(SPEED, rel=0.05)
    made = generate(run, "brisk", straight(1.4))
    assert made.clip.num_frames == 60


@pytest.mark.parametrize(
    ("style", "options", "message"),
    [
        ("slow", {}, "style: slow; must be one of brisk"),
        ("brisk", {"mode": "linear10"}, "mode: linear10; must be cubic, nearest50, constant50"),
        ("brisk", {"speed": 0.0}, "speed: 0.0; must be above 0"),
        ("brisk", {"seconds": float("nan")}, "seconds: nan; must be above 0"),
    ],
)
def test_bad_requests(run, style, options, message):
    with pytest.raises(InputError, match=message):
        generate(run, style, circle(1.0), **options)
