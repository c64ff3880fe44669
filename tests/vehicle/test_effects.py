"""Every term of the catalogue against a formula written out again, its neutral point, and mirrored driving."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import VehicleError
from split_cli.vehicle.effects import CATALOGUE, build_terms
from split_cli.vehicle.effects.place import inside_stretch
from split_cli.vehicle.operations import NUMPY
from split_cli.vehicle.parameters import EffectSpec
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.tire import MagicFormula
from tests.term_examples import EXAMPLES
from tests.vehicle.term_rates import CAR, A, B, G, driving, forces, rates, term

ONE_SIDED = {"steer_offset", "road_bank", "wind"}


def change(at: dict[str, np.ndarray], d_front: np.ndarray, d_rear: np.ndarray) -> np.ndarray:
    """Rates that extra lateral axle forces cause."""
    c, s = np.cos(at["delta"]), np.sin(at["delta"])
    return np.stack([-d_front * s / 1500.0, (d_front * c + d_rear) / 1500.0, (A * d_front * c - B * d_rear) / 2600.0])


def check(at: dict[str, np.ndarray], expected: np.ndarray, *terms) -> None:
    # Both sides are the same few dozen double operations in another order: rounding only.
    np.testing.assert_allclose(rates(at, *terms) - rates(at), expected, rtol=1e-9, atol=1e-9)


def test_every_term_and_variant_has_an_example():
    assert {(name, v) for name, kind in CATALOGUE.items() for v in kind.variants} == set(EXAMPLES)


@pytest.mark.parametrize(("name", "variant"), EXAMPLES)
@pytest.mark.parametrize("side", [0, 1])
def test_the_limits_of_a_file_give_finite_rates_and_leave_grip(name, variant, side):
    """At both ends of what a file may hold, whenever; what the program itself finds lies within."""
    limits = CATALOGUE[name].limits(CAR)
    ends = {p: min(limits[p][side], 1e6) for p in CATALOGUE[name].parameter_units(variant)}
    (built,) = build_terms(CAR.with_effects(EffectSpec(name, ends, variant)))
    at = driving()
    assert np.isfinite(rates(at, built)).all()
    much_later = SingleTrack(CAR, (built,)).flow(**{**at, "t": np.full_like(at["vx"], 1e9)})
    assert min(np.min(axle.D) for axle in (much_later.front, much_later.rear)) > 0.0


@pytest.mark.parametrize(("name", "variant"), EXAMPLES)
def test_neutral_parameters_leave_the_nominal_model(name, variant):
    kind, at = CATALOGUE[name], driving()
    parameters = {**EXAMPLES[name, variant], **{k: v for k, v in kind.neutral.items() if k in EXAMPLES[name, variant]}}
    np.testing.assert_allclose(rates(at, kind(parameters, variant)), rates(at), rtol=1e-12, atol=1e-12)
    if not kind.exported:
        return
    moved = rates(at, kind(EXAMPLES[name, variant], variant)) - rates(at)
    if not kind.states and not hasattr(kind, "input_delays"):
        assert np.abs(moved).max() > 1e-3


@pytest.mark.parametrize(("name", "variant"), EXAMPLES)
def test_what_a_term_leaves_as_it_was_may_be_taken_from_the_plain_flow(name, variant):
    at = driving()
    plain = SingleTrack(CAR, ()).flow(**at)
    for terms in ((), (CATALOGUE[name](EXAMPLES[name, variant], variant),)):
        model = SingleTrack(CAR, terms)
        taken = np.stack(model.balance(model.flow(**at, bare=plain)))
        # Rounding only: where the steer angle is another, its difference is added to the plain slip angle.
        np.testing.assert_allclose(taken, np.stack(model.velocity_derivative(**at)), rtol=1e-12, atol=1e-12)


def test_the_plain_flow_spares_what_is_the_same(monkeypatch):
    """A drag alters no tyre, a steering gain the front ones, a shifted centre of gravity how both axles move."""
    import split_cli.vehicle.single_track as module

    at, counted = driving(), []
    plain = SingleTrack(CAR, ()).flow(**at)
    for name in ("slip_angles", "lateral_force"):
        real = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *a, real=real, name=name: counted.append(name) or real(*a))
    for model, computed in (
        (term("aero_drag", drag=0.2), []),
        (term("tire_stiffness", front_scale=0.9, rear_scale=1.2), ["lateral_force"] * 2),
        (term("steer_gain", gain=0.9), ["lateral_force"]),
        (term("cg_shift", dx=0.02), ["slip_angles", "lateral_force", "lateral_force"]),
    ):
        counted.clear()
        SingleTrack(CAR, (model,)).flow(**at, bare=plain)
        assert counted == computed


@pytest.mark.parametrize(("name", "variant"), EXAMPLES)
def test_mirrored_driving_gives_mirrored_rates(name, variant):
    at = driving()
    mirrored = {**at, "vy": -at["vy"], "r": -at["r"], "delta": -at["delta"]}
    model = CATALOGUE[name](EXAMPLES[name, variant], variant)
    one, other = rates(at, model), rates(mirrored, model)
    symmetric = np.allclose(one, other * np.array([[1.0], [-1.0], [-1.0]]), rtol=1e-10, atol=1e-10)
    assert symmetric == (name not in ONE_SIDED)


@pytest.mark.parametrize("variant", ["", "curve"])
def test_grip_terms_scale_the_magic_formula(variant):
    at = driving()
    f = forces(at)

    def axles(scale_f, scale_r):
        inner_f, inner_r = (1.0, 1.0) if variant else (scale_f, scale_r)
        return (
            scale_f * 7900.0 * np.sin(1.45 * np.arctan(11.0 * f["alpha_f"] / inner_f)) - f["fyf"],
            scale_r * 6800.0 * np.sin(1.45 * np.arctan(12.5 * f["alpha_r"] / inner_r)) - f["fyr"],
        )

    check(at, change(at, *axles(0.8, 0.8)), term("friction_scale", variant, scale=0.8))
    if not variant:  # of one axle
        check(at, change(at, *axles(0.8, 1.0)), term("friction_scale", "front", scale=0.8))
        check(at, change(at, *axles(1.0, 0.8)), term("friction_scale", "rear", scale=0.8))
    fade = 1.0 - 0.2 * (1.0 - np.exp(-at["t"] / 30.0))
    check(at, change(at, *axles(fade, fade)), term("grip_fade", variant, final_loss=0.2, tau=30.0))
    on_f = (at["s"] + A >= 100.0) & (at["s"] + A < 300.0)
    on_r = (at["s"] - B >= 100.0) & (at["s"] - B < 300.0)
    patch = term("friction_patch", variant, scale=0.7, s_start=100.0, s_end=300.0)
    check(at, change(at, *axles(np.where(on_f, 0.7, 1.0), np.where(on_r, 0.7, 1.0))), patch)


def test_a_stretch_that_ends_before_it_starts_wraps_over_the_lap():
    s = np.array([0.0, 50.0, 99.9, 100.0, 250.0, 299.9, 300.0, 390.0])
    np.testing.assert_array_equal(inside_stretch(NUMPY, s, 300.0, 100.0), [1, 1, 1, 0, 0, 0, 1, 1])
    np.testing.assert_array_equal(inside_stretch(NUMPY, s, 100.0, 300.0), [0, 0, 0, 1, 1, 1, 0, 0])


def test_combined_slip_follows_the_ellipse():
    at = driving()
    at["T"] = 0.4 * at["T"]
    f = forces(at)
    lost = [
        f[y] * (np.sqrt(1.0 - (f[x] / D) ** 2) - 1.0) for y, x, D in (("fyf", "fxf", 7900.0), ("fyr", "fxr", 6800.0))
    ]
    check(at, change(at, *lost), term("combined_slip", strength=1.0))


def test_resistance_to_rolling_is_a_part_of_the_force_that_the_ellipse_takes_from():
    """A tyre that is held back by 400 N as it drives gives more to the side than one that is not."""
    at = driving()
    at["T"] = 0.4 * at["T"]
    both = term("combined_slip", strength=1.0), term("rolling_resistance", force=400.0)
    tougher = replace(
        CAR, rolling_resistance_front=90.0 + 400.0 * B / 2.7, rolling_resistance_rear=80.0 + 400.0 * A / 2.7
    )
    np.testing.assert_allclose(rates(at, *both), rates(at, both[0], car=tougher), rtol=1e-12, atol=1e-12)


def test_load_transfer_moves_what_lever_and_wheelbase_say():
    at = driving()
    at["delta"] = 0.0 * at["delta"]
    f = forces(at)
    moved = (f["fxf"] + f["fxr"] - 0.42 * at["vx"] ** 2) * 0.55 / 2.7
    load_f, load_r = 1500.0 * G * B / 2.7, 1500.0 * G * A / 2.7
    check(at, change(at, -f["fyf"] * moved / load_f, f["fyr"] * moved / load_r), term("load_transfer", cg_height=0.55))


def test_axle_terms_scale_what_they_name():
    at = driving()
    f = forces(at)
    stiff = (
        7900.0 * np.sin(1.45 * np.arctan(9.9 * f["alpha_f"])) - f["fyf"],
        6800.0 * np.sin(1.45 * np.arctan(15.0 * f["alpha_r"])) - f["fyr"],
    )
    check(at, change(at, *stiff), term("tire_stiffness", front_scale=0.9, rear_scale=1.2))
    load_f, load_r = 1500.0 * G * B / 2.7, 1500.0 * G * A / 2.7
    down = f["fyf"] * 0.8 * at["vx"] ** 2 / load_f, f["fyr"] * 1.1 * at["vx"] ** 2 / load_r
    expected = change(at, *down)
    # Load also rolls: 90 N and 80 N grow alike; at the steered axle that force has a part across.
    front, rear = -90.0 * 0.8 * at["vx"] ** 2 / load_f, -80.0 * 1.1 * at["vx"] ** 2 / load_r
    across = front * np.sin(at["delta"])
    expected += np.stack([(rear + front * np.cos(at["delta"])) / 1500.0, across / 1500.0, A * across / 2600.0])
    check(at, expected, term("aero_downforce", front=0.8, rear=1.1))


def test_a_higher_centre_of_gravity_takes_force_in_turns_as_well():
    """Beside the degressive law, each axle loses what (h^2 - h_0^2) makes of two unequal loads; none without height."""
    at = driving()
    f = forces(at)
    higher, pitching = (term("load_transfer", variant, cg_height=0.2) for variant in ("higher", "degressive"))
    lost = 4.0 * (0.75**2 - 0.55**2) / (0.58 * 2.7) ** 2 * ((f["fyf"] + f["fyr"]) / (1500.0 * G)) ** 2
    peak, slope = 1.0 - 0.1 * lost, 1.0 - 0.25 * lost
    moved = pitching_loads(at, 0.2)
    expected = [
        D * load**0.9 * peak * np.sin(1.45 * np.arctan(B_ * load**-0.4 * slope / peak * alpha)) - plain
        for D, B_, load, alpha, plain in (
            (7900.0, 11.0, 1.0 - moved / (1500.0 * G * B / 2.7), f["alpha_f"], f["fyf"]),
            (6800.0, 12.5, 1.0 + moved / (1500.0 * G * A / 2.7), f["alpha_r"], f["fyr"]),
        )
    ]
    check(at, change(at, *expected), higher)
    # Straight on, only the load along the car moves.
    straight = {**at, "vy": 0.0 * at["vy"], "r": 0.0 * at["r"], "delta": 0.0 * at["delta"]}
    np.testing.assert_allclose(rates(straight, higher), rates(straight, pitching), rtol=1e-12, atol=1e-12)


def pitching_loads(at, height):
    """Return m a_x h/L by the plain forces [N]."""
    f = forces(at)
    along = f["fxr"] + f["fxf"] * np.cos(at["delta"]) - f["fyf"] * np.sin(at["delta"]) - 0.42 * at["vx"] ** 2
    return along * height / 2.7


def test_forces_at_the_centre_of_gravity():
    at = driving()
    zero = 0.0 * at["vx"]
    check(at, np.stack([-0.2 * at["vx"] ** 2 / 1500.0, zero, zero]), term("aero_drag", drag=0.2))
    check(at, np.stack([zero, zero, -2000.0 * at["r"] / 2600.0]), term("yaw_moment_differential", yaw_damping=2000.0))
    check(at, np.stack([zero, zero - G * np.sin(0.04), zero]), term("road_bank", angle=0.04))
    wave = -G * np.sin(0.04 * np.sin(2 * np.pi * at["s"] / 120.0 + 0.3))
    check(at, np.stack([wave, zero, zero]), term("road_grade", "wave", amplitude=0.04, wavelength=120.0, phase=0.3))


def test_what_turns_with_the_wheels_resists_the_change_of_speed_alone():
    """(m + mass) v_x' = F_x + m v_y r: at a steady speed nothing of it shows, nor in v_y and r."""
    at = driving()
    plain, heavy = rates(at), rates(at, term("rotating_mass", mass=60.0))
    np.testing.assert_allclose(1560.0 * heavy[0], 1500.0 * plain[0], rtol=1e-12)
    np.testing.assert_array_equal(heavy[1:], plain[1:])


def test_rolling_resistance_points_along_the_wheels_and_is_shared_as_the_static_loads():
    at = driving()
    front, rear = -70.0 * B / 2.7, -70.0 * A / 2.7
    across = front * np.sin(at["delta"])
    expected = [(rear + front * np.cos(at["delta"])) / 1500.0, across / 1500.0, A * across / 2600.0]
    check(at, np.stack(expected), term("rolling_resistance", force=70.0))


@pytest.mark.parametrize("driven", ["rear", "front"])
def test_a_locked_axle_that_drives_turns_with_the_difference_of_its_wheels_slips(driven):
    from dataclasses import replace

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


def test_wind_is_the_drag_of_the_air_met():
    at = driving()
    at["yaw"], at["vy"] = 0.0 * at["vx"], 0.0 * at["vx"]
    # Head on, the air met is v_x - wx: the textbook formula.
    head = term("wind", wx=-8.0, wy=0.0)
    expected = np.zeros((3, 400))
    expected[0] = -0.42 * ((at["vx"] + 8.0) ** 2 - at["vx"] ** 2) / 1500.0
    # 1e-6 under the roots keeps them smooth at standstill; relative to v_x^2 >= 36 it is below 1e-7.
    np.testing.assert_allclose(rates(at, head) - rates(at), expected, atol=1e-7)
    # From the left, the car is pushed to the right.
    assert np.all((rates(at, term("wind", "side", wx=0.0, wy=-6.0)) - rates(at))[1] < 0.0)


def test_body_terms_equal_another_vehicle():
    from dataclasses import replace

    at = driving()
    for changes, model in (
        ({"mass": 1725.0}, term("mass", scale=1.15)),
        ({"yaw_inertia": 3120.0}, term("yaw_inertia", scale=1.2)),
        ({"cg_to_front_axle": A - 0.1, "cg_to_rear_axle": B + 0.1}, term("cg_shift", dx=0.1)),
    ):
        np.testing.assert_allclose(rates(at, model), rates(at, car=replace(CAR, **changes)), rtol=1e-12)
    # Static capacity follows L/l: moving the CG forward loads the front axle.
    shifted = replace(
        CAR,
        cg_to_front_axle=A - 0.1,
        cg_to_rear_axle=B + 0.1,
        front_tire=MagicFormula(11.0, 1.45, 7900.0 * (B + 0.1) / B),
        rear_tire=MagicFormula(12.5, 1.45, 6800.0 * (A - 0.1) / A),
    )
    np.testing.assert_allclose(rates(at, term("cg_shift", "loaded", dx=0.1)), rates(at, car=shifted), rtol=1e-12)


def test_axles_that_follow_their_load():
    from dataclasses import replace

    at = driving()
    # In proportion: a heavier car with D and rolling resistance scaled; degressively: D^0.9, B C D by the root.
    heavy = {"mass": 1500 * 1.15, "rolling_resistance_front": 90 * 1.15, "rolling_resistance_rear": 80 * 1.15}
    for variant, peak, slope in (("loaded", 1.0, 1.0), ("degressive", 0.9, 0.5)):
        tires = [
            MagicFormula(t.B * 1.15 ** (slope - peak), t.C, t.D * 1.15**peak) for t in (CAR.front_tire, CAR.rear_tire)
        ]
        other = replace(CAR, front_tire=tires[0], rear_tire=tires[1], **heavy)
        np.testing.assert_allclose(rates(at, term("mass", variant, scale=1.15)), rates(at, car=other), rtol=1e-11)


def test_actuator_terms_equal_other_inputs():
    at = driving()
    np.testing.assert_allclose(rates(at, term("steer_gain", gain=0.9)), rates({**at, "delta": 0.9 * at["delta"]}))
    np.testing.assert_allclose(rates(at, term("steer_offset", offset=0.01)), rates({**at, "delta": at["delta"] + 0.01}))
    scaled = np.where(at["T"] > 0, 0.9, 0.8) * at["T"]
    np.testing.assert_allclose(
        rates(at, term("drive_gain", drive_gain=0.9, brake_gain=0.8)), rates({**at, "T": scaled})
    )
    # Gain before offset, in whatever order the vehicle file lists them.
    both = rates(at, term("steer_offset", offset=0.01), term("steer_gain", gain=0.9))
    np.testing.assert_allclose(both, rates({**at, "delta": 0.9 * at["delta"] + 0.01}))


def test_declared_exact_degeneracies_hold():
    at = driving()
    # Whole-curve friction is the peak with both stiffnesses.
    np.testing.assert_allclose(
        rates(at, term("friction_scale", "curve", scale=0.8)),
        rates(at, term("friction_scale", scale=0.8), term("tire_stiffness", front_scale=0.8, rear_scale=0.8)),
        rtol=1e-12,
    )
    # Mass is seen as forces over mass only: curve, torque, drag, rolling resistance and inertia by 1/scale.
    k = 1 / 1.15
    np.testing.assert_allclose(
        rates(at, term("mass", scale=1.15)),
        rates(
            at,
            term("friction_scale", "curve", scale=k),
            term("drive_gain", drive_gain=k, brake_gain=k),
            term("yaw_inertia", scale=k),
            term("aero_drag", drag=0.42 * (k - 1)),
            term("rolling_resistance", force=170.0 * (k - 1)),
        ),
        # The nominal resistance is shared 90 to 80, a term's as the static loads are, so that 2 N lie differently.
        atol=2e-4,
    )
    # A constant grade is a rolling resistance m g sin(angle), all of it while the wheels point ahead.
    straight = {**at, "delta": 0.0 * at["delta"]}
    np.testing.assert_allclose(
        rates(straight, term("road_grade", angle=0.03)),
        rates(straight, term("rolling_resistance", force=1500.0 * G * np.sin(0.03))),
        rtol=1e-12,
    )


def test_a_vehicle_file_names_terms_and_their_variants_parameters():
    spec = EffectSpec("road_bank", {"amplitude": 0.03, "wavelength": 80.0, "phase": 0.0}, "wave")
    (built,) = build_terms(CAR.with_effects(spec))
    assert built.parameters["wavelength"] == 80.0
    with pytest.raises(VehicleError, match="drive_gain.brake_gain is 1e.30, beyond any car's: 0.075 to 10"):
        build_terms(CAR.with_effects(EffectSpec("drive_gain", {"drive_gain": 1.0, "brake_gain": 1e30})))
    with pytest.raises(VehicleError, match="lacks amplitude, phase"):
        build_terms(CAR.with_effects(EffectSpec("road_bank", {"wavelength": 80.0}, "wave")))
    with pytest.raises(VehicleError, match="no parameter 'angel'"):
        build_terms(CAR.with_effects(EffectSpec("road_bank", {"angel": 0.1})))
    with pytest.raises(VehicleError, match="no variant 'curved'"):
        build_terms(CAR.with_effects(EffectSpec("friction_scale", {"scale": 0.9}, "curved")))


@pytest.mark.parametrize(("name", "variant"), EXAMPLES)
def test_casadi_evaluates_the_same_text(name, variant):
    import casadi as ca

    from split_cli.export.symbolic import CASADI

    at = driving(20)
    names = list(at)
    model = SingleTrack(CAR, [CATALOGUE[name](EXAMPLES[name, variant], variant)])
    symbols = [ca.SX.sym(n) for n in names]
    states = {n: ca.SX.sym(n) for n in model.state_names}
    flow = model.flow(**dict(zip(names, symbols, strict=True)), ops=CASADI, states=states)
    outputs = [*model.balance(flow), *(flow.rates[n] for n in model.state_names)]
    function = ca.Function("f", [*symbols, *states.values()], [ca.vertcat(*outputs)])
    rng = np.random.default_rng(3)
    values = {n: rng.normal(0.0, 0.1, 20) for n in model.state_names}
    reference = model.flow(**at, states=values)
    expected = np.stack([*model.balance(reference), *(reference.rates[n] for n in model.state_names)])
    got = function.map(20)(*(row[None] for row in [*at.values(), *values.values()])).toarray()
    np.testing.assert_allclose(got, expected, rtol=1e-11, atol=1e-11)


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
