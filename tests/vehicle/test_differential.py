"""The moment of a differential: its laws written out again, the balance of each wheel, and its slopes in CasADi."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.vehicle.single_track import SingleTrack
from tests.vehicle.term_rates import CAR, A, B, G, driving, forces, rates, term


@pytest.mark.parametrize("driven", ["rear", "front"])
def test_a_locked_axle_that_drives_turns_with_the_difference_of_its_wheels_slips(driven):
    at = driving()
    car = replace(CAR, drive_split_front=0.9, brake_split_front=0.9) if driven == "front" else CAR
    f = forces(at)
    kappa = 0.9 if driven == "front" else np.where(at["T"] < 0, 0.66, 0.4)
    force = kappa * at["T"] / 0.31 - 90.0 if driven == "front" else (1 - kappa) * at["T"] / 0.31 - 80.0
    load = 1500.0 * G * (B if driven == "front" else A) / 2.7
    spun = at["vx"] * force / load * (f["fyf"] + f["fyr"]) / (1500.0 * G) / (4.0 * 2.7)
    model = term("yaw_moment_differential", "driven", yaw_damping=2000.0)
    moved = rates(at, model, car=car) - rates(at, car=car)
    zero = 0.0 * at["vx"]
    np.testing.assert_allclose(moved, np.stack([zero, zero, -2000.0 * (at["r"] - spun) / 2600.0]), atol=1e-9)
    # Driving out of a bend the inner wheel slips: the axle drags less.
    values = {"vx": 15.0, "vy": -0.1, "r": 0.4, "T": 600.0, "delta": 0.09, "yaw": 0.0, "t": 0.0, "s": 0.0}
    out = {name: np.array([value]) for name, value in values.items()}
    still = term("yaw_moment_differential", yaw_damping=2000.0)
    dragged, less = (rates(out, one, car=car)[2] - rates(out, car=car)[2] for one in (still, model))
    assert dragged < less < 0.0


@pytest.mark.parametrize("coupled", ["all", "rear", "rear of all", "front", "rear, front driven"])
def test_tires_that_slip_limit_the_moment_of_a_locked_axle(coupled):
    """-(r - r_0)/(1/d + v_x/K): a weak coupling damps by itself, a locked axle gives what slip permits."""
    at = driving()
    split = {"all": 0.4, "rear": 0.0, "rear of all": 0.4, "front": 1.0, "rear, front driven": 1.0}[coupled]
    in_front, in_rear, share = coupled in ("all", "front"), coupled != "front", 0.12
    car = replace(CAR, drive_split_front=split, brake_split_front=split)
    f = forces(at)
    force = (split * at["T"] / 0.31 - 90.0) * in_front + ((1.0 - split) * at["T"] / 0.31 - 80.0) * in_rear
    side = (f["fyf"] + f["fyr"]) / (1500.0 * G)
    # Beside slip across, slip along meets the secant of the tyre's curve.
    front, rear = f["fyf"] / f["alpha_f"], f["fyr"] / f["alpha_r"]
    limit = share * 2.7**2 * (front * in_front + rear * in_rear)
    by_load = 0.55 * force * side
    zero, spun = 0.0 * at["vx"], at["vx"] * by_load / limit
    damped = {1.0: (at["r"] - spun) * 1.0, 1e9: limit * at["r"] / at["vx"] - by_load}
    damped[4000.0] = (at["r"] - spun) / (1.0 / 4000.0 + at["vx"] / limit)
    variant = "rear slip" if coupled in ("rear of all", "rear, front driven") else "slip"
    for damping, moment in damped.items():
        model = term("yaw_moment_differential", variant, yaw_damping=damping, slip_stiffness=share)
        moved = rates(at, model, car=car) - rates(at, car=car)
        # Of either limit the other part of the series is at most 5e-4.
        np.testing.assert_allclose(moved, np.stack([zero, zero, -moment / 2600.0]), rtol=2e-3, atol=1e-3)


def test_slip_along_meets_the_secant_beside_slip_across():
    """A tyre whose force points along its slip: the slope of the force along is the secant of the force across."""
    angle, small = np.linspace(0.003, 0.3, 40), 1e-7

    def along(slip: float) -> np.ndarray:
        whole = np.hypot(slip, angle)
        return 6800.0 * np.sin(1.45 * np.arctan(12.5 * whole)) * slip / whole

    stiffness = (along(small) - along(-small)) / (2.0 * small)
    car = replace(CAR, drive_split_front=0.0)
    at = {name: np.zeros(40) for name in driving()}
    # Torque that balances the rolling resistance, so that no driving force adds to the moment.
    at |= {"vx": np.full(40, 20.0), "vy": -20.0 * np.tan(angle) + B * 0.05, "r": np.full(40, 0.05)}
    at["T"] = np.full(40, 80.0 * 0.31)
    model = term("yaw_moment_differential", "slip", yaw_damping=1e9, slip_stiffness=0.12)
    moment = 2600.0 * (rates(at, model, car=car) - rates(at, car=car))[2]
    # The secant is that of sqrt(angle^2 + 1e-6 rad^2), which moves it by up to (12.5 x 1e-3)^2.
    np.testing.assert_allclose(moment, -0.12 * 2.7**2 * stiffness * 0.05 / 20.0, rtol=1.6e-4)


def test_coupled_wheels_in_balance_give_a_series_of_coupling_and_slip():
    """Each wheel's balance, solved by itself: wheels of unlike load, a driving force and a coupling between them."""
    width, radius, height, load = 1.5, 0.31, 0.55, 7800.0
    rng = np.random.default_rng(6)
    for _ in range(50):
        v, r, side = rng.uniform(6.0, 40.0), rng.uniform(-0.5, 0.5), rng.uniform(-0.6, 0.6)
        driving_force, coupling = rng.uniform(-2000.0, 2000.0), 10.0 ** rng.uniform(0.0, 4.0)
        moved = side * height / width
        stiffness = 20.0 * load * np.array([0.5 - moved, 0.5 + moved])  # left, right; in proportion to the load
        travel = np.array([v - 0.5 * width * r, v + 0.5 * width * r])
        # Torque of a wheel: R F/2 -+ k (w_left - w_right) = R stiffness (R w - travel)/v.
        balance = np.diag(stiffness * radius**2 / v) + coupling * np.array([[1.0, -1.0], [-1.0, 1.0]])
        spins = np.linalg.solve(balance, 0.5 * radius * driving_force + radius * stiffness * travel / v)
        pull = stiffness * (radius * spins - travel) / v
        moment = 0.5 * width * (pull[1] - pull[0])
        limit, damping = 0.25 * width**2 * 20.0 * load, coupling * width**2 / radius**2
        alike = 1.0 - 4.0 * moved**2  # of series: what unlike stiffness takes of the slip of both
        spun = v * driving_force * height * side / (limit * alike)
        expected = -(r - spun) / (1.0 / damping + v / (limit * alike))
        np.testing.assert_allclose(moment, expected, rtol=1e-9, atol=1e-7)


def test_casadi_differentiates_the_moment_that_slip_limits():
    import casadi as ca

    from split_cli.export.symbolic import CASADI

    at = driving(20)
    model = SingleTrack(CAR, [term("yaw_moment_differential", "slip", yaw_damping=4000.0, slip_stiffness=0.1)])
    symbols = [ca.SX.sym(n) for n in at]
    turning = model.balance(model.flow(**dict(zip(at, symbols, strict=True)), ops=CASADI))[2]
    moved = ca.vertcat(*symbols[:5])
    slopes = ca.Function("f", symbols, [ca.jacobian(turning, moved)]).map(20)(*(row[None] for row in at.values()))
    for k, (name, step) in enumerate((("vx", 1e-4), ("vy", 1e-4), ("r", 1e-5), ("T", 0.1), ("delta", 1e-6))):
        ahead, behind = (rates({**at, name: at[name] + by}, *model.terms)[2] for by in (step, -step))
        # Central differences: an error of the order of the step squared, and rounding of 1e-16/step.
        np.testing.assert_allclose(slopes.toarray()[0, k::5], (ahead - behind) / (2.0 * step), rtol=1e-5, atol=1e-8)
