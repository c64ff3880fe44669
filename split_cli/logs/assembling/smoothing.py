"""Evenly spaced samples smoothed as much as their own noise asks for, and their derivative."""

import numpy as np


def smooth(values: np.ndarray) -> np.ndarray:
    """Smooth evenly spaced noisy samples by penalising third differences, shape (N,).

    Notes
    -----
    z = (I + lambda D'D)^-1 x with D the third difference (Whittaker's smoother, the discrete quintic spline),
    lambda by generalised cross-validation: least RSS/(1 - dof/N)^2, dof/N the mean of the filter's frequency
    response. The noise need not be known, only be white. Computed as x - lambda D'(I + lambda DD')^-1 D x, which
    leaves a parabola alone to rounding at any lambda.
    """
    if len(values) < 12:
        return values
    from scipy.linalg import solveh_banded
    from scipy.optimize import minimize_scalar

    third = np.diff(values, n=3)
    bands = _third_difference_bands(len(third))
    frequency = np.linspace(0.0, np.pi, 20001)[1:]
    response = (2.0 - 2.0 * np.cos(frequency)) ** 3

    def correction(log_lambda: float) -> np.ndarray:
        system = np.exp(log_lambda) * bands
        system[-1] += 1.0
        inner = np.exp(log_lambda) * solveh_banded(system, third)
        # D' inner, written out: each third difference reaches four samples.
        out = np.zeros(len(values))
        for shift, weight in enumerate((-1.0, 3.0, -3.0, 1.0)):
            out[shift : shift + len(inner)] += weight * inner
        return out

    def score(log_lambda: float) -> float:
        dof = float(np.mean(1.0 / (1.0 + np.exp(log_lambda) * response)))
        rss = float(np.sum(correction(log_lambda) ** 2))
        return np.log(max(rss, 1e-300)) - 2.0 * np.log(1.0 - dof)

    grid = np.linspace(np.log(1e-4), np.log(1e12), 20)
    best = int(np.argmin([score(point) for point in grid]))
    around = grid[max(0, best - 1)], grid[min(len(grid) - 1, best + 1)]
    chosen = minimize_scalar(score, bounds=around, method="bounded", options={"xatol": 0.05}).x
    return values - correction(float(chosen))


def _third_difference_bands(count: int) -> np.ndarray:
    """Return DD' of the third difference in upper banded form, shape (4, count): a Toeplitz band."""
    bands = np.empty((4, count))
    for offset, value in enumerate((20.0, -15.0, 6.0, -1.0)):
        bands[3 - offset] = value
    return bands


def derivative(values: np.ndarray, period: float) -> np.ndarray:
    """Return d/dt of evenly spaced samples, shape (N,): of fourth order, of second at the two rows of each end."""
    if len(values) < 5:
        return np.gradient(values, period) if len(values) > 1 else np.zeros_like(values)
    slope = np.gradient(values, period, edge_order=2)
    slope[2:-2] = (values[:-4] - 8.0 * values[1:-3] + 8.0 * values[3:-1] - values[4:]) / (12.0 * period)
    return slope
