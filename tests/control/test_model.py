"""The model in the controller: linearisation, discretisation, residual."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from split_cli.control._compiled import discretize
from split_cli.control.limits import Limits, load_shift, nominal_share, slip_limit, slip_rows, torque_limit
from split_cli.control.model import ControlModel
from split_cli.control.residual import NoResidual, Residual, ResidualValues
from split_cli.errors import VehicleError
from split_cli.learning.features import FeatureSet
from split_cli.vehicle.integration import phi_matrix
from split_cli.vehicle.parameters import EffectSpec, read_vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.tire import lateral_force
from tests.exact_step import exact_step

CAR = read_vehicle(Path(__file__).resolve().parents[2] / "sample_logs" / "road_car.yaml")


class Wave(Residual):
    """A residual with a known slope."""

    def __init__(self, features: FeatureSet = Residual.features) -> None:
        self.features = features

    def of_data(self, z):
        mean = np.stack([0.3 * np.sin(5 * z[:, 2]), 4.0 * z[:, 0] ** 2, np.sin(9 * z[:, 1])], axis=1)
        slope = np.zeros((len(z), 3, z.shape[1]))
        slope[:, 0, 2], slope[:, 1, 0] = 1.5 * np.cos(5 * z[:, 2]), 8.0 * z[:, 0]
        slope[:, 2, 1] = 9 * np.cos(9 * z[:, 1])
        for extra in range(3, z.shape[1]):  # in units of 1000, as forces have
            mean[:, 1] += 50.0 * np.sin(1e-3 * z[:, extra])
            slope[:, 1, extra] = 0.05 * np.cos(1e-3 * z[:, extra])
        return ResidualValues(mean, slope, np.ones_like(mean), np.ones_like(mean))


def situations(count: int = 12, seed: int = 0, states: int = 8) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x = np.zeros((count, states))
    x[:, :2] = rng.uniform(-50, 50, (count, 2))
    x[:, 2] = rng.uniform(-3, 3, count)
    x[:, 3] = rng.uniform(6, 30, count)
    x[:, 4] = rng.uniform(-1, 1, count)
    x[:, 5] = rng.uniform(-0.3, 0.3, count)
    x[:, 6] = rng.uniform(-2000, 1000, count)
    x[:, 7] = rng.uniform(-0.1, 0.1, count)
    u = np.stack([rng.uniform(-2000, 2000, count), rng.uniform(-0.5, 0.5, count)], axis=1)
    return x, u


def test_discretisation_is_the_matrix_exponential():
    rng = np.random.default_rng(3)
    A = rng.standard_normal((20, 6, 6)) * rng.uniform(0.1, 40.0, (20, 1, 1))
    E, G = discretize(A, 0.05)
    augmented = np.zeros((20, 12, 12))
    augmented[:, :6, :6], augmented[:, :6, 6:] = A, np.eye(6)
    exact = expm(augmented * 0.05)
    size = np.abs(exact).max(axis=(1, 2), keepdims=True)
    assert (np.abs(E - exact[:, :6, :6]) / size).max() < 1e-11
    assert (np.abs(G - exact[:, :6, 6:]) / size).max() < 1e-11


def test_a_step_is_the_nominal_models_exact_step():
    x, u = situations()
    found = ControlModel(CAR, NoResidual(), 0.05).linearize(x, u)
    expected = exact_step(SingleTrack(CAR), x, u[:, 0], u[:, 1], 0.05)
    # exact_step takes its Jacobian by differences, good to about 1e-9 of the entries.
    assert found.following == pytest.approx(expected, abs=1e-8)


def test_the_residual_enters_as_the_prediction_that_labels_are_made_for():
    class Constant(Wave):
        def of_data(self, z):
            values = super().of_data(z)
            return replace(values, slope=np.zeros_like(values.slope))

    x, u = situations()
    plain = ControlModel(CAR, NoResidual(), 0.05).linearize(x, u)
    with_residual = ControlModel(CAR, Constant(), 0.05).linearize(x, u)
    A = SingleTrack(CAR).velocity_jacobian(*x[:, 3:].T)
    phi = phi_matrix(A, 0.05)
    expected = 0.05 * np.einsum("kij,kj->ki", phi, with_residual.residual.mean)
    assert (with_residual.following - plain.following)[:, 3:6] == pytest.approx(expected, abs=1e-9)


LATE = CAR.with_effects(EffectSpec("drive_lag", {"tau": 0.06}), EffectSpec("tire_relaxation", {"length": 0.5}))


@pytest.mark.parametrize(
    ("car", "features"),
    [
        (CAR, Residual.features.names),
        (CAR, (*Residual.features.names, "vx")),
        (LATE, (*Residual.features.names, "drive_lag.torque", "tire_relaxation.front")),
    ],
)
def test_the_linearisation_is_the_derivative_of_the_step_over_a_short_interval(car, features):
    # Over 50 ms the linearisation is that of the flow's first-order solution; as h goes to 0, (A - I)/h is the
    # continuous Jacobian, which differences of the continuous right-hand side must give.
    step = 1e-6
    model = ControlModel(car, Wave(FeatureSet(features)), step)
    x, u = situations()
    # What a term remembers is on its way.
    x = np.array([model.steady_states(row) for row in x])
    x[:, 8:] *= 0.8
    found = model.linearize(x, u)
    for column in range(model.states):
        large = column == 6 or column >= 8  # a torque or a force
        move = 1e-5 * (1.0 + np.abs(x[:, column])) if large else np.full(len(x), 1e-5)
        ahead, behind = x.copy(), x.copy()
        ahead[:, column] += move
        behind[:, column] -= move
        rate = (model.linearize(ahead, u).following - ahead) / step
        rate -= (model.linearize(behind, u).following - behind) / step
        expected = rate / (2 * move)[:, None]
        ours = (found.A - np.eye(model.states))[:, :, column] / step
        # Quotients of two small numbers keep about 1e-4 of the largest entries.
        assert ours[:, :8] == pytest.approx(expected[:, :8], abs=2e-3, rel=1e-3)


def test_inputs_move_the_commands_and_what_follows_from_them():
    x, u = situations()
    model = ControlModel(CAR, NoResidual(), 0.05)
    found = model.linearize(x, u)
    moved = model.linearize(x, u + np.array([[500.0, 0.1]]))
    expected = found.following + np.einsum("kij,j->ki", found.B, [500.0, 0.1])
    assert moved.following == pytest.approx(expected, abs=1e-9)
    assert found.B[:, 6, 0] == pytest.approx(0.05)


def test_terms_with_states_are_followed():
    car = CAR.with_effects(EffectSpec("drive_lag", {"tau": 0.2}), EffectSpec("steer_lag", {"tau": 0.1}))
    model = ControlModel(car, NoResidual(), 0.01)
    assert model.memory == 2
    x = model.steady_states(np.array([0, 0, 0, 20.0, 0, 0, 300.0, 0.0]))
    x[6] = 600.0
    states = model.follow(x, np.zeros((20, 2)))
    torques = [k for k in (8, 9) if abs(states[0, k] - 300.0) < 1e-6]
    # A step of the command reaches 1 - 1/e of its way after a time constant.
    assert states[-1, torques[0]] == pytest.approx(600.0 - 300.0 * np.exp(-1.0), rel=1e-6)


def test_a_delay_in_the_vehicle_is_refused_with_its_reason():
    with pytest.raises(VehicleError, match="a delay or a play"):
        ControlModel(CAR.with_effects(EffectSpec("steer_delay", {"delay": 0.1})), NoResidual(), 0.05)


def rolling(car, torque):
    """Return the model linearised while it rolls straight ahead under several torques."""
    model = ControlModel(car, NoResidual(), 0.05)
    x = np.array([model.steady_states(np.array([0, 0, 0, 20.0, 0, 0, value, 0.0])) for value in torque])
    return model.linearize(x, np.zeros((len(x), 2)))


def test_the_slip_limit_is_on_the_friction_ellipse():
    limits = Limits(alpha_max=1.0)
    torque = np.array([-2500.0, -1000.0, 0.0, 700.0])
    found = rolling(CAR, torque)
    alpha, slope, curvature = slip_limit(limits, found)
    kappa = np.where(torque < 0, CAR.brake_split_front, CAR.drive_split_front)
    force_x = kappa * torque / CAR.wheel_radius - CAR.rolling_resistance_front
    force_y = lateral_force(CAR.front_tire.B, CAR.front_tire.C, CAR.front_tire.D, alpha[:, 0])
    used = (limits.p_long * force_x) ** 2 + force_y**2
    assert used == pytest.approx(np.full(4, (limits.p_ellipse * CAR.front_tire.D) ** 2), rel=1e-9)
    moving = [0, 1, 3]  # at no torque the split of the axles jumps
    ahead, behind = (slip_limit(limits, rolling(CAR, torque + move)) for move in (0.1, -0.1))
    assert slope[moving, :, 6] == pytest.approx((ahead[0] - behind[0])[moving] / 0.2, rel=1e-4)
    bend = (curvature[:, :, None] * found.force_slope**2)[moving, :, 6]
    assert bend == pytest.approx((ahead[1] - behind[1])[moving, :, 6] / 0.2, rel=1e-4)
    # Where the limit is that of the slip angle, no force moves it.
    assert (slip_limit(replace(limits, alpha_max=0.01), found)[2] == 0.0).all()


def test_the_slip_limit_of_the_whole_peak_has_a_corner_at_no_force():
    """tan(acos(u)/C)/B with u = p_long |F_x|/D: finite, as steep on both sides, and nowhere bent downwards."""
    limits, found = Limits(p_ellipse=1.0, alpha_max=1.0), rolling(CAR, np.zeros(4))
    share = np.array([0.0, 1e-12, 1e-3, -0.2])
    B, C, D = (found.curve[:, 0, k] for k in range(3))
    force = np.stack([share * D / limits.p_long, found.force[:, 1]], axis=1)
    alpha, slope, curvature = slip_limit(limits, replace(found, force=force))
    angle = np.arccos(np.abs(share)) / C
    assert alpha[:, 0] == pytest.approx(np.tan(angle) / B, rel=1e-12)
    steep = -np.sign(share) * limits.p_long / (B * C * D * np.cos(angle) ** 2 * np.sqrt(1.0 - share**2))
    assert slope[:, 0] == pytest.approx(steep[:, None] * found.force_slope[:, 0], rel=1e-9)
    assert (curvature[:, 0] == 0.0).all() and np.isfinite(curvature).all()


def test_the_slip_limit_is_that_of_the_tyres_that_the_terms_leave():
    terms = EffectSpec("friction_scale", {"scale": 0.8}), EffectSpec("drive_lag", {"tau": 0.1})
    torque = np.array([-1000.0, 0.0])
    plain, found = rolling(CAR, torque), rolling(CAR.with_effects(*terms), torque)
    # The peak falls, the slope B C D stays.
    assert found.curve[:, :, 2] == pytest.approx(0.8 * plain.curve[:, :, 2])
    assert found.curve.prod(axis=2) == pytest.approx(plain.curve.prod(axis=2))
    # Half the ellipse of a tyre with 0.8 of the grip: the angles are 0.8 of what they were, where no torque is.
    limits = Limits(p_ellipse=0.5)
    assert slip_limit(limits, found)[0][1] == pytest.approx(0.8 * slip_limit(limits, plain)[0][1], rel=1e-2)
    # What brakes is the torque that has arrived, a state of its own behind the command.
    slope = slip_limit(limits, found)[1][0, 0]
    assert slope[6] == 0.0 and abs(slope[8]) > 0.0


def test_braking_moves_the_peak_from_the_rear_axle_to_the_front_one():
    limits, torque = Limits(alpha_max=1.0), np.array([-2000.0, 0.0, 700.0])
    grip, shift = np.array([0.9, 0.95]), load_shift(CAR)
    alpha, slope, _ = slip_limit(limits, rolling(CAR, torque), grip, shift)
    whole = torque / CAR.wheel_radius - CAR.rolling_resistance_front - CAR.rolling_resistance_rear
    moved = whole * CAR.cg_height / CAR.wheelbase
    for axle, (tire, load, sign) in enumerate(
        ((CAR.front_tire, CAR.static_load_front, -1.0), (CAR.rear_tire, CAR.static_load_rear, 1.0))
    ):
        kappa = np.where(torque < 0, CAR.brake_split_front, CAR.drive_split_front)
        kappa = kappa if axle == 0 else 1.0 - kappa
        resistance = (CAR.rolling_resistance_front, CAR.rolling_resistance_rear)[axle]
        force_x = kappa * torque / CAR.wheel_radius - resistance
        scale = grip[axle] * (1.0 + sign * moved / load)
        force_y = scale * lateral_force(tire.B / scale, tire.C, tire.D, alpha[:, axle])
        used = (limits.p_long * force_x) ** 2 + force_y**2
        assert used == pytest.approx((limits.p_ellipse * scale * tire.D) ** 2, rel=1e-9)
    ahead, behind = (slip_limit(limits, rolling(CAR, torque + move), grip, shift)[0] for move in (0.1, -0.1))
    moving = [0, 2]  # at no torque the split of the axles jumps
    assert slope[moving, :, 6] == pytest.approx((ahead - behind)[moving] / 0.2, rel=1e-4)
    # A term that moves load by itself is not counted twice.
    assert (load_shift(CAR.with_effects(EffectSpec("load_transfer", {"cg_height": 0.5}))) == 0.0).all()
    assert (load_shift(replace(CAR, cg_height=None)) == 0.0).all()


def test_no_axle_is_asked_for_more_force_along_than_the_ellipse_gives():
    limits, grip, shift = Limits(p_long=1.2), np.array([0.9, 0.8]), load_shift(CAR)
    begin = np.array([-2500.0, 500.0])
    for _ in range(60):  # the bound moves with the load, and the load with the torque
        found = rolling(CAR, begin)
        braking, driving = torque_limit(limits, found, CAR, grip, shift)
        begin = np.array([-braking[0], driving[1]])
    force = found.force + [[CAR.rolling_resistance_front, CAR.rolling_resistance_rear]]
    moved = (found.force.sum(axis=1) * CAR.cg_height / CAR.wheelbase)[:, None]
    load = 1.0 + moved * [[-1.0 / CAR.static_load_front, 1.0 / CAR.static_load_rear]]
    used = limits.p_long * np.abs(force) / (grip * load * [[CAR.front_tire.D, CAR.rear_tire.D]])
    # One axle is at the ellipse (within SATURATED of its square), the other below.
    assert used.max(axis=1) == pytest.approx(np.full(2, limits.p_ellipse * np.sqrt(0.99)), rel=1e-6)
    assert braking[0] < 5600.0


@pytest.mark.parametrize(
    ("sources", "effects", "share"),
    [
        ({"front_tire.D": "assumed", "rear_tire.D": "calibrated"}, (), 0.85),
        ({"front_tire.D": "calibrated", "rear_tire.D": "published"}, (), 0.95),
        ({}, (), 0.85),
        ({}, (EffectSpec("friction_scale", {"scale": 0.9}),), 0.95),
        ({}, (EffectSpec("drive_lag", {"tau": 0.05}),), 0.85),
    ],
)
def test_a_file_whose_peaks_are_known_may_use_more_of_them(sources, effects, share):
    assert nominal_share(replace(CAR, origins=sources, effects=effects)) == share


def test_the_ellipse_is_as_wide_as_the_residual_is_known():
    knowledge = np.array([[1.0, 0.0, 0.9], [1.0, 1.0, 1.0], [0.0, 0.5, 0.75]])
    nothing = np.zeros((3, 3))
    known = ResidualValues(nothing, np.zeros((3, 3, 3)), nothing, knowledge)
    assert Limits(p_ellipse=0.95, p_unknown=0.75).ellipse(known) == pytest.approx([0.75, 0.95, 0.85])
    assert Limits(p_ellipse=0.95).ellipse(known) == pytest.approx([0.95, 0.95, 0.95])


def test_rows_bound_the_slip_angles_of_the_linearised_model():
    x, u = situations()
    found = ControlModel(CAR, NoResidual(), 0.05).linearize(x, u)
    limits = Limits()
    C, lower, upper, bend = slip_rows(limits, found)
    bound, slope, curvature = slip_limit(limits, found)
    # A step that brings the slip angle to its bound at the same torque fills the row exactly, at either end.
    for axle in range(2):
        sideways = C[:, axle][:, [4, 5]]
        for end, row in ((bound, upper), (-bound, lower)):
            step = np.linalg.pinv(sideways[:, None])[:, :, 0] * (end - found.slip)[:, axle, None]
            assert np.einsum("ki,ki->k", sideways, step) == pytest.approx(row[:, axle], abs=1e-9)
    # The bound moves with the torque at the end to which the axle slips: one to the left, one to the right.
    assert (found.slip < 0).any() and (found.slip > 0).any()
    moved = np.where(found.slip < 0, -1.0, 1.0) * slope[:, :, 6]
    assert C[:, :2, 6] == pytest.approx(found.slip_slope[:, :, 6] - moved) and np.abs(moved).max() > 0
    assert upper[:, 2] - lower[:, 2] == pytest.approx(2 * limits.dalpha_max)
    assert bend[:, :, 6, 6] == pytest.approx(-curvature * found.force_slope[:, :, 6] ** 2)
    assert (np.linalg.eigvalsh(bend) > -1e-12).all()


def test_compiled_functions_give_what_interpreted_ones_give():
    terms = EffectSpec("friction_scale", {"scale": 0.9}), EffectSpec("tire_relaxation", {"length": 0.5})
    car = CAR.with_effects(*terms)
    ours, plain = (ControlModel(car, NoResidual(), 0.05, compile_c=choice) for choice in (True, False))
    x, u = situations()
    x = np.array([ours.steady_states(row) for row in x])
    fast, slow = ours.linearize(x, u), plain.linearize(x, u)
    for name in ("A", "B", "following", "slip", "slip_slope", "curve", "force", "force_slope"):
        assert getattr(fast, name) == pytest.approx(getattr(slow, name), rel=1e-12, abs=1e-12), name


def test_without_a_compiler_the_model_is_interpreted_and_says_so(monkeypatch):
    monkeypatch.setattr("split_cli.control.generated.find_compiler", lambda: None)
    model = ControlModel(CAR, NoResidual(), 0.05)
    assert model.not_compiled == "no C compiler was found"
    assert np.isfinite(model.linearize(*situations()).A).all()


def test_a_learned_lag_is_followed_as_far_as_is_known():
    """The very step with the lag where all is known, and that of the file where nothing is."""
    x, u = situations(states=9)
    x[:, 8] = 0.5 * x[:, 7]

    class Known(NoResidual):
        def __init__(self, known: float) -> None:
            self.known = known

        def of_data(self, z):
            values = super().of_data(z)
            return replace(values, knowledge=np.full_like(values.mean, self.known))

    def following(variant: str, known: float) -> np.ndarray:
        car = CAR.with_effects(EffectSpec("steer_lag", {"tau": 0.1}, variant))
        return ControlModel(car, Known(known), 0.05).linearize(x, u).following

    np.testing.assert_allclose(following("learned", 1.0), following("", 1.0), rtol=0.0, atol=1e-12)
    bare = ControlModel(CAR, NoResidual(), 0.05).linearize(x[:, :8], u).following
    np.testing.assert_allclose(following("learned", 0.0)[:, :8], bare, rtol=0.0, atol=1e-9)
    between = following("learned", 0.5)[:, :6]
    assert (np.abs(between - following("", 1.0)[:, :6]).max(axis=1) > 1e-6).all()
    assert (np.abs(between - bare[:, :6]).max(axis=1) > 1e-6).all()
