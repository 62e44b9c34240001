"""Fits the best sinusoid to each of many short windows: a search over frequency, with the rest solved exactly.

The model of a window is A sin(2π F t + φ) + B with t = 0 at the window's centre. For a given frequency it is linear in
a = A cos φ, b = A sin φ and B. On a centred time axis the sine is orthogonal to the cosine and to the constant, so that
the least-squares problem separates into scalar ones, and the bounds on A and B leave a convex problem with a single
multiplier. What remains is one frequency per window: a grid search, then a root of the derivative.

Source: the model and its bounds are those of Mason et al. 2022, section 4.1.4, after Starke et al. 2020, section 5.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LOWEST, HIGHEST = 0.25, 4.0
"""Bounds of the frequency in Hz."""

GRID = 48  # frequencies, 0.08 Hz apart: the error over half a second varies on a scale of about 1 Hz
NEAR = 0.01  # share of a window's power: minima within this of the best on the grid are refined too
REFINEMENTS = 24  # maximum number of steps of the frequency; few windows need more than four
ENOUGH = 1e-11  # share of a window's power: a window is done when a step could gain less
FEWER = 0.7  # unfinished windows are copied out when they are fewer than this share
NEWTON_STEPS = 5  # of the multiplier; each doubles the number of correct digits
BLOCK = 2048  # windows at a time, so that their data stays in the processor's cache


@dataclass(frozen=True, eq=False)
class Sinusoids:
    """Fitted sinusoids A sin(2π F t + φ) + B, t = 0 at each window's centre.

    Attributes:
        amplitude: [N] A, in the windows' unit, between 0 and the window's range.
        frequency: [N] F in Hz.
        phase: [N] φ in radians, in [0, 2π).
        offset: [N] B, between the window's lowest and highest value.
        error: [N] root mean square of the residual.
    """

    amplitude: np.ndarray
    frequency: np.ndarray
    phase: np.ndarray
    offset: np.ndarray
    error: np.ndarray


@dataclass(frozen=True, eq=False)
class _Windows:
    """Data of windows [N, W] with W = 2h + 1, minus their means: the halves are folded around the centre."""

    odd: np.ndarray  # [h, N] y(t) - y(-t): the part that a sine can fit
    even: np.ndarray  # [h, N] y(t) + y(-t): the part that a cosine can fit
    centre: np.ndarray  # [N] y(0)
    mean: np.ndarray  # [N]
    low: np.ndarray  # [N] lowest value, minus the mean
    high: np.ndarray  # [N] highest value, minus the mean
    power: np.ndarray  # [N] sum of squares

    def take(self, index: np.ndarray) -> _Windows:
        return _Windows(*(getattr(self, name)[..., index] for name in self.__dataclass_fields__))


@dataclass(frozen=True, eq=False)
class _Bounds:
    """Bounds of N fits: the fields of `_Windows` that `_solve` reads."""

    low: np.ndarray
    high: np.ndarray
    power: np.ndarray


@dataclass(frozen=True, eq=False)
class _Gram:
    """Sums over a window of products of sine, cosine and constant, at an angular frequency in radians per sample."""

    sin: np.ndarray  # of sin²
    cos: np.ndarray  # of cos²
    total: np.ndarray  # of cos; the sums of sin and of sin cos are zero
    count: int

    @property
    def free(self) -> np.ndarray:
        """Sum of squares of the cosine minus its mean."""
        return self.cos - self.total**2 / self.count

    def take(self, index: np.ndarray) -> _Gram:
        return _Gram(self.sin[index], self.cos[index], self.total[index], self.count)


def fit_sinusoids(windows: np.ndarray, fps: float, lowest: float = LOWEST, highest: float = HIGHEST) -> Sinusoids:
    """Fits the best sinusoid to every window, with 0 <= A <= max - min, min <= B <= max and lowest <= F <= highest.

    Deterministic. A constant window has amplitude and phase 0.

    Args:
        windows: [N, W] values at equal intervals, W odd and at least 5.
        fps: values per second.
        lowest, highest: Hz, below half of fps.

    Raises:
        ValueError: if W is even or too small, or the frequencies are not 0 < lowest < highest < fps / 2.
    """
    windows = np.asarray(windows, dtype=float)
    if windows.ndim != 2 or windows.shape[1] < 5 or windows.shape[1] % 2 == 0:
        raise ValueError(f"windows must be [N, W] with W odd and at least 5, got {windows.shape}.")
    if not 0 < lowest < highest < fps / 2:
        raise ValueError(f"Frequencies must be 0 < lowest < highest < {fps / 2:g} Hz, got {lowest:g} and {highest:g}.")
    grid = 2 * np.pi * np.linspace(lowest, highest, GRID) / fps
    parts = [_fit_block(windows[i : i + BLOCK], grid) for i in range(0, max(len(windows), 1), BLOCK)]
    a, b, offset, error, x = np.concatenate(parts, axis=1)
    phase = np.arctan2(b, a) % (2 * np.pi)
    return Sinusoids(np.hypot(a, b), x * fps / (2 * np.pi), phase, offset, np.sqrt(error / windows.shape[1]))


def _fit_block(windows: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Returns [5, N]: a, b, offset, squared error, and angular frequency in radians per sample."""
    data = _read(windows)
    errors = _grid_errors(data, grid)
    window, start = _minima(errors, NEAR * data.power)
    fit = _refine(data.take(window), grid, start, _curvature(errors, window, start, grid[1] - grid[0]))
    # sorting puts the candidates of a window together, the best one first
    order = np.lexsort((fit[3], window))
    best = fit[:, order[np.flatnonzero(np.diff(window[order], prepend=-1))]]
    best[2] += data.mean
    best[3] = np.maximum(best[3], 0.0)
    return best


def _read(windows: np.ndarray) -> _Windows:
    half = windows.shape[1] // 2
    columns = np.ascontiguousarray(windows.T)
    low, high = columns.min(axis=0), columns.max(axis=0)
    mean = np.clip(columns.mean(axis=0), low, high)  # exact where the window is constant
    columns -= mean
    after, before = columns[half + 1 :], columns[:half][::-1]
    power = np.einsum("wn,wn->n", columns, columns)
    return _Windows(after - before, after + before, columns[half], mean, low - mean, high - mean, power)


def _gram(x: np.ndarray, count: int) -> tuple[_Gram, np.ndarray, np.ndarray]:
    """Returns the sums at angular frequencies x, and the derivatives of `total` and `cos` (`sin` has minus the latter).

    The sum of cos(k x) over a window is Dirichlet's kernel D(x) = sin(count x / 2) / sin(x / 2), and
    cos² = (1 + cos 2x) / 2.
    """
    s, c, top, top_rise = np.sin(x / 2), np.cos(x / 2), np.sin(count * x / 2), np.cos(count * x / 2)
    total, sin_x = top / s, 2 * s * c
    double = 2 * top * top_rise / sin_x
    rise = (count * top_rise - total * c) / (2 * s)
    double_rise = (count * (1 - 2 * top * top) - double * (1 - 2 * s * s)) / (2 * sin_x)
    return _Gram((count - double) / 2, (count + double) / 2, total, count), rise, double_rise


def _grid_errors(data: _Windows, grid: np.ndarray) -> np.ndarray:
    """Returns the squared error [G, N] of every window at every frequency; infinite where it cannot be near the best.

    Without bounds the error takes two projections. Bounds can only increase it, so that frequencies with an unbounded
    error above the best error within bounds need no exact solution.
    """
    half = len(data.odd)
    angles = grid[:, None] * np.arange(1, half + 1)
    gram, _, _ = _gram(grid, 2 * half + 1)
    p, q = np.sin(angles) @ data.odd, np.cos(angles) @ data.even + data.centre
    a, b = p / gram.sin[:, None], q / gram.free[:, None]
    error = data.power - a * p - b * q
    # the data have zero mean, so that the best offset cancels the mean of the cosine
    offset = b * (-gram.total / gram.count)[:, None]
    reach = data.high - data.low
    outside = (a * a + b * b > reach * reach) | (offset < data.low) | (offset > data.high)
    bound = np.where(outside, np.inf, error).min(axis=0) + NEAR * data.power
    rows, columns = np.nonzero(outside & (error <= bound))
    error[outside] = np.inf
    bounds = _Bounds(data.low[columns], data.high[columns], data.power[columns])
    error[rows, columns] = _solve(bounds, p[rows, columns], q[rows, columns], gram.take(rows))[3]
    return error


def _solve(bounds: _Windows | _Bounds, p: np.ndarray, q: np.ndarray, gram: _Gram) -> np.ndarray:
    """Returns [4, N]: a, b, offset and squared error of the best sinusoid of a given frequency within the bounds.

    The best error is a convex function of the offset, so that if the best offset lies outside its bounds, the nearest
    bound is optimal.
    """
    reach = bounds.high - bounds.low
    a, b = _within(p, q, gram.sin, gram.free, reach)
    best = -b * gram.total / gram.count
    offset = np.clip(best, bounds.low, bounds.high)
    held = np.flatnonzero(offset != best)
    if len(held):
        left = q[held] - offset[held] * gram.total[held]
        a[held], b[held] = _within(p[held], left, gram.sin[held], gram.cos[held], reach[held])
    error = bounds.power + a * (a * gram.sin - 2 * p) + b * (b * gram.cos - 2 * q)
    return np.stack([a, b, offset, error + offset * (offset * gram.count + 2 * b * gram.total)])


def _within(p: np.ndarray, q: np.ndarray, g: np.ndarray, h: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, ...]:
    """Returns (a, b) that minimise g a² - 2 p a + h b² - 2 q b inside the circle a² + b² <= reach².

    On the circle a = p / (g + m), b = q / (h + m) with one multiplier m > 0, found by Newton's method on
    1 / radius(m), which approaches the solution from below without overshooting.
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
        m += (np.sqrt(square) / reach - 1.0) * square / (a * a / (g + m) + b * b / (h + m))
    a, b = p / (g + m), q / (h + m)
    scale = reach / np.sqrt(a * a + b * b)
    return a * scale, b * scale


def _minima(errors: np.ndarray, margin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns (window, grid index) of each local minimum over the grid that may be near its window's best."""
    low = errors <= errors.min(axis=0) + margin
    low[1:] &= errors[1:] <= errors[:-1]
    low[:-1] &= errors[:-1] < errors[1:]
    start, window = np.nonzero(low)
    return window, start


def _curvature(errors: np.ndarray, window: np.ndarray, start: np.ndarray, step: float) -> np.ndarray:
    """Returns the second derivative of the error at grid points; not positive and finite where neighbours lack it."""
    inner = np.clip(start, 1, len(errors) - 2)
    return (errors[inner - 1, window] - 2 * errors[inner, window] + errors[inner + 1, window]) / step**2


def _refine(data: _Windows, grid: np.ndarray, start: np.ndarray, curvature: np.ndarray) -> np.ndarray:
    """Returns [5, N]: the values of `_solve` at the frequency of least error near a grid point, and that frequency.

    One Newton step from the grid point is followed by secant steps, all inside a shrinking bracket between the grid
    point's neighbours. Where a bound becomes active the slope has a corner, at which secant steps converge slowly:
    every third step therefore halves the bracket. Windows are dropped once their next step could gain nothing more.
    """
    low, x, high = grid[np.maximum(start - 1, 0)], grid[start], grid[np.minimum(start + 1, len(grid) - 1)]
    best = np.full((5, len(x)), np.inf)
    left, last_x, last_slope = np.arange(len(x)), x, x
    for step in range(REFINEMENTS):
        fit, slope = _evaluate(data, x)
        best[:, left] = np.where(fit[3] < best[3, left], [*fit, x], best[:, left])
        low, high = np.where(slope < 0, x, low), np.where(slope > 0, x, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            following = x - slope / (curvature if step == 0 else (slope - last_slope) / (x - last_x))
        inside = (following > low) & (following < high)
        length = np.where(inside, np.abs(following - x), high - low)
        following = np.where(inside & (step % 3 != 2), following, 0.5 * (low + high))
        going = np.flatnonzero(np.abs(slope) * length > ENOUGH * data.power)
        if not len(going):
            break
        last_x, last_slope, x = x, slope, following
        if len(going) < FEWER * len(x):
            data, left = data.take(going), left[going]
            low, high, last_x, last_slope, x = (v[going] for v in (low, high, last_x, last_slope, x))
    return best


def _evaluate(data: _Windows, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the values of `_solve` at angular frequencies x [N], and the derivative of the error.

    The bounds do not depend on frequency, so that the derivative of the best error is the one at fixed a, b and offset.
    """
    half = len(data.odd)
    (gram, total_rise, cos_rise), (sin, cos) = _gram(x, 2 * half + 1), _powers(x, half)
    k = np.arange(1.0, half + 1)[:, None]
    dot = "kn,kn->n"
    p, q = np.einsum(dot, data.odd, sin), np.einsum(dot, data.even, cos) + data.centre
    fit = _solve(data, p, q, gram)
    a, b, offset, _ = fit
    p_rise, q_rise = np.einsum(dot, data.odd, k * cos), -np.einsum(dot, data.even, k * sin)
    return fit, (b * b - a * a) * cos_rise + 2 * (b * offset * total_rise - a * p_rise - b * q_rise)


def _powers(x: np.ndarray, half: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns sin(k x) and cos(k x), each [h, N], for k = 1 to h."""
    sin, cos = np.empty((half, len(x))), np.empty((half, len(x)))
    sin[0], cos[0] = np.sin(x), np.cos(x)
    for k in range(1, half):
        sin[k] = sin[k - 1] * cos[0] + cos[k - 1] * sin[0]
        cos[k] = cos[k - 1] * cos[0] - sin[k - 1] * sin[0]
    return sin, cos
