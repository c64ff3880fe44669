"""The loop that makes labels: windows of the nominal model over the recorded inputs.

Private; needs numba. Every window is computed by itself in a fixed order of operations, without fast-math, so that
labels do not depend on how samples are batched.
"""

import math

import numpy as np
from numpy import ndarray

from split_cli.compiled_code import compiled


@compiled(cache=True)
def _derivative(
    vx: float, vy: float, r: float, T: float, delta: float, sine: float, cosine: float, p: ndarray
) -> tuple[float, float, float]:
    """Return (v_x', v_y', r') of the nominal single track; `p` as packed by labels._nominal_constants."""
    m, i_z, l_f, l_r, radius = p[0], p[1], p[2], p[3], p[4]
    kappa = p[6] if T < 0.0 else p[5]
    if vx > 0.0:  # the arctangent of one argument costs two thirds of the other
        alpha_f = delta - math.atan((vy + l_f * r) / vx)
        alpha_r = -math.atan((vy - l_r * r) / vx)
    else:
        alpha_f = delta - math.atan2(vy + l_f * r, vx)
        alpha_r = -math.atan2(vy - l_r * r, vx)
    front_x = kappa * (T / radius) - p[7]
    rear_x = (1.0 - kappa) * (T / radius) - p[8]
    front_y = p[12] * math.sin(p[11] * math.atan(p[10] * alpha_f))
    rear_y = p[15] * math.sin(p[14] * math.atan(p[13] * alpha_r))
    along = front_x * cosine - front_y * sine
    across = front_y * cosine + front_x * sine
    dvx = (rear_x + along - p[9] * vx * vx) / m + vy * r
    dvy = (rear_y + across) / m - vx * r
    dr = (across * l_f - rear_y * l_r) / i_z
    return dvx, dvy, dr


@compiled(cache=True)
def _slope(B: float, C: float, D: float, alpha: float) -> float:
    reduced = B * alpha
    return D * C * B * math.cos(C * math.atan(reduced)) / (1.0 + reduced * reduced)


@compiled(cache=True)
def _jacobian(vx: float, vy: float, r: float, delta: float, p: ndarray, A: ndarray) -> None:
    """Fill A (3, 3), the derivative of (v_x', v_y', r') with respect to (v_x, v_y, r)."""
    m, i_z, l_f, l_r = p[0], p[1], p[2], p[3]
    w_f, w_r = vy + l_f * r, vy - l_r * r
    slope_f = _slope(p[10], p[11], p[12], delta - math.atan2(w_f, vx)) / (vx * vx + w_f * w_f)
    slope_r = _slope(p[13], p[14], p[15], -math.atan2(w_r, vx)) / (vx * vx + w_r * w_r)
    sine, cosine = math.sin(delta), math.cos(delta)
    for column in range(3):
        if column == 0:
            front, rear = slope_f * w_f, slope_r * w_r
        elif column == 1:
            front, rear = -slope_f * vx, -slope_r * vx
        else:
            front, rear = -slope_f * l_f * vx, slope_r * l_r * vx
        A[0, column] = -front * sine / m
        A[1, column] = (rear + front * cosine) / m
        A[2, column] = (front * cosine * l_f - rear * l_r) / i_z
    A[0, 0] -= 2.0 * p[9] * vx / m
    A[0, 1] += r
    A[0, 2] += vy
    A[1, 0] -= r
    A[1, 2] -= vx


@compiled(cache=True)
def _multiply(a: ndarray, b: ndarray, out: ndarray) -> None:
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@compiled(cache=True)
def _substeps(A: ndarray, period: float, half_wheelbase: float, work: ndarray) -> int:
    """Return how many RK4 steps a sample keep |lambda| step <= 1; see vehicle.windows.substep_count."""
    scaled, squared, fourth = work[0], work[1], work[2]
    for i in range(3):
        for j in range(3):
            up = half_wheelbase if i == 2 else 1.0
            down = half_wheelbase if j == 2 else 1.0
            scaled[i, j] = A[i, j] * up / down
    _multiply(scaled, scaled, squared)
    _multiply(squared, squared, fourth)
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += fourth[i, j] * fourth[i, j]
    radius = math.sqrt(math.sqrt(math.sqrt(total)))
    return max(1, int(math.ceil(radius * period)))


@compiled(cache=True)
def _phi(A: ndarray, horizon: float, phi: ndarray, work: ndarray) -> None:
    """Fill phi = (1/h) int_0^h exp(A s) ds: Taylor series on a halved argument, then doubling."""
    argument, product, exponential = work[0], work[1], work[2]
    norm = 0.0
    for i in range(3):
        row = 0.0
        for j in range(3):
            argument[i, j] = A[i, j] * horizon
            row += abs(argument[i, j])
        norm = max(norm, row)
    halvings = 0
    while norm > 0.5:
        norm *= 0.5
        halvings += 1
    for i in range(3):
        for j in range(3):
            argument[i, j] *= 0.5**halvings
            phi[i, j] = 1.0 if i == j else 0.0
    # Horner from the far end; 13 terms leave less than 1e-16 at norm 1/2.
    for k in range(13, 0, -1):
        _multiply(argument, phi, product)
        for i in range(3):
            for j in range(3):
                phi[i, j] = product[i, j] / (k + 1) + (1.0 if i == j else 0.0)
    for _ in range(halvings):
        # phi(2 M) = phi(M) (I + exp M)/2 with exp M = I + M phi(M)
        _multiply(argument, phi, exponential)
        for i in range(3):
            exponential[i, i] += 2.0
        _multiply(phi, exponential, product)
        for i in range(3):
            for j in range(3):
                phi[i, j] = 0.5 * product[i, j]
                argument[i, j] *= 2.0


@compiled(cache=True)
def _solve(a: ndarray, b0: float, b1: float, b2: float) -> tuple[float, float, float]:
    """Solve a 3 x 3 system by the adjugate; not finite when singular."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    c01 = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    c02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    determinant = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    if determinant == 0.0:
        return np.nan, np.nan, np.nan
    x0 = b0 * c00 + b1 * (a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2]) + b2 * (a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1])
    x1 = b0 * c01 + b1 * (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]) + b2 * (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2])
    x2 = b0 * c02 + b1 * (a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1]) + b2 * (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0])
    return x0 / determinant, x1 / determinant, x2 / determinant


@compiled(cache=True)
def window_errors(
    vx: ndarray,
    vy: ndarray,
    r: ndarray,
    T: ndarray,
    delta: ndarray,
    starts: ndarray,
    window: int,
    period: float,
    p: ndarray,
    plain: bool,
    run_on: ndarray,
) -> ndarray:
    """Return the labels y of windows, shape (N, 3); the compiled twin of labels._window_errors_reference.

    `run_on` is 1 for T and for delta where they run on to the next sample in a straight line, 0 where held.
    """
    out = np.empty((len(starts), 3))
    A, phi, work = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3, 3))
    horizon = window * period
    half_wheelbase = 0.5 * (p[2] + p[3])
    for n in range(len(starts)):
        i = starts[n]
        _jacobian(vx[i], vy[i], r[i], delta[i], p, A)
        if not np.isfinite(A).all():
            out[n] = np.nan
            continue
        substeps = _substeps(A, period, half_wheelbase, work)
        h = period / substeps
        a, b, c = vx[i], vy[i], r[i]
        for k in range(i, i + window):
            d_torque, d_steer = run_on[0] * (T[k + 1] - T[k]), run_on[1] * (delta[k + 1] - delta[k])
            T0, d0 = T[k], delta[k]
            sine0, cosine0 = math.sin(d0), math.cos(d0)
            for sub in range(substeps):
                middle, last = (sub + 0.5) / substeps, (sub + 1.0) / substeps
                T1, d1 = T[k] + middle * d_torque, delta[k] + middle * d_steer
                T2, d2 = T[k] + last * d_torque, delta[k] + last * d_steer
                sine1, cosine1, sine2, cosine2 = math.sin(d1), math.cos(d1), math.sin(d2), math.cos(d2)
                a1, b1, c1 = _derivative(a, b, c, T0, d0, sine0, cosine0, p)
                half = 0.5 * h
                a2, b2, c2 = _derivative(a + half * a1, b + half * b1, c + half * c1, T1, d1, sine1, cosine1, p)
                a3, b3, c3 = _derivative(a + half * a2, b + half * b2, c + half * c2, T1, d1, sine1, cosine1, p)
                a4, b4, c4 = _derivative(a + h * a3, b + h * b3, c + h * c3, T2, d2, sine2, cosine2, p)
                a += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
                b += h / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
                c += h / 6.0 * (c1 + 2.0 * c2 + 2.0 * c3 + c4)
                T0, d0, sine0, cosine0 = T2, d2, sine2, cosine2
        end = i + window
        y0, y1, y2 = (vx[end] - a) / horizon, (vy[end] - b) / horizon, (r[end] - c) / horizon
        if not plain:
            _phi(A, horizon, phi, work)
            y0, y1, y2 = _solve(phi, y0, y1, y2)
        out[n, 0], out[n, 1], out[n, 2] = y0, y1, y2
    return out
