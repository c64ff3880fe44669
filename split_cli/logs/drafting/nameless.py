"""Columns without names, as ``states[3]`` or ``column4``: known by how a car's motion ties them together."""

import itertools
import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

import numpy as np

from split_cli.logs.checking.plausible import DAMAGED
from split_cli.logs.drafting.trial import TrialCandidate
from split_cli.logs.raw import RawChannelInfo, RawRecording

_NAMELESS = re.compile(r"(column|col|field[._]?data|data|value|.*\[)_?\d+\]?", re.IGNORECASE)
_OF_INPUTS = re.compile(r"(.*\.)?(u|inputs?|controls?|actions?)\[\d+\]", re.IGNORECASE)
# All numbers below are judgement, tried on public matrices of states (docs/records/foreign_logs.md). Where one is
# wrong nothing is named, or the checks of the draft leave the name open.
_NEEDED = ("X", "Y", "yaw", "vx", "r")
"""What ties itself together; without one of them nothing is named."""
_MOST_LISTED, _MOST_COLUMNS = 200, 24
"""Columns without names of a log, and those of them that are compared [1]: a state vector has 6 to 12 numbers."""
_ROWS = (4, 16, 64, 256)
"""Over which changes are taken, since the rate is not known [1]."""
_FEWEST_CHANGES, _MOST_CHANGES = 40, 4000
"""That are compared [1]: fewer go together by chance, and more only take time."""
_TIED = 0.9
"""Correlation of a change with the sum of what it should be the integral of, from which on it counts [1]."""
_STEERS = 0.8
"""The same of steering with the bend of the path, less by lags and slip angles [1]."""
_HALF = 0.5
"""Of what the bend of the path leaves of a column, below which what the yaw rate leaves makes it one too [1]."""
_SAME_STEP = 1.2
"""Ratio of the steps between rows that yaw and the path tell, up to which they tell the same [1]."""
_SUDDEN = 5.0
"""Of the change that one in twenty of a column exceeds, beyond which one is left out [1]: cars reach twice that."""
_MOVES = 0.2
"""Of the changes of place that one in twenty exceeds, below which a direction of travel is noise [1]."""
_ALONG = 0.8
"""Length of the mean direction of travel across yaw, from which on a path is one of this yaw [1]: 1 without
sideslip, 0 where nothing ties them."""


@dataclass(frozen=True)
class _Found:
    """A set of columns that is one car's motion."""

    score: tuple[bool, float]  # whether all are of one matrix, and how well they go together
    names: Mapping[str, str]  # channel to recorded name


def has_no_name(name: str) -> bool:
    """Whether a column is called by its number alone; an element of a covariance is known."""
    return _NAMELESS.fullmatch(name) is not None and "covariance" not in name


def is_of_a_state(info: RawChannelInfo, infos: Sequence[RawChannelInfo]) -> bool:
    """Whether a column is one of four or more of a matrix called by one letter, or of u, the inputs of a state.

    The first of x is no position, and that of u no velocity.
    """
    match = re.fullmatch(r"(?:.*\.)?([A-Za-z])\[\d+\]", info.name)
    if match is None:
        return False
    return match[1] == "u" or any(other.name == info.name.rpartition("[")[0] + "[3]" for other in infos)


def named_by_motion(recording: RawRecording, infos: Sequence[RawChannelInfo]) -> list[TrialCandidate]:
    """Return the columns without names that are X, Y, yaw, v_x, yaw rate, v_y and steering of one motion.

    Notes
    -----
    Yaw changes by the sum of the yaw rate, the length of the path by that of v_x, both times one step of time;
    the path runs along yaw; v_y is the rest across it. Only where all of it holds at once is anything named. The
    checks judge it further, as what names say.
    """
    names = [i.name for i in infos if i.type_name != "text" and has_no_name(i.name)]
    if not len(_NEEDED) <= len(names) <= _MOST_LISTED:
        return []
    read = recording.read(names)
    longest = max(len(read[name].values) for name in names)
    columns = {n: read[n].values for n in names if len(read[n].values) == longest}
    known = {n: np.isfinite(v) for n, v in columns.items()}
    columns = {n: v for n, v in columns.items() if known[n].any() and np.ptp(v[known[n]]) > 0.0}
    columns = dict(itertools.islice(columns.items(), _MOST_COLUMNS))
    if len(columns) < len(_NEEDED):
        return []
    # A matrix that was not filled to its end counts up to there.
    whole = np.logical_and.reduce([known[n] for n in columns])
    columns, longest = {n: v[whole] for n, v in columns.items()}, int(np.count_nonzero(whole))
    found = [_tied(columns, rows) for rows in _ROWS if longest > _FEWEST_CHANGES * rows]
    best = max((f for f in found if f is not None), key=lambda f: f.score, default=None)
    if best is None:
        return []
    note = "has no name; found by the motion of the others"
    return [
        TrialCandidate(channel, (name,), 2, None, note=note, asked=_OF_INPUTS.fullmatch(name) is not None)
        for channel, name in best.names.items()
    ]


def _tied(columns: Mapping[str, np.ndarray], rows: int) -> _Found | None:
    """Return the best set over changes of so many rows; None where there is none."""
    names = list(columns)
    values = np.stack([_unwrapped(columns[name]) for name in names])
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95], axis=1)[:, :, None]
    # Of a log that explodes at its end the rest counts.
    sound = (np.abs(values - middle) <= DAMAGED * (high - low)).all(axis=0)
    values = values[:, sound]
    if values.shape[1] < _FEWEST_CHANGES * rows:
        return None
    begin = np.arange(0, values.shape[1] - rows, max(rows // 2, values.shape[1] // _MOST_CHANGES, 1))
    change = values[:, begin + rows] - values[:, begin]
    summed = np.concatenate([np.zeros((len(names), 1)), np.cumsum(values, axis=1)], axis=1)
    mean = (summed[:, begin + rows] - summed[:, begin]) / rows
    # What an estimator that loses itself does for a moment is no motion.
    steady = (np.abs(change) <= _SUDDEN * np.quantile(np.abs(change), 0.95, axis=1, keepdims=True)).all(axis=0)
    change, mean = change[:, steady], mean[:, steady]
    if change.shape[1] < _FEWEST_CHANGES:
        return None
    pairs = list(itertools.combinations(range(len(names)), 2))
    lengths = np.stack([np.hypot(change[i], change[j]) for i, j in pairs])
    of_yaw, of_path = _correlations(change, mean), _correlations(lengths, np.abs(mean))
    best: _Found | None = None
    for yaw, rate in zip(*np.nonzero(of_yaw > _TIED), strict=True):
        for pair, speed in zip(*np.nonzero(of_path > _TIED), strict=True):
            if yaw == rate or len({yaw, rate, speed, *pairs[pair]}) < len(_NEEDED):
                continue
            steps = [_ratio(change[yaw], mean[rate]), _ratio(lengths[pair], mean[speed])]
            if not max(steps) < _SAME_STEP * min(steps):
                continue
            for x, y in (pairs[pair], pairs[pair][::-1]):
                across = np.exp(1j * (np.arctan2(change[y], change[x]) - mean[yaw]))
                moving = lengths[pair] > _MOVES * np.quantile(lengths[pair], 0.95)
                along = float(np.real(np.mean(across[moving])))
                # An estimate and a prediction of a state stand beside it: columns of one matrix go first.
                of_one = len({names[k].partition("[")[0] for k in (x, y, yaw, speed, rate)}) == 1
                score = of_one, along * float(of_yaw[yaw, rate]) * float(of_path[pair, speed])
                if along < _ALONG or (best is not None and score <= best.score):
                    continue
                chosen = dict(zip(_NEEDED, (x, y, yaw, speed, rate), strict=True))
                side = change[y] * np.cos(mean[yaw]) - change[x] * np.sin(mean[yaw])
                left = [k for k in range(len(names)) if k not in chosen.values()]
                siblings = {k for k in left if names[k].partition("[")[0] == names[speed].partition("[")[0]}
                bend = mean[rate] / np.where(moving, mean[speed], np.nan)
                chosen |= _rest(left, siblings, mean, side, steps[1], bend, mean[rate])
                best = _Found(score, {channel: names[k] for channel, k in chosen.items()})
    return best


def _rest(
    left: Sequence[int],
    siblings: Set[int],
    mean: np.ndarray,
    side: np.ndarray,
    step: float,
    bend: np.ndarray,
    rate: np.ndarray,
) -> dict[str, int]:
    """Return which of the columns left are v_y, in size, and what steers: it goes with the bend of the path.

    A column that goes with the yaw rate alone is another one of it, as the rate of change of a state is.
    """
    known = np.isfinite(bend)
    found: dict[str, int] = {}
    sideways = {k: float(_correlations(side[None], mean[k][None])[0, 0]) for k in left}
    vy = max(sideways, key=lambda k: (abs(sideways[k]) > _TIED and k in siblings, abs(sideways[k])), default=None)
    if vy is not None and abs(sideways[vy]) > _TIED and _SAME_STEP**-1 < _ratio(side, mean[vy]) / step < _SAME_STEP:
        found["vy"] = vy
    steers = {k: float(_correlations(bend[None, known], mean[k][None, known])[0, 0]) for k in left if k != vy}
    turns = {k: float(_correlations(rate[None, known], mean[k][None, known])[0, 0]) for k in steers}
    steers = {k: c for k, c in steers.items() if 1.0 - turns[k] ** 2 > _HALF**2 * (1.0 - c**2)}
    delta = max(steers, key=lambda k: abs(steers[k]), default=None)
    if delta is not None and abs(steers[delta]) > _STEERS:
        found["delta"] = delta
    return found


def _unwrapped(values: np.ndarray) -> np.ndarray:
    """Return an angle that jumps by a turn without its jumps, other values as they are."""
    jumps = np.abs(np.diff(values))
    turns = jumps[jumps > np.pi]
    return np.unwrap(values) if len(turns) and np.all(np.abs(turns - 2.0 * np.pi) < 1.0) else values


def _correlations(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the correlation of each row of `a`, (M, N), with each of `b`, (K, N); 0 for one that rests."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = ((v - v.mean(axis=1, keepdims=True)) / v.std(axis=1, keepdims=True) for v in (a, b))
        return np.nan_to_num(a @ b.T / a.shape[1])


def _ratio(a: np.ndarray, b: np.ndarray) -> float:
    """Return the ratio of two signals that go together, by their mean squares [unit of a over that of b]."""
    return float(np.sqrt(np.mean(a * a) / np.mean(b * b)))
