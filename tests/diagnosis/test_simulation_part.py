"""What a simulation taught is believed where it predicts, and lets no prediction run away."""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.ingest import command
from split_cli.diagnosis.baseline.discrepancy import build_shared_discrepancy
from split_cli.diagnosis.innovations.case import gather_case
from split_cli.diagnosis.innovations.objective import learn_discrepancy
from split_cli.diagnosis.innovations.rollouts import HORIZONS, RolloutErrors, SharedRates, _stable_slope, shared_rates
from split_cli.diagnosis.recording.series import build_series
from split_cli.diagnosis.verdict.improvement import measure_improvement
from split_cli.diagnosis.verdict.simulation_part import SimulationPart, best_part, chosen_simulation_parts, part_of
from split_cli.logs.drive import read_drive
from split_cli.logs.track_position import places_of
from split_cli.proof.injection import split_in_blocks
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.parameters import read_vehicle, vehicle_file
from tests.diagnosis.recordings import recorded

RESISTANCE = CATALOGUE["rolling_resistance"]({"force": 450.0})


def held_last_quarter(evidence) -> np.ndarray:
    return evidence.series.t > 0.75 * evidence.series.t[-1]


def test_what_was_taught_rightly_is_believed_and_what_reality_does_not_have_is_not():
    taught, other = recorded(41, (RESISTANCE,)), recorded(42)
    discrepancy = build_shared_discrepancy(taught.vehicle, taught.series)
    posterior = learn_discrepancy([taught])
    for real, believed in ((recorded(43, (RESISTANCE,)), True), (other, False)):
        known = shared_rates(real.series, discrepancy, posterior)
        parts = chosen_simulation_parts([(real, held_last_quarter(real))], [taught], discrepancy, [known], [known])
        assert (parts[0].longitudinal != "nominal") == believed


def test_a_part_that_fails_on_the_simulation_itself_is_not_believed():
    """Knowledge of another car: on the end of the simulation it is worse than nothing, whatever reality says."""
    simulated = recorded(44)
    discrepancy = build_shared_discrepancy(simulated.vehicle, simulated.series)
    # Rows that say nothing but noise teach noise; the check learns for itself from the first three quarters.
    rng = np.random.default_rng(3)
    noise = replace(simulated, nominal_rows=5.0 * rng.normal(size=simulated.nominal_rows.shape))
    real = recorded(45, (RESISTANCE,))
    known = shared_rates(real.series, discrepancy, learn_discrepancy([noise]))
    parts = chosen_simulation_parts([(real, held_last_quarter(real))], [noise], discrepancy, [known], [known])
    assert parts == (SimulationPart(), SimulationPart())


@pytest.mark.parametrize("costs_v_y", [True, False])
def test_beside_a_usual_part_another_is_taken_only_where_no_velocity_pays_for_it(costs_v_y):
    """The nominal lateral model halves the error of v_x; where that of v_y grows by a tenth, it is not taken."""
    usual, other, bare = SimulationPart("taught", "taught"), SimulationPart("taught"), SimulationPart()
    squared = {usual: (1.0, 1.0, 1.0), other: (0.25, 1.21 if costs_v_y else 1.0, 1.0), bare: (4.0, 4.0, 4.0)}
    stages = {str(part): np.tile(values, (5, 2, 1)) for part, values in squared.items()}
    errors = [RolloutErrors((0.05, 0.5), np.arange(5.0), stages, np.full((5, 2, 3), 1e-6))]
    assert best_part(errors, list(squared)) == other
    assert best_part(errors, list(squared), usual) == (usual if costs_v_y else other)


def test_a_part_acts_in_its_outputs_alone():
    """Rates of 1, 2, 3 with a slope of 5 in every entry, believed elsewhere in v_y and r, and at all in no v_x."""
    whole = SharedRates(np.tile([1.0, 2.0, 3.0], (4, 1)), np.full((4, 3, 3), 5.0), np.zeros((4, 3)))
    kept = part_of(SimulationPart("nominal", "taught_elsewhere"), whole)
    nuisances = np.tile([0.1, 0.0, 0.0], (4, 1))
    np.testing.assert_allclose(kept.at(np.arange(4), nuisances), np.tile([0.0, 2.5, 3.5], (4, 1)))
    kept = part_of(SimulationPart("taught", "nominal"), whole)
    np.testing.assert_allclose(kept.at(np.arange(4), nuisances), np.tile([1.0, 0.0, 0.0], (4, 1)))
    assert part_of(SimulationPart(), whole) is None


def test_slopes_keep_their_size_where_errors_fade_and_lose_it_where_they_would_grow():
    A = np.array([[[-0.1, 0.0, 0.0], [0.0, -5.0, -20.0], [0.0, 0.5, -6.0]]] * 2)
    S = np.zeros_like(A)
    S[0, 2, 2], S[1, 2, 2] = -2.0, 40.0
    kept = _stable_slope(S, A)
    np.testing.assert_array_equal(kept[0], S[0])
    assert 0.0 <= kept[1, 2, 2] < 40.0
    assert np.linalg.eigvals(A + kept).real.max() <= 1.0 / HORIZONS[-1] + 1e-12


@pytest.mark.foreign
def test_no_real_pair_is_compared_with_a_simulation_that_diverges(tmp_path, datasets):
    """Interleaved halves of a real drive: what one taught of the other was 24 times persistence in r after 2 s."""
    source = datasets / "genesis_slow" / "cpg_slow_lap.mat"
    vehicle = read_vehicle(vehicle_file("genesis"))
    shown = CliRunner().invoke(
        command,
        [
            str(source),
            "--map",
            "genesis_slow",
            "--vehicle",
            "genesis",
            "--derive",
            "torque-from-acceleration",
            "-o",
            str(tmp_path / "drive.parquet"),
        ],
        catch_exceptions=False,
    )
    assert shown.exit_code == 0
    drive = read_drive(tmp_path / "drive.parquet")
    halves = [replace(half, name=name) for half, name in zip(split_in_blocks(drive, 10.0), "ab", strict=True)]
    places, lap = places_of(halves, vehicle.wheelbase)
    series = [
        build_series(half, role, place, lap_length=lap, place_reference=reference)
        for half, role, (place, reference) in zip(halves, ("sim", "real"), places, strict=True)
    ]
    case = gather_case(vehicle, series)
    recordings = [(one, held_last_quarter(one)) for one in case.real]
    told = measure_improvement(recordings, (), case.discrepancy, case.posterior, case.simulated)
    last = told.rollouts[-1]
    assert last.horizon == 2.0 and told.simulation_part["before"]["lateral"] != "nominal"
    # Measured 0.015 m/s and 0.003 rad/s, where holding the velocity has 0.059 and 0.047, and it had 3.4 and 1.1.
    assert np.all(np.array(last.before) < last.persistence)
    assert np.all(np.array(last.after) < 1.1 * np.array(last.before))
