"""Every term of the catalogue against a formula written out again, its neutral point, and mirrored driving."""

from dataclasses import replace
from itertools import permutations

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


def test_loads_of_several_terms_add_up():
    """What braking moves is a smaller share of a load that air adds to; in proportion, and by one power for all."""
    at = driving()
    at["delta"] = 0.0 * at["delta"]
    f, free = forces(at), replace(CAR, rolling_resistance_front=0.0, rolling_resistance_rear=0.0)
    moved = (f["fxf"] + f["fxr"] + 170.0 - 0.42 * at["vx"] ** 2) * 0.55 / 2.7
    load_f, load_r = 1500.0 * G * B / 2.7, 1500.0 * G * A / 2.7
    front = 1.2 + (0.8 * at["vx"] ** 2 - moved) / load_f
    rear = 1.2 + (1.1 * at["vx"] ** 2 + moved) / load_r
    several = (
        ("mass", "loaded", {"scale": 1.2}),
        ("aero_downforce", "", {"front": 0.8, "rear": 1.1}),
        ("load_transfer", "", {"cg_height": 0.55}),
    )
    for order in permutations(several):
        found = rates(at, *(term(name, variant, **values) for name, variant, values in order), car=free)
        across = (front * f["fyf"] + rear * f["fyr"]) / 1800.0 - at["vx"] * at["r"]
        turning = (A * front * f["fyf"] - B * rear * f["fyr"]) / 2600.0
        np.testing.assert_allclose(found[1:], np.stack([across, turning]), rtol=1e-9, atol=1e-9)
    two = (
        term("aero_downforce", "degressive", front=0.8, rear=1.1),
        term("load_transfer", "degressive", cg_height=0.55),
    )
    found = rates(at, *two, car=free)
    axles = [
        D * load**0.9 * np.sin(1.45 * np.arctan(B_ * load**-0.4 * alpha))
        for D, B_, load, alpha in ((7900.0, 11.0, front - 0.2, f["alpha_f"]), (6800.0, 12.5, rear - 0.2, f["alpha_r"]))
    ]
    np.testing.assert_allclose(found[2], (A * axles[0] - B * axles[1]) / 2600.0, rtol=1e-9, atol=1e-9)


def test_no_sum_of_loads_lifts_an_axle():
    """A light, nose-heavy car that brakes hard keeps next to nothing on its rear axle, in any order of the terms."""
    at = {**driving(), "T": -4.0 * np.abs(driving()["T"])}
    several = [
        term("load_transfer", "degressive", cg_height=1.3),
        term("mass", "degressive", scale=0.6),
        term("cg_shift", "degressive", dx=0.9),
        term("aero_downforce", "degressive", front=-0.5, rear=-1.0),
    ]
    for order in permutations(several):
        assert np.isfinite(rates(at, *order)).all()


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
