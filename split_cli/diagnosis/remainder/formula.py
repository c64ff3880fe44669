"""A sparse formula for the unexplained gap: a lead for a reader, not a finding."""

from collections.abc import Sequence

import numpy as np

from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.policy import STANDARD, Reporting
from split_cli.diagnosis.remainder.location import FORCES, variables
from split_cli.diagnosis.statement.wording import percent

_ROWS_APART = 5  # each fifth row of 0.04 s is used, since gap forces are averages over 0.2 s
_SUBSAMPLES = 20  # draws of half the blocks [1]; judgement: a share of 0.7 to 0.1
_BLOCK_SECONDS = 4.0  # length of blocks of time that are drawn [s]; judgement: longer than transients


def sparse_formula(
    evidence: Sequence[Evidence],
    forces: Sequence[np.ndarray],
    keep: Sequence[np.ndarray],
    rules: Reporting = STANDARD.reporting,
) -> str:
    """Return the best formula of few functions for gap forces, such as ``front lateral force = 310 N (T/T_max)^2``.

    Parameters
    ----------
    forces : sequence of ndarray, shape (N, 3)
        Gap forces of each recording that no finding explains [N].
    keep : sequence of ndarray of bool, shape (G,)

    Returns
    -------
    str
        For the force of which most is explained; empty if no function is chosen in most subsamples.

    Notes
    -----
    Greedy forward selection with the Bayesian information criterion. A function stays if it is chosen in 70 % of
    draws of half the blocks of time (stability selection: Meinshausen and Buehlmann, 2010).
    """
    rows = [one.at[mask][::_ROWS_APART] for one, mask in zip(evidence, keep, strict=True)]
    parts = [_dictionary(one, at) for one, at in zip(evidence, rows, strict=True)]
    names = list(parts[0])
    columns = np.concatenate([np.stack([part[name] for name in names], axis=1) for part in parts])
    gap = np.concatenate([force[at] for force, at in zip(forces, rows, strict=True)])
    block = np.concatenate(
        [
            1000 * k + (one.series.t[at] // _BLOCK_SECONDS).astype(int)
            for k, (one, at) in enumerate(zip(evidence, rows, strict=True))
        ]
    )
    best, text = 0.0, ""
    for channel, force in enumerate(FORCES):
        chosen = _stable_terms(columns, gap[:, channel], block, rules)
        if not chosen:
            continue
        weights = np.linalg.lstsq(columns[:, chosen], gap[:, channel], rcond=None)[0]
        size = float(np.mean(gap[:, channel] ** 2))
        gained = size - float(np.mean((gap[:, channel] - columns[:, chosen] @ weights) ** 2))
        if gained > best:
            sum_ = " ".join(f"{w:+.3g} N {names[k]}".rstrip() for w, k in zip(weights, chosen, strict=True))
            best, text = (
                gained,
                f"{force.replace('_', ' ')} force = {sum_.lstrip('+')} ({percent(gained / size)} of it)",
            )
    return text


def _stable_terms(columns: np.ndarray, target: np.ndarray, block: np.ndarray, rules: Reporting) -> list[int]:
    """Return the columns that forward selection chooses, those also chosen in most draws of half the blocks."""
    rng = np.random.default_rng(20240601)
    blocks = np.unique(block)
    votes = np.zeros(columns.shape[1])
    for _ in range(_SUBSAMPLES):
        half = np.isin(block, rng.choice(blocks, max(len(blocks) // 2, 1), replace=False))
        votes[_greedy(columns[half], target[half], rules.formula_terms)] += 1.0 / _SUBSAMPLES
    return [k for k in _greedy(columns, target, rules.formula_terms) if votes[k] >= rules.stable]


def _greedy(columns: np.ndarray, target: np.ndarray, most: int) -> list[int]:
    """Return at most so many columns by forward selection with the Bayesian information criterion."""
    chosen: list[int] = []
    count = len(target)
    score = count * np.log(np.mean(target**2) + 1e-300)
    while len(chosen) < most:
        trials = []
        for k in range(columns.shape[1]):
            if k in chosen:
                continue
            pick = columns[:, [*chosen, k]]
            left = target - pick @ np.linalg.lstsq(pick, target, rcond=None)[0]
            trials.append((count * np.log(np.mean(left**2) + 1e-300) + (len(chosen) + 1) * np.log(count), k))
        best = min(trials)
        if best[0] >= score:
            break
        score = best[0]
        chosen.append(best[1])
    return chosen


def _dictionary(one: Evidence, at: np.ndarray) -> dict[str, np.ndarray]:
    """Return dimensionless functions at rows `at`, shape (G,) each and of size about 1, by their text."""
    car = one.vehicle
    known = variables(one)
    a_f, a_r = known["alpha_f"][at] * car.front_tire.B, known["alpha_r"][at] * car.rear_tire.B
    torque = known["T"][at] / car.max_torque
    speed = known["v_x"][at] / np.quantile(known["v_x"], 0.95)
    steer_rate = known["steer_rate"][at] / max(float(np.std(known["steer_rate"])), 1e-9)
    drive, brake = np.maximum(torque, 0.0), np.maximum(-torque, 0.0)
    t = one.series.t[at] / max(float(one.series.t[-1]), 1e-9)
    return {
        "": np.ones(len(at)),
        "(v_x/v_95)": speed,
        "(v_x/v_95)^2": speed**2,
        "(T/T_max)_+": drive,
        "(T/T_max)_-": brake,
        "(T/T_max)_+^2": drive**2,
        "(T/T_max)_-^2": brake**2,
        "B alpha_f": a_f,
        "B alpha_r": a_r,
        "(B alpha_f)^2": a_f**2,
        "(B alpha_r)^2": a_r**2,
        "(B alpha_f)^3": a_f**3,
        "(B alpha_r)^3": a_r**3,
        "|B alpha_f|": np.abs(a_f),
        "|B alpha_r|": np.abs(a_r),
        "B alpha_f (T/T_max)_+": a_f * drive,
        "B alpha_f (T/T_max)_-": a_f * brake,
        "B alpha_r (T/T_max)_+": a_r * drive,
        "B alpha_r (T/T_max)_-": a_r * brake,
        "B alpha_f (v_x/v_95)^2": a_f * speed**2,
        "B alpha_r (v_x/v_95)^2": a_r * speed**2,
        "steer rate/sigma": steer_rate,
        "t/duration": t,
        "B alpha_f t/duration": a_f * t,
        "B alpha_r t/duration": a_r * t,
        "(T/T_max)_- t/duration": brake * t,
    }
