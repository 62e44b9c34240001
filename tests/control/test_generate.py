"""From rollouts to clips: recorded motion is reproduced; generated motion reaches a BVH file at the right scale."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control.generation import clip_from_frames, generate, loop_frames
from pfnn_jax.control.loop.rollout import Frames, rollout
from pfnn_jax.control.loop.state import initial_state
from pfnn_jax.control.loop.step import LOOP_CONFIGS, Command
from pfnn_jax.control.run_settings import default_speed, loop_config
from pfnn_jax.errors import InputError
from pfnn_jax.inference.modes import Mode
from pfnn_jax.inference.predictor import make_predictor
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.network import init_network
from pfnn_jax.models.style import init_style
from pfnn_jax.motion.bvh import read_bvh, write_bvh
from pfnn_jax.motion.clip import cut
from pfnn_jax.motion.features.encode import clip_features
from pfnn_jax.motion.features.layout import LAYOUTS
from pfnn_jax.motion.features.normaliser import fit_normaliser
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.paths import Path, circle, read_path, straight
from pfnn_jax.motion.skeleton import skeleton_to_json
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.run import Run, create_run, load_run, load_style, save_shared, save_style
from pfnn_jax.run_config import RunConfig
from pfnn_jax.workflows.generate import generate_clip

# Metres: the clip's root path is filled in by chords before the first frame; the pose forgets half of it every frame.
FORGOTTEN, MILLIMETRE = 20, 1e-3
# Metres: Euler angles in a BVH file are written in degrees with six decimals.
DECIMALS = 1e-5
SPEED = 1.1


def recorded(params, x, phase):
    """Returns the recorded output at a phase, of params (y [T, Dy], phase [T]) of less than one cycle."""
    y, phases = params
    return y[jnp.argmax(jnp.cos(phases - phase))]


@pytest.mark.parametrize("name", ["mason2018", "pfnn2017", "mason2022_pfnn"])
def test_rollout_reproduces_recorded_motion(name):
    """A network that repeats the outputs of a clip generates the clip: joints, and rotations on rigid bones."""
    frames = 200
    clip, labels = synthesise("neutral", np.full(frames, 0.4), np.full(frames, SPEED), seed=1)
    layout = LAYOUTS[name](clip.skeleton.num_joints)
    rows = clip_features(clip, layout, labels)
    first, count = 60, 50  # less than a cycle, so that the phase determines the frame
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
    """Returns world joints [T, J, 3] after the initial transient, moved and rotated so that the hips agree."""
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
    adapter = init_style(AdapterConfig(rank=2), network, key=jax.random.key(1))
    save_style(path, "brisk", adapter, {"speed": 1.4})
    return load_run(path)


def published_frames(run: Run, path: Path, **settings) -> Frames:
    return loop_frames(make_predictor(run, "brisk"), path, run, loop=loop_config(run), **settings)


def test_generated_motion_follows_its_path_into_a_file(run, tmp_path):
    (tmp_path / "path.csv").write_text("x,z\n3,1\n8,1\n")
    frames = published_frames(run, read_path(tmp_path / "path.csv"), speed=SPEED, seconds=1.5)
    clip, roots = clip_from_frames(run.skeleton, run.layout, frames), np.asarray(frames.root_positions)
    assert clip.num_frames == 90 and clip.fps == 60.0
    np.testing.assert_allclose(roots[0], [3.0, 1.0], atol=DECIMALS)
    # The quiet network walks on at about the mean speed, along +X from its first frame.
    assert roots[-1, 0] - 3.0 == pytest.approx(1.5 * SPEED, rel=0.2)
    np.testing.assert_allclose(frames.root_yaw, np.pi / 2, atol=0.3)
    np.testing.assert_allclose(clip.root_positions, frames.joint_positions[:, 0], atol=DECIMALS)
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
    modes: tuple[Mode, ...] = ("cubic", "nearest50", "constant50")
    made = [published_frames(run, circle(2.0), speed=1.4, seconds=0.5, mode=mode) for mode in modes]
    outputs = [np.asarray(each.outputs) / run.normaliser.outputs.std for each in made]
    for other in outputs[1:]:
        assert 0.0 < np.abs(outputs[0] - other).max() < 1.0
    assert np.abs(outputs[1] - outputs[2]).max() > 0.0


def test_speed_and_time_by_default(run):
    assert default_speed(run, "brisk") == 1.4
    assert default_speed(run, None) == pytest.approx(SPEED, rel=0.05)
    assert generate_clip(run, "brisk", straight(1.4), published_loop=True).num_frames == 60


def test_generating_by_name_is_generating_in_memory(run):
    """A clip of a run is that of its parameters, with and without command tracking; paths and styles go by name."""
    for published_loop in (False, True):
        settings = {"seconds": 0.5, "foot_ik": False, "published_loop": published_loop}
        by_name = generate_clip(str(run.path), "brisk", "circle", **settings)
        style, loop = load_style(run, "brisk"), loop_config(run)
        in_memory = generate(run.shared, style, circle(2.0), run, natural_speed=1.4, loop=loop, **settings)
        np.testing.assert_array_equal(by_name.rotations, in_memory.rotations)
        np.testing.assert_array_equal(by_name.root_positions, in_memory.root_positions)
        assert by_name.style == "brisk" and by_name.num_frames == 30


@pytest.mark.parametrize(
    ("change", "place", "value"),
    [
        ({"style": "slow"}, "style", "slow"),
        ({"mode": "linear10", "published_loop": True}, "mode", "linear10"),
        ({"mode": "nearest50"}, "mode", "nearest50"),
        ({"speed": 0.0}, "speed", 0.0),
        ({"seconds": float("nan"), "published_loop": True}, "seconds", float("nan")),
        ({"path": "zigzag"}, "shape", "zigzag"),
    ],
)
def test_bad_requests_are_refused(run, change, place, value):
    arguments = {"style": "brisk", "path": circle(1.0), "foot_ik": False} | change
    with pytest.raises(InputError) as caught:
        generate_clip(run, **arguments)
    assert (caught.value.place, str(caught.value.value)) == (place, str(value))
