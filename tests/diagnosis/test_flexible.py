"""What a flexible fit finds in a recording that has no difference."""

import numpy as np

from split_cli.diagnosis.baseline.discrepancy import build_shared_discrepancy
from split_cli.diagnosis.innovations.evidence import gather_evidence
from split_cli.diagnosis.recording.series import build_series
from split_cli.diagnosis.remainder.flexible import flexible_rows
from split_cli.diagnosis.remainder.structure import build_structure
from split_cli.logs.drive import Drive
from split_cli.proof.sets import scripted_drive
from split_cli.vehicle.library import library_path
from split_cli.vehicle.parameters import read_vehicle
from tests.diagnosis.recordings import SIGMA, bare_objective


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
    fit = build_structure(objective, [flexible_rows(one, discrepancy)]).fit(objective.residual(()), 1.5)
    assert fit.effect_to_noise < 0.03 and fit.p_value > 0.5
