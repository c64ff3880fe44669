"""A term that acts in a part of the drive only: found where it acts, and nowhere where nothing does."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.recording.witnesses import build_witnesses
from split_cli.diagnosis.search.fitting import Part, fit_parts
from split_cli.diagnosis.search.parts_of_drive import (
    most_saved,
    parts_of_drive,
    strongest_beside_tolerated,
    strongest_part,
)
from split_cli.diagnosis.search.selection import nothing
from tests.diagnosis.recordings import (
    INFLATION,
    bare_objective,
    driven,
    explorer,
    light_evidence,
    noisy,
    noisy_objective,
    prepared,
)

NAMES = ("steer_gain", "drive_gain", "yaw_inertia", "tire_stiffness", "aero_drag", "steer_offset")


def bare(blocks: int, rows: int) -> MarginalLikelihood:
    """Return an objective of so many blocks with so many rows of three channels, without anything else."""
    block, empty = np.repeat(np.arange(blocks), 3 * rows), np.zeros(0)
    keep = (np.ones(blocks * rows, dtype=bool),)
    return MarginalLikelihood((), None, None, keep, empty, empty.reshape(0, 0), block, np.ones(len(block)), empty)


def test_parts_are_regressions_of_their_own():
    """Least squares on the rows of each part alone, and a t of the differences its blocks make."""
    rng = np.random.default_rng(1)
    objective, rows = bare(9, 100), 300
    d, e = rng.standard_normal((2700, 2)), rng.standard_normal(2700)
    e[900:1800] += 0.2 * d[900:1800, 1]
    parts = parts_of_drive(objective, d, e)
    least = STANDARD.comparison.least_rows
    assert {(i, j) for i, j in zip(parts.first, parts.last, strict=True)} == {
        (i, j) for i in range(9) for j in range(i, 9) if 100 * (j - i + 1) >= least
    }
    for w, (i, j) in enumerate(zip(parts.first, parts.last, strict=True)):
        inside = slice(rows * i, rows * (j + 1))
        for k in range(2):
            column, left = d[inside, k], e[inside]
            size = float(column @ left / (column @ column))
            saved = left @ left - np.sum((left - size * column) ** 2)
            assert parts.size[w, k] == pytest.approx(size, rel=1e-9)
            assert parts.saved[w, k] == pytest.approx(saved, rel=1e-6)
            blocks = np.sum((left**2 - (left - size * column) ** 2).reshape(-1, rows), axis=1)
            error = np.sqrt(len(blocks) * np.var(blocks, ddof=1))
            assert parts.z[w, k] == pytest.approx(saved / error, rel=1e-4)
            scores = np.sum((column * (left - size * column)).reshape(-1, rows), axis=1)
            wald = abs(size) * float(column @ column) / np.sqrt(scores @ scores)
            assert parts.t[w, k] == pytest.approx(wald, rel=1e-4)
    assert most_saved(objective, d, e) == parts.saved.max()


def test_a_direction_saves_nothing_where_it_does_nothing():
    """Before torque is given its direction is what rounding left of it, whose square is no number any more."""
    rng = np.random.default_rng(5)
    d, e = 1e-170 * rng.standard_normal((3600, 1)), 1e3 * rng.standard_normal(3600)
    d[2520:] *= 1e170
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        parts = parts_of_drive(bare(20, 60), d, e)
    before = parts.last < 14
    assert before.any() and not parts.saved[before].any() and parts.saved[~before].all()


def test_noise_saves_in_the_best_part_what_theory_lets_it():
    """The largest of all parts' chi squared exceeds its Bonferroni bound at 5 % in no more than 5 % of draws."""
    from scipy.stats import chi2

    rng = np.random.default_rng(2)
    objective, exceeded = bare(20, 60), 0
    count = len(parts_of_drive(objective, np.ones((3600, 1)), np.zeros(3600)).first)
    for _ in range(200):
        exceeded += most_saved(objective, rng.standard_normal((3600, 1)), rng.standard_normal(3600)) > chi2.isf(
            0.05 / count, 1
        )
    assert exceeded <= 17  # the 99.5 % quantile of a binomial of 200 with 0.05


@pytest.mark.parametrize(("gain", "runs"), [(0.95, slice(5, 11)), (1.0, slice(5, 11))])
def test_a_steering_that_is_wrong_for_a_while_is_found_where_it_is(gain, runs):
    """Six of sixteen runs that start six seconds apart: from 30 to 65 s. Where nothing is planted, nothing is."""

    def steer(angles: np.ndarray, step: float) -> np.ndarray:
        out = angles.copy()
        out[runs] *= gain
        return out

    objective = noisy_objective(driven(41, steer=steer), 9)
    explore = explorer(objective, *NAMES)
    found = strongest_part(objective, explore.tangents(), nothing(objective).residuals, INFLATION)
    if gain == 1.0:
        assert found.p_value > 0.05
        return
    assert found.part.candidate.term == "steer_gain" and found.p_value < STANDARD.comparison.level
    assert found.part.values["gain"] == pytest.approx(gain, abs=0.01)
    assert found.begin == pytest.approx(30.0, abs=2.5) and found.end == pytest.approx(65.0, abs=2.5)


def test_parts_of_a_long_drive_begin_at_every_other_block():
    """Sixteen minutes in blocks of 2 s are taken in pairs; a part has as many of them as before of single ones."""
    rng = np.random.default_rng(3)
    d, e = rng.standard_normal((86400, 1)), rng.standard_normal(86400)
    parts = parts_of_drive(bare(480, 60), d, e)
    assert parts.last.max() == 239 and min(parts.last - parts.first) == 4 and len(parts.first) == 236 * 237 / 2
    for w in rng.choice(len(parts.first), 20):
        column, left = (rows[360 * parts.first[w] : 360 * (parts.last[w] + 1)] for rows in (d[:, 0], e))
        assert parts.saved[w, 0] == pytest.approx((column @ left) ** 2 / (column @ column), rel=1e-6)


@pytest.mark.parametrize("recorded_twice", [False, True])
def test_a_late_channel_is_asked_of_a_part_only_where_nothing_witnesses_it(recorded_twice):
    """A car whose steering is late looks by yaw rate like a late gyroscope; the yaw angle denies it."""

    def late(angles: np.ndarray, step: float) -> np.ndarray:
        shift = int(round(0.03 / step))
        return np.concatenate([np.repeat(angles[:, :1], shift, axis=1), angles[:, :-shift]], axis=1)

    series = prepared(noisy(driven(43, steer=late), 9))
    witnesses = [one for one in build_witnesses(series) if recorded_twice]
    objective = bare_objective(light_evidence(series), kinematics=witnesses)
    explore = explorer(objective, "channel_delay")
    lines = [one for one in explore.tangents() if "r" in one.part.values]
    found = strongest_part(objective, lines, nothing(objective).residuals, INFLATION)
    assert lines
    if recorded_twice:
        assert found is None
    else:
        assert found.part.candidate.term == "channel_delay" and found.p_value < STANDARD.comparison.level


def test_what_a_sound_gyroscope_reads_at_rest_acts_in_no_part():
    """Its bias is within what any may have, and is taken off before parts are asked; a late channel is not."""
    shifted = prepared(noisy(driven(44), 10))
    drive = replace(shifted.drive, columns={**shifted.drive.columns, "r": shifted.drive["r"] + 0.015})
    columns = {name: values for name, values in drive.columns.items() if name not in ("X", "Y", "yaw")}
    series = prepared(replace(drive, columns=columns))
    objective = bare_objective(light_evidence(series))
    explore = explorer(objective, "yaw_rate_bias", "road_bank")
    (bias,) = (
        one.without_position(beside_simulation=False) for one in explore.candidates if one.term == "yaw_rate_bias"
    )
    base = nothing(objective)
    chosen = fit_parts(objective, (Part(bias, {"r": 0.01}),))
    asked = partial(strongest_beside_tolerated, objective, explore.tangents, INFLATION, base)
    assert chosen.parts[0].values["r"] == pytest.approx(0.015, abs=0.003)
    assert asked(base).p_value < 1e-6
    beside = asked(chosen)
    assert beside is None or beside.p_value > STANDARD.comparison.level
