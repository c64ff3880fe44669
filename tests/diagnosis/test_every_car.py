"""What every car has, planted all at once in a bare nominal model: it is found, and a stand-in for it is not."""

import numpy as np
import pytest

from split_cli.diagnosis.search.every_car import explanation_of_every_car, is_shown, physics_of_every_car
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Part, fit_parts, without_parts
from split_cli.diagnosis.search.selection import nothing
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.effects.recording import Recording, first_order_response
from tests.diagnosis.recordings import driven, explorer, noisy_objective

TRUE = {
    "drive_lag": {"tau": 0.05},
    "load_transfer": {"cg_height": 0.5, "tau": 0.06},
    "rotating_mass": {"mass": 150.0},
    "steer_lag": {"tau": 0.04},
}
OTHERS = ("sensor_delay", "yaw_inertia", "drive_gain", "combined_slip", "tire_relaxation")


def lagging(inputs: np.ndarray, step: float, tau: float) -> np.ndarray:
    """Return inputs (runs, K) after a first-order lag, from steady."""
    run = [first_order_response(one, 1.0 / tau, Recording.single(step, len(one))) for one in inputs]
    return np.stack(run)


@pytest.fixture(scope="module")
def explore() -> Explorer:
    drive = driven(
        71,
        [CATALOGUE["load_transfer"](TRUE["load_transfer"], "late"), CATALOGUE["rotating_mass"](TRUE["rotating_mass"])],
        steer=lambda inputs, step: lagging(inputs, step, TRUE["steer_lag"]["tau"]),
        torque=lambda inputs, step: lagging(inputs, step, TRUE["drive_lag"]["tau"]),
    )
    objective = noisy_objective(drive, 3)
    return explorer(objective, *TRUE, *OTHERS)


def test_lags_loads_and_what_turns_are_found_at_once_with_their_values(explore):
    base = nothing(explore.objective)
    whole = physics_of_every_car(explore, base)
    found = {part.candidate.term: part.values for part in whole.parts}
    for term, values in TRUE.items():
        for name, value in values.items():
            assert found[term][name] == pytest.approx(value, rel=0.1)
    shown = {
        part.candidate.term: is_shown(explore, whole, rest)
        for part, rest in zip(whole.parts, without_parts(explore.objective, base, whole), strict=True)
    }
    assert all(shown[term] for term in TRUE)


def test_late_sensors_do_not_stand_for_two_lags(explore):
    """One delay saves most of what two lags do. It is a surprise and leaves more; nothing joins what is whole."""
    base = nothing(explore.objective)
    (delay,) = (one for one in explore.candidates if one.term == "sensor_delay")
    late = fit_parts(explore.objective, [Part(delay, {"delay": 0.05})])
    assert base.cost - late.cost > 0.2 * base.cost
    found = physics_of_every_car(explore, base)
    whole, history = explanation_of_every_car(explore, lambda: found, late, lambda fit: True)
    assert set(whole.names) >= set(TRUE) and not {"sensor_delay", "yaw_inertia"} & set(whole.names)
    assert "steer_lag" in history[0] and len(history) == 1
    # Where an explanation leaves noise alone there is no model-form error, and it stays.
    assert explanation_of_every_car(explore, lambda: found, late, lambda fit: False) is None
