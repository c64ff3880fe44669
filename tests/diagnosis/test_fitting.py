"""Fits on drives of our own single track with a planted term, integrated apart from the engine."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.fitting import Fit, Part, effect_everywhere, fit_parts, raw_slopes, scan_places, tangent
from split_cli.diagnosis.search.selection import nothing
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import LAP, candidates_of, driven, first_order, late, noisy_objective


def objective_of(drive, seed: int = 7) -> MarginalLikelihood:
    return noisy_objective(drive, seed)


def candidate(objective: MarginalLikelihood, term: str, variant: str = "") -> Candidate:
    (one,) = (one for one in candidates_of(objective, term) if one.variant == variant)
    return one


def places(objective: MarginalLikelihood, one: Candidate) -> list[dict]:
    base = objective.residual(())
    return scan_places(objective, objective.whiten(base), one, effect_everywhere(objective, base, one))


def best_fit(objective: MarginalLikelihood, one: Candidate) -> Fit:
    starts = one.starts or places(objective, one)
    return min((fit_parts(objective, [Part(one, dict(start))]) for start in starts), key=lambda fit: fit.cost)


def standard_errors(fit: Fit) -> np.ndarray:
    return np.sqrt(np.diag(np.linalg.inv(fit.sensitivity.T @ fit.sensitivity)))


def check(fit: Fit, truth: dict[str, float], least_told: float = 20.0) -> None:
    """Within three standard errors and a hundredth of the effect, which is known well enough to mean it."""
    kind = CATALOGUE[fit.parts[0].candidate.term]
    for (name, value), error in zip(fit.parts[0].values.items(), standard_errors(fit), strict=True):
        size = abs(truth[name] - kind.neutral[name])
        assert error < size / least_told, (name, value, error)
        # States are predicted and rates are held over a sample of 10 ms: a hundredth for both.
        assert abs(value - truth[name]) < 3.0 * error + 0.01 * size, (name, value, error)


class TestPlantedTerms:
    def test_both_axles_stiffness(self):
        truth = {"front_scale": 0.85, "rear_scale": 1.1}
        objective = objective_of(driven(11, (CATALOGUE["tire_stiffness"](truth),)))
        one = candidate(objective, "tire_stiffness")
        fit = best_fit(objective, one)
        check(fit, truth)
        # From far away too, and no lower cost is found by a search that takes no derivatives.
        far = fit_parts(objective, [Part(one, {"front_scale": 0.35, "rear_scale": 2.8})])
        search = minimize(
            lambda x: objective.cost((one.build(dict(zip(truth, x, strict=True))),)),
            list(fit.parts[0].values.values()),
            method="Nelder-Mead",
            options={"xatol": 1e-5, "fatol": 1e-4},
        )
        assert fit.cost == pytest.approx(search.fun, abs=0.05)
        assert far.cost == pytest.approx(search.fun, abs=0.05)

    def test_a_lag_of_the_steering(self):
        objective = objective_of(driven(12, steer=lambda inputs, step: first_order(inputs, 0.06, step)))
        check(best_fit(objective, candidate(objective, "steer_lag")), {"tau": 0.06})

    def test_a_delay_of_the_torque(self):
        objective = objective_of(driven(13, torque=lambda inputs, step: late(inputs, 0.073, step)))
        check(best_fit(objective, candidate(objective, "drive_delay")), {"delay": 0.073})

    def test_a_lever_arm_of_the_sensor(self):
        drive = driven(14)
        moved = replace(drive, columns={**drive.columns, "vy": drive["vy"] + 0.25 * drive["r"]})
        objective = objective_of(moved)
        check(best_fit(objective, candidate(objective, "sensor_lever_arm")), {"dx": 0.25})

    def test_a_patch_over_the_start_of_the_lap(self):
        stretch = {"scale": 0.7, "s_start": 350.0, "s_end": 60.0}
        objective = objective_of(driven(15, (CATALOGUE["friction_patch"](stretch, "curve"),)))
        one = candidate(objective, "friction_patch", "curve")
        starts = places(objective, one)
        # Places are scanned in bins of a fiftieth of the lap; two at either end are forgiven.
        for name in ("s_start", "s_end"):
            away = (starts[0][name] - stretch[name] + LAP / 2) % LAP - LAP / 2
            assert abs(away) <= 2.0 * LAP / 50
        fit = best_fit(objective, one)
        values = fit.parts[0].values
        assert values["scale"] == pytest.approx(0.7, abs=0.04)
        for name in ("s_start", "s_end"):
            assert abs((values[name] - stretch[name] + LAP / 2) % LAP - LAP / 2) < LAP / 50

    def test_a_wave_of_the_road(self):
        truth = {"amplitude": 0.03, "wavelength": LAP / 3.0, "phase": 0.7}
        drive = driven(16, (CATALOGUE["road_grade"](truth, "wave"),))
        objective = noisy_objective(drive, 7, disturbance=1e-4)
        one = candidate(objective, "road_grade", "wave")
        start, values = places(objective, one)[0], best_fit(objective, one).parts[0].values
        s = np.linspace(0.0, LAP, 200)

        def profile(one):
            return one["amplitude"] * np.sin(2.0 * np.pi * s / one["wavelength"] + one["phase"])

        # Amplitude and phase trade signs and turns; the road is the same.
        np.testing.assert_allclose(profile(values), profile(truth), atol=0.02 * 0.03)
        # The scan knows whole fractions of the lap, of which this is one. With such a disturbance rows remember
        # some tenths of a second, five metres of 133 or a quarter of a radian: so late it is before any fit.
        np.testing.assert_allclose(profile(start), profile(truth), atol=0.25 * 0.03)

    def test_two_terms_together(self):
        truth = CATALOGUE["aero_drag"]({"drag": 0.4}), CATALOGUE["yaw_inertia"]({"scale": 1.15})
        objective = objective_of(driven(17, truth))
        parts = [Part(one, dict(one.starts[0])) for one in candidates_of(objective, "aero_drag", "yaw_inertia")]
        fit = fit_parts(objective, parts)
        errors = iter(standard_errors(fit))
        for part in fit.parts:
            (true,) = (one.parameters for one in truth if one.id == part.candidate.term)
            for name, value in part.values.items():
                assert abs(value - true[name]) < 3.0 * next(errors) + 0.01 * abs(true[name])


@pytest.fixture(scope="module")
def pushed() -> MarginalLikelihood:
    """Judges a car with 150 N more of rolling resistance."""
    return objective_of(driven(18, (CATALOGUE["rolling_resistance"]({"force": 150.0}),)))


@pytest.fixture(scope="module")
def solved(pushed) -> tuple[float, float, float]:
    """Force, cost and standard error by one least squares problem."""
    base = pushed.residual(())
    column = pushed.residual((CATALOGUE["rolling_resistance"]({"force": 1.0}),)) - base
    force, left, *_ = np.linalg.lstsq(column[:, None], -base, rcond=None)
    return float(force[0]), float(left[0]), 1.0 / float(np.linalg.norm(column))


class TestLinearTerms:
    """A force is linear in its parameter: one least squares problem knows the answer."""

    def test_linear_cost_is_that_of_least_squares_from_any_start(self, pushed, solved):
        one = candidate(pushed, "rolling_resistance")
        for force in (-40.0, 10.0, 400.0):
            promised = tangent(pushed, pushed.residual(()), Part(one, {"force": force})).cost(nothing(pushed))
            assert promised == pytest.approx(solved[1], rel=1e-6)

    def test_linear_cost_beside_another_term(self, pushed):
        """Both are linear: least squares of two columns."""
        drag, push = candidate(pushed, "aero_drag"), candidate(pushed, "rolling_resistance")
        base = pushed.residual(())
        columns = np.stack(
            [pushed.residual((one,)) - base for one in (drag.build({"drag": 1.0}), push.build({"force": 1.0}))], axis=1
        )
        expected = float(np.linalg.lstsq(columns, base, rcond=None)[1][0])
        current = fit_parts(pushed, [Part(drag, {"drag": 0.3})])
        promised = tangent(pushed, base, Part(push, {"force": 20.0})).cost(current)
        assert promised == pytest.approx(expected, rel=1e-6)

    def test_the_fit_is_that_of_least_squares(self, pushed, solved):
        fit = fit_parts(pushed, [Part(candidate(pushed, "rolling_resistance"), {"force": 10.0})])
        force, cost, error = solved
        # It stops where another step saves less than 0.02, which is a seventh of a standard error.
        assert fit.parts[0].values["force"] == pytest.approx(force, abs=error / 7.0)
        assert fit.cost == pytest.approx(cost, abs=0.02)
        assert fit.cost == pytest.approx(float(fit.residuals @ fit.residuals), rel=1e-12)
        assert standard_errors(fit)[0] == pytest.approx(error, rel=1e-4)
        assert abs(force - 150.0) < 3.0 * error + 1.5

    def test_slopes_are_those_of_the_residual(self, pushed):
        part = Part(candidate(pushed, "rolling_resistance"), {"force": 30.0})
        step = part.candidate.ranges["force"].step
        ahead, behind = (pushed.residual((part.candidate.build({"force": 30.0 + d}),)) for d in (1.0, -1.0))
        np.testing.assert_allclose(raw_slopes(pushed, [part])[:, 0], 0.5 * step * (ahead - behind), atol=1e-6)


@pytest.fixture(scope="module")
def lagging() -> MarginalLikelihood:
    """Judges a car that steers 0.06 s late."""
    return objective_of(driven(19, steer=lambda inputs, step: first_order(inputs, 0.06, step)))


class TestBounds:
    @pytest.mark.parametrize(("lower", "upper", "kept"), [(0.0, 0.03, 0.03), (0.09, 0.8, 0.09)])
    def test_a_parameter_stays_where_the_limit_is_nearest(self, lagging, lower, upper, kept):
        one = candidate(lagging, "steer_lag")
        tight = replace(one, ranges={"tau": replace(one.ranges["tau"], lower=lower, upper=upper)})
        for start in (lower, 0.5 * (lower + upper), upper, upper + 0.2):
            fit = fit_parts(lagging, [Part(tight, {"tau": start})])
            assert fit.parts[0].values["tau"] == pytest.approx(kept, rel=1e-9)

    def test_another_parameter_goes_on_while_one_is_at_its_limit(self, lagging):
        """Both fitted from the limit of one: the other takes the value it has with the first held there."""
        lag, drag = candidate(lagging, "steer_lag"), candidate(lagging, "aero_drag")
        tight = replace(lag, ranges={"tau": replace(lag.ranges["tau"], upper=0.03)})
        both = fit_parts(lagging, [Part(tight, {"tau": 0.03}), Part(drag, {"drag": 0.5})])
        alone = replace(lag, ranges={"tau": replace(lag.ranges["tau"], lower=0.03, upper=0.03)})
        held = fit_parts(lagging, [Part(alone, {"tau": 0.03}), Part(drag, {"drag": 0.0})])
        assert both.parts[0].values["tau"] == 0.03
        assert both.parts[1].values["drag"] == pytest.approx(held.parts[1].values["drag"], abs=0.01)

    def test_what_is_built_is_inside(self, lagging):
        one = candidate(lagging, "steer_lag")
        assert one.build({"tau": -1.0}).parameters["tau"] == one.ranges["tau"].lower
        assert one.build({"tau": 9.0}).parameters["tau"] == one.ranges["tau"].upper


def test_held_commands_hide_no_delay_and_taken_for_lines_they_do():
    """Commands of 50 Hz, kept by the car: as they were, no delay; in lines of 20 ms, half a sample of it."""

    def kept(inputs: np.ndarray, step: float) -> np.ndarray:
        every = round(0.02 / step)
        return np.repeat(inputs[:, ::every], every, axis=1)[:, : inputs.shape[1]]

    made = driven(11, steer=kept, torque=kept, runs=10)
    # The logger's clock is as slow as the commands.
    rows = np.concatenate([np.arange(run.start, run.stop, 2) for run in made.segments()])
    columns = {name: values[rows] for name, values in made.columns.items()}
    slow = Drive(made.name, columns, made.segment[rows], 0.02)
    late_by = {}
    for held in ((), ("T", "delta")):
        objective = objective_of(slow.with_held(held))
        late_by[held] = best_fit(objective, candidate(objective, "sensor_delay")).parts[0].values["delay"]
    # A ramp is a late staircase only to first order in a sample that is as long as the car is quick.
    assert late_by[()] == pytest.approx(0.01, abs=2e-3)
    assert late_by["T", "delta"] < 3e-4


def test_derivatives_of_another_fit_lead_to_the_same_optimum_for_less(pushed, monkeypatch):
    """A drag beside a resistance, from what the drag alone left; and both again, which costs one evaluation."""
    drag, resistance = candidate(pushed, "aero_drag"), candidate(pushed, "rolling_resistance")
    alone = fit_parts(pushed, [Part(drag, dict(drag.starts[0]))])
    parts = (*alone.parts, Part(resistance, dict(resistance.starts[0])))
    evaluated = []
    whole = Evidence.defects
    monkeypatch.setattr(
        Evidence, "defects", lambda self, terms, rates: evaluated.append(terms) or whole(self, terms, rates)
    )
    fresh = fit_parts(pushed, parts)
    needed, evaluated[:] = len(evaluated), []
    shared = fit_parts(pushed, parts, slopes_of=alone)
    assert len(evaluated) < needed
    assert shared.cost == pytest.approx(fresh.cost, abs=0.05)
    for one, other, error in zip(shared.parts, fresh.parts, standard_errors(fresh), strict=True):
        assert list(one.values.values()) == pytest.approx(list(other.values.values()), abs=0.05 * error)
    evaluated[:] = []
    again = fit_parts(pushed, shared.parts, slopes_of=shared)
    assert len(evaluated) == 1 and again.cost <= shared.cost


def test_wrong_derivatives_of_another_fit_do_not_end_a_fit(pushed):
    """Neither where a part comes to those known, nor where one leaves and a step along them gains nothing."""
    drag, resistance = candidate(pushed, "aero_drag"), candidate(pushed, "rolling_resistance")
    both = fit_parts(pushed, [Part(drag, {"drag": 0.2}), Part(resistance, {"force": 100.0})])
    turned = replace(both, sensitivity=-both.sensitivity)
    for parts in ((*both.parts[:1], Part(resistance, {"force": 20.0})), both.parts[:1]):
        assert fit_parts(pushed, parts, slopes_of=turned).cost == pytest.approx(fit_parts(pushed, parts).cost, abs=0.05)
