"""A stretch of a recording over which its clock counts faster or slower than over the rest."""

import numpy as np

from split_cli.logs.checking.checks import LEAST_CORRELATION, Checks
from split_cli.logs.checking.kinematics import fit_slope
from split_cli.logs.checking.relations import OVER_TIME, SHARED, ConsistencyFinding

_MOST_BLOCKS = 400
"""Into which a drive is cut [1]; measured: 160,000 pairs of ends are compared in 10 ms."""
_SHORTEST_BLOCK = 0.5
"""Of time that gives one ratio of speeds [s]: longer than what smoothing mixes."""
_BETWEEN_STRETCHES = 1.0 / 3.0
"""Of a relation's tolerance, where two stretches are compared [1]: what is wrong throughout cancels. Measured: of
a sound drive in 400 blocks, the stretch most apart has 0.1 to 1.6 % in speed, whose tolerance is 3 %."""
_LOCATING = (OVER_TIME[2], OVER_TIME[0])  # relations that find the stretch: of speed, else of yaw


def changed_clock(checks: Checks) -> list[ConsistencyFinding]:
    """Tell the stretch over which rates of change, of v_x and of r, are off by one factor, and nowhere else.

    Notes
    -----
    The logarithm of v_x over the speed of X, Y is cut into blocks of time; without X, Y that of r over dyaw/dt in
    the half of the time that turns most. The stretch is the one whose mean differs most from that of the rest, in
    squares explained. A wheel that slips and a position that jumps do that as well. So both v_x and r must show
    the same factor there, relative to the rest, against all that is known: yaw, X, Y and a_x.
    """
    k = checks.k
    locating = next((name for name in _LOCATING if name in checks.pairs), None)
    if locating is None:
        return []
    recorded, travelled, *_ = checks.pairs[locating]
    use = k.moving & (recorded * travelled > 0.0)
    if locating != _LOCATING[0] and use.any():
        use &= np.abs(travelled) >= np.median(np.abs(travelled[use]))
    rows = np.flatnonzero(use)
    block = max(int(np.ceil(_SHORTEST_BLOCK / k.period)), -(-len(rows) // _MOST_BLOCKS))
    if len(rows) < 4 * block:
        return []
    parts = np.array_split(rows, len(rows) // block)
    ratio = np.array([np.median(np.log(recorded[part] / travelled[part])) for part in parts])
    first, last = _most_apart(ratio)
    inside = np.zeros(k.count, dtype=bool)
    begin, end = parts[first][0] if first else 0, parts[last][0] if last < len(parts) else k.count
    inside[begin:end] = True
    if abs(np.median(ratio[first:last])) < abs(np.median(np.delete(ratio, slice(first, last)))):
        inside = ~inside  # what is right is the stretch in the middle
    factors = _factors(checks, inside, locating)
    if factors is None:
        return []
    factor = float(np.exp(factors[locating]))
    t, bounds = k.times(), np.flatnonzero(np.diff(inside.astype(np.int8), prepend=0, append=0))
    stretches = [
        f"from {t[a] - t[0]:.1f} to {t[b - 1] - t[0]:.1f} s (rows {a} to {b - 1})"
        for a, b in zip(bounds[::2], bounds[1::2], strict=True)
    ]
    measured = "; ".join(f"{name} {np.exp(value):.3g}" for name, value in factors.items())
    text = (
        f"the time counts {max(factor, 1.0 / factor):.3g} times too {'fast' if factor > 1.0 else 'slow'} "
        f"{' and '.join(stretches)}. Ratios there, over those elsewhere: {measured}. "
        "`--cut FROM:TO` leaves the stretch out; or correct the times in the log."
    )
    return [ConsistencyFinding("clock", "time", text, factor, None)]


def _most_apart(values: np.ndarray) -> tuple[int, int]:
    """Return the stretch [first, last) whose mean is furthest from that of the rest, in squares explained."""
    n = len(values)
    total = np.concatenate([[0.0], np.cumsum(values - values.mean())])
    inside, count = total[None, :] - total[:, None], np.arange(n + 1)[None, :] - np.arange(n + 1)[:, None]
    # The sum outside is minus that inside.
    some = (count > 1) & (count < n - 1)
    explained = np.where(some, inside**2 * n / np.maximum(count * (n - count), 1), -1.0)
    first, last = np.unravel_index(int(np.argmax(explained)), explained.shape)
    return int(first), int(last)


def _factors(checks: Checks, inside: np.ndarray, locating: str) -> dict[str, float] | None:
    """Return the logarithm of each rate's ratio inside over that outside; None where no clock explains them."""
    found: dict[str, tuple[float, float]] = {}
    for name in OVER_TIME:
        if name not in checks.pairs:
            continue
        y, x, base, zeroed = checks.pairs[name]
        slopes = [fit_slope(y, x, checks.k.moving & where, zeroed=zeroed) for where in (inside, ~inside)]
        if any(s is None or s.correlation < LEAST_CORRELATION for s in slopes):
            continue
        there, rest = slopes
        error = 3.0 * float(np.hypot(there.error / there.slope, rest.error / rest.slope))
        found[name] = float(np.log(there.slope / rest.slope)), _BETWEEN_STRETCHES * base + error
    if locating not in found:
        return None
    common = found[locating][0]
    telling = {name: value for name, (value, tolerance) in found.items() if tolerance < abs(common)}
    shared = [any(channel in checks.powers[name] for name in telling) for channel in SHARED]
    agree = all(abs(value - common) <= tolerance for value, tolerance in found.values())
    return telling if agree and all(shared) else None
