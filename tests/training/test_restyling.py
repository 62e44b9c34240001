"""Restyled rows: what they keep of known styles, what they take from the new one, and how differences are shared."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.motion.clip import mirror_clip
from pfnn_jax.motion.features.encode import Features, clip_features, join_rows
from pfnn_jax.motion.features.layout import FrameLayout, mason2018, mason2022
from pfnn_jax.motion.features.normaliser import Normaliser, Statistics, fit_normaliser
from pfnn_jax.motion.labels.phase import PhaseLabels, mirror_phase
from pfnn_jax.motion.synthetic.styles import STYLES
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.training.data import Batch, to_batch
from pfnn_jax.training.restyling import (
    HARMONICS,
    RIDGE,
    StyleDifferences,
    find_differences,
    fit_mean_row,
    fourier_basis,
    joint_scale,
    joint_shares,
    load_differences,
    mean_row,
    restyle,
    save_differences,
    speed_scale,
)

FLOAT32 = 2e-5
"""Normalised rows of a few standard deviations are stored in single precision."""

HALF = 2.0**-11
"""Rounding of half precision relative to a value."""

ON_A_CIRCLE = 0.03
"""Metres. The trajectory is that of a body whose hips sway and whose chest twists more at a higher speed; unscaled, it
would be off by 0.15 m."""

NEARER = 0.7
"""Share of the way between straight walks and turns of a style that turns of two other styles leave, at most."""

LAYOUT = mason2018(2)
SIZE = LAYOUT.input_size + LAYOUT.output_size


def random_coefficients(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(1 + 2 * HARMONICS, SIZE))


def rows_of(values: np.ndarray, phase: np.ndarray) -> Batch:
    x, y = np.split(values.astype(np.float32), [LAYOUT.input_size], axis=1)
    return Batch(x, y, phase.astype(np.float32))


def values(rows: Batch | StyleDifferences) -> np.ndarray:
    return np.concatenate([rows.x, rows.y], axis=1)


def identity() -> Normaliser:
    """Returns a normaliser that changes nothing."""
    one = [Statistics(np.zeros(n, np.float32), np.ones(n, np.float32)) for n in (LAYOUT.input_size, LAYOUT.output_size)]
    return Normaliser(*one)


def test_the_mean_row_of_a_fourier_series_is_that_series():
    mean, phase = random_coefficients(0), np.linspace(0, 2 * np.pi, 400, endpoint=False)
    found = fit_mean_row(rows_of(mean_row(mean, phase), phase))
    # The penalty shrinks a harmonic by at most its own size relative to the mean square of the basis, a half.
    np.testing.assert_allclose(found, mean, atol=4 * RIDGE * np.abs(mean).max())


def test_the_mean_over_the_cycle_is_not_penalised():
    phase = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    found = fit_mean_row(rows_of(np.full((400, SIZE), 100.0), phase))
    np.testing.assert_allclose(found[0], 100.0, rtol=FLOAT32)


def test_the_basis_repeats_after_a_gait_cycle():
    phase = np.linspace(0, 2 * np.pi, 7)
    np.testing.assert_allclose(fourier_basis(phase), fourier_basis(phase + 2 * np.pi), atol=1e-12)


def test_without_differences_a_restyled_row_is_the_mean_row_of_the_clip():
    phase = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    clip = rows_of(mean_row(random_coefficients(0), phase), phase)
    at = phase[::7].astype(np.float32)
    x, y = (np.zeros((len(at), n), np.float32) for n in (LAYOUT.input_size, LAYOUT.output_size))
    none = StyleDifferences(x, y, at)
    restyled = restyle(none, clip, LAYOUT, identity())
    np.testing.assert_allclose(values(restyled), mean_row(fit_mean_row(clip), at), atol=FLOAT32)
    np.testing.assert_array_equal(restyled.phase, at)


def test_restyled_rows_differ_by_the_differences_at_the_speed_of_the_clip():
    phase = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    mean = np.zeros((1 + 2 * HARMONICS, SIZE))
    mean[0, LAYOUT.input_size + np.arange(LAYOUT.output_size)[LAYOUT.output_slice("root_velocity")]] = 0.9, 1.2
    clip = rows_of(mean_row(mean, phase), phase)  # 1.5 metres per second
    rows = rows_of(np.random.default_rng(1).normal(size=(50, SIZE)), phase[:50])
    none = StyleDifferences(np.zeros_like(rows.x), np.zeros_like(rows.y), rows.phase)
    found = values(restyle(StyleDifferences(rows.x, rows.y, rows.phase), clip, LAYOUT, identity()))
    expected = values(restyle(none, clip, LAYOUT, identity())) + speed_scale(LAYOUT, 1.5) * values(rows)
    np.testing.assert_allclose(found, expected, atol=FLOAT32)


def walk(style: str, rates: tuple[float, ...], speed: float, frames: int = 300) -> Features:
    """Returns rows of procedural walks at turn rates in radians per second, with their mirror images."""
    parts = []
    for rate in rates:
        clip, labels = synthesise(style, np.full(frames, rate), np.full(frames, speed))
        layout = mason2018(clip.skeleton.num_joints)
        parts.append(clip_features(clip, layout, labels))
        parts.append(clip_features(mirror_clip(clip), layout, mirror_phase(labels)))
    return join_rows(parts)


@pytest.fixture(scope="module")
def procedural() -> tuple[dict[str, Features], FrameLayout, Normaliser]:
    """Returns straight and circular walks of three styles."""
    names = ("neutral", *[name for name in STYLES if name != "neutral"][:2])
    styles = {name: walk(name, (0.0, 0.8), STYLES[name].speed) for name in names}
    layout = mason2018((styles["neutral"].x.shape[1] - 48) // 6)
    parts = list(styles.values())
    return styles, layout, fit_normaliser([p.x for p in parts], [p.y for p in parts], layout, grouped=True)


def test_a_style_that_is_restyled_as_itself_keeps_the_turns_it_shares_with_others(procedural):
    """The restyled rows of the other styles are nearer to a style's own circle than its straight walk is."""
    styles, layout, normaliser = procedural
    new = "neutral"
    known = {name: rows for name, rows in styles.items() if name != new}
    differences = find_differences(known, layout, normaliser)
    assert differences is not None
    straight = to_batch([walk(new, (0.0,), STYLES[new].speed)], normaliser)
    circle = to_batch([walk(new, (0.8,), STYLES[new].speed)], normaliser)
    restyled = restyle(differences, straight, layout, normaliser)
    left = np.asarray(normaliser.outputs.invert(restyled.y))[:, layout.output_slice("root_yaw_rate")][:, 0] > 0.4
    true_left = np.asarray(normaliser.outputs.invert(circle.y))[:, layout.output_slice("root_yaw_rate")][:, 0] > 0.4
    turned = fit_mean_row(Batch(restyled.x[left], restyled.y[left], restyled.phase[left]))
    truth = fit_mean_row(Batch(circle.x[true_left], circle.y[true_left], circle.phase[true_left]))
    positions = layout.input_size + np.arange(layout.output_size)[layout.output_slice("joint_position")]
    off = np.abs(turned - truth)[:, positions].sum()
    assert off < NEARER * np.abs(fit_mean_row(straight) - truth)[:, positions].sum()


def test_styles_without_turns_show_no_differences(procedural):
    _, layout, normaliser = procedural
    assert find_differences({"neutral": walk("neutral", (0.0,), 1.2)}, layout, normaliser) is None


def test_steps_aside_are_no_straight_walk(procedural):
    styles, layout, normaliser = procedural
    rows, columns = styles["neutral"], layout.output_slice("root_velocity")
    aside = replace(rows, y=rows.y.copy())
    aside.y[:, columns] = rows.y[:, columns][:, ::-1]  # what went ahead goes to the left
    alone, both = ({"neutral": part} for part in (rows, join_rows([rows, aside])))
    first, second = (find_differences(part, layout, normaliser, count=10**6) for part in (alone, both))
    assert first is not None and second is not None
    assert len(second.phase) == len(first.phase) + len(rows.x)


def test_layouts_without_a_global_phase_have_no_differences(procedural):
    styles, _, normaliser = procedural
    assert find_differences(styles, mason2022(25), normaliser) is None


def test_every_style_gives_equally_many_rows_and_the_seed_chooses_them(procedural):
    styles, layout, normaliser = procedural
    first, again, other = (find_differences(styles, layout, normaliser, count=90, seed=seed) for seed in (0, 0, 1))
    assert first is not None and again is not None and other is not None
    assert len(first.phase) == 90
    np.testing.assert_array_equal(first.x, again.x)
    assert not np.array_equal(first.x, other.x)


def test_saved_differences_are_those_saved_in_half_precision(tmp_path: Path, procedural):
    styles, layout, normaliser = procedural
    found = find_differences(styles, layout, normaliser, count=64)
    assert found is not None and load_differences(tmp_path, layout) is None
    (tmp_path / "config.json").touch()  # what makes a folder a run to save in
    save_differences(tmp_path, found)
    loaded = load_differences(tmp_path, layout)
    assert loaded is not None
    np.testing.assert_allclose(values(loaded), values(found), rtol=HALF, atol=1e-6)
    np.testing.assert_allclose(loaded.phase, found.phase, rtol=HALF)


def on_a_circle(speed: float, rate: float) -> tuple[FrameLayout, np.ndarray]:
    """Returns the trajectory columns of the middle row of a walk on a circle, mean over a gait cycle."""
    frames = 240
    clip, labels = synthesise("neutral", np.full(frames, rate), np.full(frames, speed))
    layout = mason2018(clip.skeleton.num_joints)
    steady = PhaseLabels(labels.phase, np.ones(frames, bool), labels.contacts_right, labels.contacts_left)
    rows = clip_features(clip, layout, steady)
    path = [name.startswith("trajectory_") for name in layout.input_names]
    return layout, rows.x[100:140][:, path].mean(axis=0)


def test_a_circle_at_another_speed_is_the_scaled_difference_from_straight():
    rate, slow, fast = 0.8, 0.8, 1.2
    layout, circle = on_a_circle(slow, rate)
    straight, other_straight = on_a_circle(slow, 0.0)[1], on_a_circle(fast, 0.0)[1]
    path = [name.startswith("trajectory_") for name in layout.input_names]
    scale = speed_scale(layout, fast / slow)[: layout.input_size][path]
    restyled = other_straight + scale * (circle - straight)
    np.testing.assert_allclose(restyled, on_a_circle(fast, rate)[1], atol=ON_A_CIRCLE / layout.length_unit)


def test_turns_that_all_styles_make_alike_are_shared_in_full():
    difference = random_coefficients(0)
    np.testing.assert_allclose(joint_shares(LAYOUT, np.stack([difference] * 3)), 1.0, atol=1e-9)


def test_turns_that_styles_make_in_opposite_ways_are_not_shared():
    difference = random_coefficients(0)
    np.testing.assert_array_equal(joint_shares(LAYOUT, np.stack([difference, -difference])), 0.0)


def test_joints_are_shared_one_by_one():
    first, second = random_coefficients(0), random_coefficients(0)
    columns = LAYOUT.input_size + np.arange(LAYOUT.output_size)[LAYOUT.output_slice("joint_position")]
    second[:, columns[3:]] *= -1.0  # joint 1
    np.testing.assert_allclose(joint_shares(LAYOUT, np.stack([first, second])), [1.0, 0.0], atol=1e-9)


def test_one_style_keeps_its_differences_whole():
    np.testing.assert_array_equal(joint_shares(LAYOUT, random_coefficients(0)[None]), 1.0)


def test_shares_of_joints_stand_at_their_columns():
    scale = joint_scale(LAYOUT, np.array([0.25, 0.5]))
    sides = (
        (scale[: LAYOUT.input_size], LAYOUT.input_blocks, LAYOUT.input_slice),
        (scale[LAYOUT.input_size :], LAYOUT.output_blocks, LAYOUT.output_slice),
    )
    for part, blocks, columns in sides:
        for name in blocks:
            found = part[columns(name)]
            shares = np.repeat([0.25, 0.5], len(found) // 2) if name.startswith("joint_") else 1.0
            np.testing.assert_array_equal(found, shares)
