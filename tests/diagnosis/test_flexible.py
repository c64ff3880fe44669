"""States that a flexible fit takes: told by samples beside a row, so that they know nothing of its noise."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.baseline.discrepancy import build_shared_discrepancy
from split_cli.diagnosis.innovations.evidence import gather_evidence
from split_cli.diagnosis.recording.series import build_series
from split_cli.diagnosis.remainder.flexible import flexible_rows, states_between
from split_cli.diagnosis.remainder.structure import build_structure
from split_cli.logs.drive import Drive
from split_cli.proof.sets import scripted_drive
from split_cli.vehicle.library import library_path
from split_cli.vehicle.parameters import read_vehicle
from tests.diagnosis.recordings import SIGMA, bare_objective

ROW = 4  # samples


def test_a_cubic_is_told_to_the_last_digit(nominal_series):
    t = nominal_series.t[:, None] / nominal_series.t[-1]
    cubic = np.hstack([1.0 + t, t**2 - t, 0.3 - t**3])
    series = replace(nominal_series, measured=cubic, smooth=cubic + 1.0)
    assert states_between(series) == pytest.approx(cubic, abs=1e-9)


def test_what_a_row_measures_tells_nothing_of_its_states(nominal_series):
    """Five samples of one row moved: the states at all of them stay, those beyond move."""
    begin = nominal_series.recording.segments[1][0] + 20 * ROW
    before, measured = states_between(nominal_series), nominal_series.measured.copy()
    measured[begin : begin + ROW + 1] += 1.0
    after = states_between(replace(nominal_series, measured=measured))
    assert np.array_equal(after[begin : begin + ROW + 1], before[begin : begin + ROW + 1])
    assert np.abs(after - before).max() > 0.1


def test_a_light_car_on_stiff_tyres_shows_no_difference_from_itself():
    """Its slips are small beside their noise: functions of smoothed states made an effect of 0.1 of it."""
    car, rng = read_vehicle(library_path("av21")), np.random.default_rng(3)
    columns = dict(scripted_drive(car, (), 11, runs=3))
    segment = columns.pop("segment")
    for name, sigma in zip(("vx", "vy", "r"), SIGMA, strict=True):
        columns[name] = columns[name] + rng.normal(0.0, sigma, len(segment))
    place = np.cumsum(0.01 * columns["vx"])
    drive = Drive("light.parquet", columns, segment, 0.01).with_held(("T", "delta"))
    series = build_series(drive, "real", place)
    discrepancy = build_shared_discrepancy(car, series)
    objective = bare_objective(one := gather_evidence(car, series, discrepancy))
    fit = build_structure(objective, [flexible_rows(one, discrepancy, uncompared=True)]).fit(
        objective.residual(()), 1.5
    )
    assert fit.effect_to_noise < 0.03 and fit.p_value > 0.5
