"""The released local-phase network: golden rows match, rollouts match the authors' loop, bad files are named."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control.generation import clip_from_frames, loop_frames
from pfnn_jax.control.loop.state import ROOT, initial_state, straight_row
from pfnn_jax.control.loop.step import Command, published_step
from pfnn_jax.control.run_settings import default_speed, loop_config
from pfnn_jax.inference.mixture import load_bank
from pfnn_jax.inference.predictor import evaluate, make_predictor
from pfnn_jax.inference.rows import RowStyles, predict_file, predict_rows
from pfnn_jax.interop.released.files import read_array, read_statistics
from pfnn_jax.interop.released.mason2022 import STYLES, import_released_lpn
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.models.network import num_parameters
from pfnn_jax.motion.ground import turn_towards
from pfnn_jax.motion.paths import circle
from pfnn_jax.run_config import list_styles, style_note
from tests.raising import assert_refused

# Standard deviations of the outputs: float32 differs from the float64 goldens by 5e-6.
GOLDEN = 1e-4
# Metres and radians after one second: rounding errors of float32 have grown a hundredfold by then.
SECOND = 1e-4
# Drunk, whose published vector is broken, and three that hop, which stand still from this start.
NOT_WALKING = (23, 41, 65, 86)
NUM_FRAMES, SETTLED = 720, 120
NEAR, AT_LEAST = 0.1, 90
METRES_OF_BONES = 0.02


@pytest.fixture(scope="module")
def bank(lpn_run):
    return jax.tree.map(jnp.asarray, load_bank(lpn_run, lpn_run.config.styles))


def test_run_is_complete(lpn_run):
    assert set(list_styles(lpn_run.path)) == set(STYLES) and len(STYLES) == 100
    assert num_parameters(lpn_run.shared) == 4_935_928
    assert STYLES[23] == "Drunk" and STYLES[57] == "PendulumHands" and STYLES[94:96] == ("Zombie", "HandsInPockets")
    assert lpn_run.layout.ends == (16, 11, 24, 20)
    assert style_note(lpn_run.path, "Old")["adapter"]["kind"] == "film"
    assert default_speed(lpn_run, None) == default_speed(lpn_run, {"Old": 0.5, "Cat": 0.5}) == 1.0


def test_skeleton_has_the_bones_of_the_rollouts(lpn_run, reference):
    expected = json.loads((reference / "lpn_rollout_metrics.json").read_text())["bone_median"]
    lengths = np.linalg.norm(lpn_run.skeleton.offsets[1:], axis=1)
    np.testing.assert_allclose(lengths, expected, atol=METRES_OF_BONES)
    assert lpn_run.skeleton.mirror[16] == 11


@pytest.mark.parametrize(("layer_norm", "name"), [("population", "y"), ("sample", "y_train_ln")])
def test_golden_rows(lpn_run, reference, tmp_path, layer_norm, name):
    file = reference / "lpn_golden_dev.npz"
    y = predict_file(lpn_run.path, file, tmp_path / "y.npz", layer_norm=layer_norm)
    assert np.load(tmp_path / "y.npz")["y"].shape == (128, 342)
    error = np.abs(y - np.load(file)[name]) / lpn_run.normaliser.outputs.std
    assert error.max() < GOLDEN


def test_golden_mixtures(lpn_run, reference, tmp_path):
    file = reference / "lpn_golden_mix_dev.npz"
    y = predict_file(lpn_run.path, file, tmp_path / "y.npz")
    golden = np.load(file)
    assert (np.abs(y - golden["y"]) / lpn_run.normaliser.outputs.std).max() < GOLDEN
    # The same mixture by name.
    names = dict(zip((STYLES[i] for i in golden["styles"][0]), golden["weights"][0].tolist(), strict=True))
    one = predict_rows(lpn_run, golden["x"][:1], golden["gating_x"][:1], names)
    np.testing.assert_allclose(one, y[:1], atol=GOLDEN)


def test_default_style_is_the_mean_of_all_styles(lpn_run, bank):
    style = make_predictor(lpn_run).style
    assert isinstance(style, FiLMStyle)
    mean = style.to_vector()
    np.testing.assert_allclose(mean, jnp.mean(jax.vmap(FiLMStyle.to_vector)(bank), axis=0), atol=1e-4)


@pytest.mark.parametrize(
    ("change", "place", "value"),
    [
        ({"weights": [[0.5, 0.3, 0.1]]}, "array weights, row 0", "0.5 + 0.3 + 0.1 = 0.9"),
        ({"styles": [[0, 1, 100]]}, "array styles, row 0", 100),
        ({"styles": [[0.0, 1.0, 2.0]]}, "array styles", "float64"),
        ({"weights": [[0.5, 0.5]]}, "array weights", "shape (1, 2)"),
        ({"gating_x": [[0.0] * 7]}, "array gating_x", "shape (1, 7)"),
    ],
)
def test_bad_rows_are_refused(lpn_run, tmp_path, change, place, value):
    rows = {"x": np.zeros((1, 348)), "gating_x": np.zeros((1, 8)), "styles": [[0, 1, 2]], "weights": [[0.5, 0.3, 0.2]]}
    x, gating_x, styles, weights = (np.asarray((rows | change)[name]) for name in rows)
    np.savez(tmp_path / "in.npz", x=x, gating_x=gating_x, styles=styles, weights=weights)
    predicting = partial(predict_file, lpn_run.path, tmp_path / "in.npz", tmp_path / "out.npz")
    assert_refused(predicting, place=place, value=value)
    assert not (tmp_path / "out.npz").exists()


def test_tables_need_a_global_phase(lpn_run):
    styles = RowStyles(np.zeros((1, 1), int), np.ones((1, 1)))
    predicting = partial(predict_rows, lpn_run, np.zeros((1, 348)), np.zeros((1, 8)), styles, "nearest50")
    assert_refused(predicting, place="mode", value="nearest50")


def test_file_of_wrong_size_is_named(tmp_path):
    (tmp_path / "cp0_a3.bin").write_bytes(bytes(12))
    file, absent = tmp_path / "cp0_a3.bin", tmp_path / "nowhere"
    assert_refused(lambda: read_array(file, (512, 348)), file="cp0_a3.bin", place="size", value="12 bytes")
    assert_refused(lambda: read_statistics(tmp_path, "X", 348), file="Xmean.bin", place="file")
    assert_refused(lambda: import_released_lpn(absent, tmp_path / "run"), file="nowhere", place="directory")
    assert not (tmp_path / "run").exists()


def reference_rollout(run, style, num_frames):
    """Rolls out the authors' loop without turning: the target follows the facing, and the velocity the target."""
    predictor, config = replace_style(run, style), loop_config(run)
    x = straight_row(run.layout, predictor.input_mean, 1.0)
    assert predictor.gating_mean is not None
    start = initial_state(run.layout, x, predictor.gating_mean, jnp.zeros(2), jnp.zeros(()))
    start = replace(start, target_velocity=jnp.zeros(2))

    def frame(state, _):
        facing = state.directions[ROOT]
        course = turn_towards(state.target_direction, facing, config.direction_rate)
        command = Command(velocity=course, direction=facing)
        after, y = published_step(partial(evaluate, predictor), run.layout, state, command, config)
        return after, (y, after.positions[ROOT], after.directions[ROOT], after.joint_positions, after.phase)

    return jax.lax.scan(frame, start, length=num_frames)[1]


def replace_style(run, style):
    return replace(make_predictor(run, "Neutral"), style=style)


def test_first_second_equals_the_authors_loop(lpn_run, bank, reference):
    recorded = np.load(reference / "lpn_rollout_ref.npz")
    some = jax.tree.map(lambda leaf: leaf[recorded["styles"]], bank)
    y, *found = jax.jit(jax.vmap(partial(reference_rollout, lpn_run, num_frames=60)))(some)
    np.testing.assert_allclose(y[:, 0], recorded["y0"], atol=SECOND)
    for name, values in zip(("root_xz", "root_dir", "joint_world", "phi"), found, strict=True):
        tolerance = 10 * SECOND if name == "phi" else SECOND  # local phases are of size 5
        np.testing.assert_allclose(values, recorded[name][:, :60], atol=tolerance, err_msg=name)


def test_styles_walk_as_under_the_authors_loop(lpn_run, bank, reference):
    metrics = json.loads((reference / "lpn_rollout_metrics.json").read_text())["metrics"]
    rollouts = jax.jit(jax.vmap(partial(reference_rollout, lpn_run, num_frames=NUM_FRAMES)))(bank)
    y, roots, facing, joints, _ = (np.asarray(values)[:, SETTLED:] for values in rollouts)
    assert np.isfinite(y).all() and np.isfinite(joints).all()
    walking = [style for style in range(len(STYLES)) if style not in NOT_WALKING]
    near = 0
    for style in walking:
        speed = np.linalg.norm(np.diff(roots[style], axis=0), axis=1).mean() * lpn_run.layout.fps
        cadence = 120.0 / stride_seconds(joints[style][:, [20, 24]], roots[style], facing[style])
        expected = metrics[style]["speed"], metrics[style]["steps_per_min"]
        near += np.abs(np.array([speed, cadence]) / expected - 1.0).max() < NEAR
        assert alternates(y[style][:, lpn_run.layout.output_slice("foot_contacts")]), STYLES[style]
    assert near >= AT_LEAST


def stride_seconds(toes, roots, facing) -> float:
    """Returns the period in seconds of the toes' height and motion along the heading, relative to the root."""
    ahead = ((toes[..., [0, 2]] - roots[:, None]) * facing[:, None]).sum(-1)
    signal = np.concatenate([ahead, toes[..., 1]], axis=1)
    signal = signal - signal.mean(axis=0)
    count = len(signal)
    repeats = np.array(
        [
            (signal[: count - lag] * signal[lag:]).sum()
            / np.sqrt((signal[: count - lag] ** 2).sum() * (signal[lag:] ** 2).sum())
            for lag in range(200)
        ]
    )
    peaks = [lag for lag in range(24, 199) if repeats[lag - 1] < repeats[lag] >= repeats[lag + 1]]
    best = max(repeats[peaks])
    return next(lag for lag in peaks if repeats[lag] > best - 0.05) / 60.0


def alternates(contacts) -> bool:
    """Returns whether the onsets of the right and left contacts [T, 2] alternate."""
    onsets = np.argwhere((contacts[1:] > 0.5) & (contacts[:-1] <= 0.5))
    feet = onsets[np.argsort(onsets[:, 0], kind="stable"), 1]
    return len(feet) > 2 and bool((np.diff(feet) != 0).all())


def test_generated_mixture_follows_a_circle(lpn_run):
    style = {"Neutral": 0.5, "Old": 0.3, "Zombie": 0.2}
    predictor, speed = make_predictor(lpn_run, style), default_speed(lpn_run, style)
    loop = loop_config(lpn_run)
    frames = loop_frames(predictor, circle(2.0), lpn_run, speed=speed, seconds=3.0, loop=loop)
    assert float(np.asarray(frames.path_distance).max()) < 0.5
    turned = np.unwrap(np.asarray(frames.root_yaw))
    assert len(turned) == 180 and turned[-1] - turned[0] > 0.7
    clip = clip_from_frames(lpn_run.skeleton, lpn_run.layout, frames)
    assert 0.8 < clip.root_positions[:, 1].mean() < 1.1
