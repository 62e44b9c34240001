"""The sinusoid that fits each of many short windows best: a search over frequency with the rest solved exactly.

The model of a window is A sin(2π F t + φ) + B with t = 0 at the window's centre. For a given frequency it is linear in
a = A cos φ, b = A sin φ and B. Around a centred time axis the sine is orthogonal to the cosine and to the constant, so
the least squares separate into numbers, and bounds on A and B leave a convex problem with one unknown multiplier.
What remains is one frequency per window: a grid, then a root of the derivative.

Source: the model and its bounds are those of Mason et al. 2022, section 4.1.4, after Starke et al. 2020, section 5.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LOWEST, HIGHEST = 0.25, 4.0
"""Hz: bounds of the frequency."""

GRID = 48  # frequencies: 0.08 Hz apart, where the error over half a second varies over about 1 Hz
NEWTON_STEPS = 6  # of the multiplier: each doubles the digits
NEAR = 0.01  # share of a window's power: minima this near to the best of the grid are refined too
REFINEMENTS = 4  # of the frequency, inside its bracket
BLOCK = 4096  # windows at a time, so that what they need stays in the processor's cache


@dataclass(frozen=True, eq=False)
class Sinusoids:
    """Fitted sinusoids A sin(2π F t + φ) + B, t = 0 at each window's centre.

    Attributes:
        amplitude: [N] A, in the windows' unit, between 0 and the window's range.
        frequency: [N] F in Hz.
        phase: [N] φ in radians, in [0, 2π).
        offset: [N] B, between the window's lowest and highest value.
        error: [N] root mean square of what is left.
    """

    amplitude: np.ndarray
    frequency: np.ndarray
    phase: np.ndarray
    offset: np.ndarray
    error: np.ndarray


@dataclass(frozen=True, eq=False)
class _Windows:
    """What the fit reads of windows [N, W]: sums and differences around the centre, and bounds."""

    even: np.ndarray  # [N, h + 1] centre, then y(t) + y(-t)
    odd: np.ndarray  # [N, h] y(t) - y(-t)
    mean: np.ndarray  # [N]
    low: np.ndarray  # [N]
    high: np.ndarray  # [N]
    power: np.ndarray  # [N] sum of squares around the mean


def fit_sinusoids(windows: np.ndarray, fps: float, lowest: float = LOWEST, highest: float = HIGHEST) -> Sinusoids:
    """Best sinusoid of every window within the bounds: 0 <= A <= max - min, min <= B <= max, lowest <= F <= highest.

    Deterministic. A constant window has amplitude and phase 0.

    Args:
        windows: [N, W] values at equal times, W odd and at least 5.
        fps: values per second.
        lowest, highest: Hz.

    Raises:
        ValueError: if W is even or too small.
    """
    windows = np.asarray(windows, dtype=float)
    if windows.ndim != 2 or windows.shape[1] < 5 or windows.shape[1] % 2 == 0:
        raise ValueError(f"windows must be [N, W] with W odd and at least 5, got {windows.shape}.")
    parts = [_fit_block(windows[i : i + BLOCK], fps, lowest, highest) for i in range(0, len(windows), BLOCK)]
    names = Sinusoids.__dataclass_fields__
    if not parts:
        return Sinusoids(**{name: np.zeros(0) for name in names})
    return Sinusoids(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def _fit_block(windows: np.ndarray, fps: float, lowest: float, highest: float) -> Sinusoids:
    data, times = _read(windows), np.arange(1, windows.shape[1] // 2 + 1) / fps
    grid = np.linspace(lowest, highest, GRID)
    window, start = _starts(data, _grid_errors(data, times, grid))
    below, above = grid[np.maximum(start - 1, 0)], grid[np.minimum(start + 1, GRID - 1)]
    frequency, (a, b, offset, error) = _refine(_take(data, window), times, below, grid[start], above)
    best = _best_of_each(window, error)
    a, b, offset, error = a[best], b[best], offset[best], error[best]
    rms = np.sqrt(np.maximum(error, 0.0) / windows.shape[1])
    return Sinusoids(np.hypot(a, b), frequency[best], np.arctan2(b, a) % (2 * np.pi), data.mean + offset, rms)


def _read(windows: np.ndarray) -> _Windows:
    half = windows.shape[1] // 2
    low, high = windows.min(axis=1), windows.max(axis=1)
    mean = np.clip(windows.mean(axis=1), low, high)  # exact where the window is constant
    centred = windows - mean[:, None]
    after, before = centred[:, half + 1 :], centred[:, half - 1 :: -1] if half > 0 else centred[:, :0]
    even = np.concatenate([centred[:, half : half + 1], after + before], axis=1)
    return _Windows(even, after - before, mean, low - mean, high - mean, np.einsum("nw,nw->n", centred, centred))


def _take(data: _Windows, index: np.ndarray) -> _Windows:
    return _Windows(*(getattr(data, name)[index] for name in _Windows.__dataclass_fields__))


def _sums(times: np.ndarray, frequency: np.ndarray) -> tuple[np.ndarray, ...]:
    """Over a window: sum of sin², of cos² and of cos, at frequencies [...]; and the angles [..., h] after the centre."""
    angle = 2 * np.pi * frequency[..., None] * times
    sin, cos = np.sin(angle), np.cos(angle)
    return 2 * np.sum(sin**2, -1), 1 + 2 * np.sum(cos**2, -1), 1 + 2 * np.sum(cos, -1), sin, cos


def _grid_errors(data: _Windows, times: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """[N, G] squared error of every window at every frequency; infinite where it cannot be near the best.

    Without bounds the error is two projections. Bounds can only add to it, so frequencies whose unbounded error is
    above the best error within bounds need no exact solution.
    """
    sum_sin, sum_cos, total, sin, cos = _sums(times, grid)
    count = 2 * len(times) + 1
    p_sin, p_cos = data.odd @ sin.T, data.even[:, :1] + data.even[:, 1:] @ cos.T
    free = sum_cos - total**2 / count
    a, b = p_sin / sum_sin, p_cos / free
    error = data.power[:, None] - a * p_sin - b * p_cos
    offset = b * (-total / count)
    reach = (data.high - data.low)[:, None]
    outside = (a * a + b * b > reach * reach) | (offset < data.low[:, None]) | (offset > data.high[:, None])
    bound = np.where(outside, np.inf, error).min(axis=1) + NEAR * data.power
    rows, columns = np.nonzero(outside & (error <= bound[:, None]))
    error[outside] = np.inf
    sums = sum_sin[columns], sum_cos[columns], total[columns]
    error[rows, columns] = _solve(_take(data, rows), p_sin[rows, columns], p_cos[rows, columns], sums, count)[3]
    return error


def _solve(data: _Windows, p_sin: np.ndarray, p_cos: np.ndarray, sums: tuple, count: int) -> tuple[np.ndarray, ...]:
    """(a, b, offset, squared error) [N] of the best sinusoid of a given frequency within the bounds.

    The best error as a function of the offset is convex, so where the best offset lies outside its bounds, the nearest
    bound is best.
    """
    sum_sin, sum_cos, total = sums
    reach = data.high - data.low
    a, b = _within(p_sin, p_cos, sum_sin, sum_cos - total**2 / count, reach)
    best = -b * total / count
    offset = np.clip(best, data.low, data.high)
    held = np.flatnonzero(offset != best)
    if len(held):
        shifted = p_cos[held] - offset[held] * total[held]
        a[held], b[held] = _within(p_sin[held], shifted, sum_sin[held], sum_cos[held], reach[held])
    error = data.power - 2 * (a * p_sin + b * p_cos) + a * a * sum_sin + b * b * sum_cos
    return a, b, offset, error + offset * (offset * count + 2 * b * total)


def _within(p: np.ndarray, q: np.ndarray, g: np.ndarray, h: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, ...]:
    """(a, b) minimising g a² - 2 p a + h b² - 2 q b inside the circle a² + b² <= reach².

    On the circle a = p / (g + m), b = q / (h + m) with one multiplier m > 0, found by Newton's method on
    1 / radius(m), which rises from below the solution without passing it.
    """
    a, b = p / g, q / h
    out = np.flatnonzero(a * a + b * b > reach * reach)
    if len(out):
        a[out], b[out] = _on_circle(p[out], q[out], g[out], h[out], reach[out])
    return a, b


def _on_circle(p: np.ndarray, q: np.ndarray, g: np.ndarray, h: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, ...]:
    m = np.maximum(np.maximum(np.abs(p) / reach - g, np.abs(q) / reach - h), 0.0)
    for _ in range(NEWTON_STEPS):
        a, b = p / (g + m), q / (h + m)
        square = a * a + b * b
        slope = a * a / (g + m) + b * b / (h + m)
        m = m + (np.sqrt(square) / reach - 1.0) * square / slope
    a, b = p / (g + m), q / (h + m)
    scale = reach / np.hypot(a, b)
    return a * scale, b * scale


def _starts(data: _Windows, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(window, frequency index) of each local minimum over the grid that may hold the window's best."""
    wall = np.full((len(error), 1), np.inf)
    left, right = np.concatenate([wall, error[:, :-1]], 1), np.concatenate([error[:, 1:], wall], 1)
    bound = error.min(axis=1) + NEAR * data.power
    return np.nonzero((error <= left) & (error < right) & (error <= bound[:, None]))


def _refine(data: _Windows, times: np.ndarray, low: np.ndarray, start: np.ndarray, high: np.ndarray) -> tuple:
    """Frequency [N] of least error between `low` and `high`, from `start`, and what `_solve` returns there.

    The derivative of the best error by frequency is that at fixed a, b and offset, since the bounds do not depend on
    frequency; its root is found by the secant rule inside a bracket.
    """
    frequency, slopes = start, None
    best_f, best, last = start, None, None
    for _ in range(REFINEMENTS + 1):
        fit, slope = _evaluate(data, times, frequency)
        if best is None:
            best = fit
        better = fit[3] < best[3]
        best_f = np.where(better, frequency, best_f)
        best = tuple(np.where(better, new, old) for new, old in zip(fit, best, strict=True))
        low, high = np.where(slope < 0, frequency, low), np.where(slope > 0, frequency, high)
        following = 0.5 * (low + high)
        if last is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                secant = frequency - slope * (frequency - last) / (slope - slopes)
            following = np.where((secant > low) & (secant < high), secant, following)
        last, slopes, frequency = frequency, slope, following
    return best_f, best


def _evaluate(data: _Windows, times: np.ndarray, frequency: np.ndarray) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    sum_sin, sum_cos, total, sin, cos = _sums(times, frequency)
    dot = "nk,nk->n"
    p_sin, p_cos = np.einsum(dot, data.odd, sin), data.even[:, 0] + np.einsum(dot, data.even[:, 1:], cos)
    fit = _solve(data, p_sin, p_cos, (sum_sin, sum_cos, total), 2 * len(times) + 1)
    a, b, offset, _ = fit
    t_sin, t_cos = times * sin, times * cos
    along = a * (np.einsum(dot, data.odd, t_cos) - 2 * a * np.einsum(dot, sin, t_cos))
    across = b * (
        np.einsum(dot, data.even[:, 1:], t_sin) - 2 * b * np.einsum(dot, cos, t_sin) - 2 * offset * t_sin.sum(1)
    )
    return fit, across - along


def _best_of_each(window: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Index of the least error of each window; candidates of one window stand together."""
    order = np.lexsort((error, window))
    return order[np.flatnonzero(np.diff(window[order], prepend=-1))]
