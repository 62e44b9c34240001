"""The sinusoid fit: exact on sinusoids, within its bounds, and never worse than an evolutionary search."""

from __future__ import annotations

import numpy as np
import pytest

from pfnn_jax.motion.clip import resample
from pfnn_jax.motion.datasets.labelled import load_clip
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.ground import wrap_angle
from pfnn_jax.motion.labels.local_phase import end_effectors, fit_axes, normalise_source, source_functions
from pfnn_jax.motion.labels.sinusoid import HIGHEST, LOWEST, Sinusoids, fit_sinusoids
from pfnn_jax.motion.synthetic.walks import synthesise

FPS, WIDTH = 60.0, 31
TIMES = (np.arange(WIDTH) - WIDTH // 2) / FPS
EXACT = 1e-6  # share of a window's range left by a fit whose steps stop at 1e-11 of the power
ROUNDING = 1e-14  # of the values themselves, where a window is constant but for rounding
INDIVIDUALS, ELITES, GENERATIONS = 50, 5, 10  # the published search


def sinusoids(seed: int, count: int, lowest: float = 0.8, highest: float = 3.8) -> tuple[np.ndarray, ...]:
    """(windows, amplitude, frequency, phase, offset) of sinusoids that lie within the bounds of their own windows."""
    rng = np.random.default_rng(seed)
    amplitude, frequency = rng.uniform(0.2, 3.0, 4 * count), rng.uniform(lowest, highest, 4 * count)
    phase, offset = rng.uniform(0, 2 * np.pi, 4 * count), rng.normal(size=4 * count)
    windows = curves(amplitude, frequency, phase, offset)
    inside = (amplitude <= np.ptp(windows, axis=1)) & (offset >= windows.min(axis=1)) & (offset <= windows.max(axis=1))
    keep = np.flatnonzero(inside)[:count]
    assert len(keep) == count
    return tuple(values[keep] for values in (windows, amplitude, frequency, phase, offset))


def curves(amplitude, frequency, phase, offset) -> np.ndarray:
    """[..., W] values of sinusoids with parameters [...]."""
    amplitude, frequency, phase, offset = (np.asarray(v)[..., None] for v in (amplitude, frequency, phase, offset))
    return amplitude * np.sin(2 * np.pi * frequency * TIMES + phase) + offset


def of(fit: Sinusoids) -> np.ndarray:
    return curves(fit.amplitude, fit.frequency, fit.phase, fit.offset)


def random_windows(seed: int, count: int) -> np.ndarray:
    """Noise, wandering lines, steps, spikes and ramps."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(count, WIDTH))
    step = (np.arange(WIDTH) > rng.integers(1, WIDTH - 1, (count, 1))).astype(float)
    spike = np.arange(WIDTH) == rng.integers(0, WIDTH, (count, 1))
    ramp = rng.normal(size=(count, 1)) * TIMES
    return np.concatenate([noise, np.cumsum(noise, axis=1), step, spike + 1e-3 * noise, ramp + 1e-2 * noise])


def evolve(windows: np.ndarray, seed: int) -> np.ndarray:
    """[N] root mean square error of an evolutionary search with the published population, on the same bounds.

    Individuals begin in the middle of the bounds and anywhere inside them; children mix two parents, go on in the
    direction in which the parents moved, and mutate by as much as their parents are worse than the best; the best few
    also try a step along each parameter.
    """
    rng, low, high = np.random.default_rng(seed), windows.min(axis=1), windows.max(axis=1)
    zero, one = np.zeros(len(windows)), np.ones(len(windows))
    lower = np.stack([zero, LOWEST * one, -np.pi * one, low], axis=-1)[:, None]
    upper = np.stack([high - low, HIGHEST * one, np.pi * one, high], axis=-1)[:, None]

    def errors(genes):
        rest = curves(*np.moveaxis(genes, -1, 0)) - windows[:, None]
        return np.sqrt(np.mean(rest**2, axis=-1))

    genes = lower + (upper - lower) * rng.random((len(windows), INDIVIDUALS, 4))
    genes[:, :1] = (lower + upper) / 2
    momentum = np.zeros_like(genes)
    for _ in range(GENERATIONS):
        genes, momentum, error = _sorted(genes, momentum, errors(genes))
        steps = rng.normal(0, 0.02, (len(windows), ELITES, 4)) * (upper - lower)
        tried = np.clip(genes[:, :ELITES] + steps, lower, upper)
        better = errors(tried) < error[:, :ELITES]
        genes[:, :ELITES] = np.where(better[..., None], tried, genes[:, :ELITES])
        # the better half are parents
        parents = rng.integers(0, INDIVIDUALS // 2, (2, len(windows), INDIVIDUALS - ELITES))
        row = np.arange(len(windows))[:, None]
        first, second = genes[row, parents[0]], genes[row, parents[1]]
        extinction = np.arange(ELITES, INDIVIDUALS)[None, :, None] / INDIVIDUALS
        chosen = rng.random(first.shape) < 0.25
        mutation = np.where(chosen, rng.uniform(-0.2, 0.2, first.shape) * extinction * (upper - lower), 0.0)
        share = rng.random(first.shape)
        pushed = rng.random(first.shape) * 0.5 * (momentum[row, parents[0]] + momentum[row, parents[1]])
        child = np.clip(share * first + (1 - share) * second + mutation + pushed, lower, upper)
        momentum[:, ELITES:] = child - first
        genes[:, ELITES:] = child
    return errors(genes).min(axis=1)


def _sorted(genes, momentum, error):
    order = np.argsort(error, axis=1)
    return (*(np.take_along_axis(v, order[..., None], axis=1) for v in (genes, momentum)), np.sort(error, axis=1))


def tolerance(windows: np.ndarray) -> np.ndarray:
    """[N] by how much an error may exceed a better one."""
    return EXACT * np.ptp(windows, axis=1) + ROUNDING * np.abs(windows).max(axis=1)


def real_windows(clips, count: int) -> np.ndarray:
    """Every source's windows of some clips, `count` of them evenly spread."""
    waves = []
    for clip in clips:
        ends = end_effectors(clip)
        for source in source_functions(ends, fit_axes([ends])).T:
            waves.append(np.lib.stride_tricks.sliding_window_view(normalise_source(source, clip.fps), WIDTH))
    windows = np.concatenate(waves)
    return windows[np.linspace(0, len(windows) - 1, count).astype(int)]


def test_a_sinusoid_is_recovered():
    windows, amplitude, frequency, phase, offset = sinusoids(0, 2000)
    fit = fit_sinusoids(windows, FPS)
    assert (fit.error <= EXACT * np.ptp(windows, axis=1)).all()
    # half a cycle shows little of frequency and amplitude apart: they are as well known as the error is small
    np.testing.assert_allclose(fit.frequency, frequency, atol=1e-3)
    np.testing.assert_allclose(fit.amplitude, amplitude, rtol=3e-3)
    np.testing.assert_allclose(fit.offset, offset, atol=1e-2)
    assert np.abs(wrap_angle(fit.phase - phase)).max() < 1e-2
    assert np.median(np.abs(wrap_angle(fit.phase - phase))) < 1e-6


def test_a_shift_in_time_moves_the_phase():
    amplitude, frequency, offset = np.ones(50), np.linspace(1.0, 3.0, 50), np.zeros(50)
    early = fit_sinusoids(curves(amplitude, frequency, np.full(50, 0.3), offset), FPS)
    late = fit_sinusoids(curves(amplitude, frequency, 0.3 + 2 * np.pi * frequency / FPS, offset), FPS)
    np.testing.assert_allclose(wrap_angle(late.phase - early.phase), 2 * np.pi * frequency / FPS, atol=1e-4)


@pytest.mark.parametrize("windows", [random_windows(1, 200), sinusoids(2, 200, 0.25, 4.0)[0]], ids=["random", "sine"])
def test_bounds_hold_and_the_error_is_the_residual(windows):
    fit = fit_sinusoids(windows, FPS)
    low, high = windows.min(axis=1), windows.max(axis=1)
    rounding = 1e-12 * (high - low)
    assert (fit.amplitude >= 0).all() and (fit.amplitude <= high - low + rounding).all()
    assert (fit.offset >= low - rounding).all() and (fit.offset <= high + rounding).all()
    assert (fit.frequency >= LOWEST).all() and (fit.frequency <= HIGHEST + 1e-12).all()
    left = np.sqrt(np.mean((of(fit) - windows) ** 2, axis=1))
    np.testing.assert_allclose(fit.error, left, atol=1e-7 * np.ptp(windows))  # the root of rounding in its square


def test_no_other_sinusoid_within_the_bounds_is_better():
    """Against a fine grid over all four parameters around the fit: the inner problem is solved, not approximated."""
    windows = random_windows(3, 40)
    fit, rng = fit_sinusoids(windows, FPS), np.random.default_rng(3)
    low, high = windows.min(axis=1, keepdims=True), windows.max(axis=1, keepdims=True)
    for scale in (1.0, 0.1, 0.01, 0.001):
        shape = (len(windows), 300)
        step = scale * rng.normal(size=(4, *shape))
        amplitude = np.clip(fit.amplitude[:, None] + step[0] * (high - low), 0, high - low)
        frequency = np.clip(fit.frequency[:, None] + step[1], LOWEST, HIGHEST)
        offset = np.clip(fit.offset[:, None] + step[3] * (high - low), low, high)
        other = curves(amplitude, frequency, fit.phase[:, None] + step[2], offset)
        error = np.sqrt(np.mean((other - windows[:, None]) ** 2, axis=-1)).min(axis=1)
        assert (fit.error <= error + EXACT * (high - low)[:, 0]).all()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_never_worse_than_the_published_search_on_random_windows(seed):
    windows = random_windows(10 + seed, 40)
    fit = fit_sinusoids(windows, FPS)
    assert (fit.error <= evolve(windows, seed) + tolerance(windows)).all()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_never_worse_than_the_published_search_on_procedural_motion(seed):
    clip, _ = synthesise("zombie", np.linspace(-0.5, 0.5, 400), np.full(400, 1.0), seed=seed)
    windows = real_windows([clip], 200)
    assert (fit_sinusoids(windows, FPS).error <= evolve(windows, seed) + tolerance(windows)).all()


def test_never_worse_than_the_published_search_on_real_motion(mocap):
    files = list_clips(mocap / "100style")[:2] + list_clips(mocap / "bandai-namco-2")[::80]
    windows = real_windows([resample(load_clip(file), FPS) for file in files], 600)
    error = fit_sinusoids(windows, FPS).error
    for seed in range(3):
        searched = evolve(windows, seed)
        assert (error <= searched + tolerance(windows)).all()
        assert error.mean() < 0.97 * searched.mean()  # the search stops on its way


def test_constant_windows_have_no_amplitude():
    fit = fit_sinusoids(np.array([[0.7] * WIDTH, [0.0] * WIDTH, [-1e9 / 3] * WIDTH]), FPS)
    assert (fit.amplitude == 0).all() and (fit.phase == 0).all() and (fit.error == 0).all()
    assert np.isfinite(fit.frequency).all()
    assert fit.offset.tolist() == [0.7, 0.0, -1e9 / 3]


def test_scale_and_offset_of_a_window_change_only_amplitude_and_offset():
    windows = random_windows(4, 50)
    fit, scaled = fit_sinusoids(windows, FPS), fit_sinusoids(8.0 * windows, FPS)  # a power of two: the same rounding
    np.testing.assert_array_equal(scaled.phase, fit.phase)
    np.testing.assert_array_equal(scaled.frequency, fit.frequency)
    np.testing.assert_allclose(scaled.amplitude, 8.0 * fit.amplitude, rtol=1e-12)


def test_the_same_windows_give_the_same_fit_alone_and_among_others():
    windows = random_windows(5, 700)  # more than one block
    fit, again, alone = fit_sinusoids(windows, FPS), fit_sinusoids(windows, FPS), fit_sinusoids(windows[:7], FPS)
    np.testing.assert_array_equal(fit.phase, again.phase)
    np.testing.assert_allclose(alone.error, fit.error[:7], atol=1e-8)


def test_no_windows_give_no_fits():
    assert fit_sinusoids(np.zeros((0, WIDTH)), FPS).phase.shape == (0,)


@pytest.mark.parametrize("shape", [(3, 30), (3, 3), (31,)])
def test_windows_must_have_a_centre(shape):
    with pytest.raises(ValueError, match="W odd and at least 5"):
        fit_sinusoids(np.zeros(shape), FPS)


def test_frequencies_are_checked():
    with pytest.raises(ValueError, match="lowest < highest"):
        fit_sinusoids(np.zeros((1, WIDTH)), FPS, 4.0, 1.0)
