"""The bounded least-squares iteration: SciPy's answers, bounds, rest."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from split_cli.vehicle.descent import Slopes, descend


def rosenbrock(x: np.ndarray) -> np.ndarray:
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def slopes(x: np.ndarray, residuals: np.ndarray) -> Slopes:
    jacobian = np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])
    return Slopes(jacobian, jacobian.T @ residuals, jacobian.T @ jacobian)


def followed(before: Slopes, here: tuple, there: tuple) -> Slopes:
    """Broyden's update, trusted wherever it leads; `missed` is never little enough to end with."""
    step = there[0] - here[0]
    missed = there[1] - here[1] - before.jacobian @ step
    jacobian = before.jacobian + np.outer(missed, step) / (step @ step)
    return Slopes(jacobian, jacobian.T @ there[1], jacobian.T @ jacobian, missed=np.inf)


def descended(start, lower, upper, slopes=slopes, **options):
    def evaluate(x):
        residuals = rosenbrock(x)
        return float(residuals @ residuals), residuals

    def enough(gained, cost):
        return gained < 1e-14

    return descend(
        evaluate, slopes, *map(np.array, (start, lower, upper)), enough=enough, iterations=200, tries=20, **options
    )


@pytest.mark.parametrize(
    ("lower", "upper"), [((-5.0, -5.0), (5.0, 5.0)), ((-5.0, -5.0), (0.5, 5.0)), ((-5.0, 0.3), (5.0, 0.6))]
)
def test_the_answer_is_scipys_with_and_without_bounds_that_hold(lower, upper):
    start = (0.2, 0.5)
    found = descended(start, lower, upper)
    expected = least_squares(rosenbrock, start, bounds=(lower, upper), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert found.parameters == pytest.approx(expected.x, abs=1e-5)
    assert found.cost == pytest.approx(2.0 * expected.cost, abs=1e-9)
    assert found.state == pytest.approx(rosenbrock(found.parameters), abs=1e-12)


def test_what_may_not_move_stays():
    found = descended((-0.5, 0.5), (-5.0, -5.0), (5.0, 5.0), movable=np.array([True, False]))
    roots = np.roots([400.0, 0.0, -198.0, -2.0])  # of the derivative by the first
    assert found.parameters[1] == 0.5 and np.abs(roots - found.parameters[0]).min() < 1e-6


def test_at_the_least_cost_nothing_moves():
    found = descended((1.0, 1.0), (-5.0, -5.0), (5.0, 5.0))
    assert tuple(found.parameters) == (1.0, 1.0) and found.cost == 0.0


@pytest.mark.parametrize("upper", [(5.0, 5.0), (0.5, 5.0)])
def test_slopes_that_follow_the_steps_lead_to_the_same_answer_with_fewer_worked_out(upper):
    counted = []

    def counting(x, residuals):
        counted.append(x)
        return slopes(x, residuals)

    start, lower = (0.2, 0.5), (-5.0, -5.0)
    expected = descended(start, lower, upper, slopes=counting)
    worked_out = len(counted)
    counted.clear()
    found = descended(start, lower, upper, slopes=counting, update=followed)
    assert found.parameters == pytest.approx(expected.parameters, abs=1e-5)
    assert len(counted) < worked_out


def test_known_slopes_end_a_descent_only_without_doubt():
    """Slopes of nothing promise nothing: nothing moves, unless in doubt those of the place are worked out."""
    blind = Slopes(np.zeros((2, 2)), np.zeros(2), np.zeros((2, 2)))
    start, lower, upper = (0.2, 0.5), (-5.0, -5.0), (5.0, 5.0)
    assert tuple(descended(start, lower, upper, first=blind).parameters) == start
    doubted = Slopes(blind.jacobian, blind.gradient, blind.curvature, missed=1.0)
    assert descended(start, lower, upper, first=doubted).parameters == pytest.approx([1.0, 1.0], abs=1e-5)
