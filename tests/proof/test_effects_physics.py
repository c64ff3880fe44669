"""Each effect of the plant against a hand formula: what it changes within 10 ms, channel by channel.

A car with the effect is driven; the same car without it is carried along and let free for 10 ms at a time
(`replay.predict_windows`). The difference over 10 ms is an acceleration, which is compared with the one that a formula
gives from the run's own states: forces of single wheels by `tire_force`, balances on paper. Response within the
window (relaxation 27 mm, that is 1 to 2 ms, and yaw damping of some 1/0.1 s) takes up to a fifth of a lateral
force, hence the tolerance on the slope; the shape must fit closely.
"""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.plant.cars import ROAD_CAR
from split_cli.plant.drivers import DRIVER_STYLES
from split_cli.plant.replay import predict_windows, recorded_motion
from split_cli.plant.simulation import commands_at
from split_cli.plant.tire import tire_force
from split_cli.proof.cars import bare
from split_cli.proof.cases import variants_of_truth
from split_cli.proof.concealed import CONCEALED, draw_effect
from split_cli.proof.recordings import exact_motion
from split_cli.proof.strange import STRANGE, draw_strange
from split_cli.proof.tracks import random_track
from split_cli.proof.truth import GUESSES
from split_cli.proof.world import ProofWorld, Trip, drive
from split_cli.vehicle.effects import CATALOGUE

WINDOW = 0.01
SENSORS = ("sensor_lever_arm", "sensor_misalignment", "sensor_delay", "gyro_curve", "gyro_late", "speed_gain")
G = 9.80665


@pytest.fixture(scope="module")
def world() -> ProofWorld:
    car = replace(bare(ROAD_CAR), command_ramp=1.0)
    track = random_track(np.random.default_rng(11), 900.0, 0.4, 6.0)
    return ProofWorld(car, track, replace(car, steer_rate=0.9))


class Seen:
    """A run at the windows' middles, and the accelerations that the car without the effect lacks there."""

    def __init__(self, run, without: ProofWorld) -> None:
        steps = int(round(WINDOW / 2e-3))
        predicted = predict_windows(run, without.car, without.road, horizon=WINDOW)
        count = len(predicted)
        ends = recorded_motion(run)[steps::steps, 3:6][:count]
        keep = slice(100, None)
        self.lack = ((ends - predicted) / WINDOW)[keep]
        rows = (np.arange(count) * steps + steps // 2)[keep]
        self.run, self.rows, self.car = run, rows, without.car
        self.t = run.t[rows]
        self.vx, self.vy, self.r = recorded_motion(run)[rows, 3:6].T
        self.slip, self.tangent = run.states[rows, 10:14], run.states[rows, 14:18]
        self.fx, self.fy = run.outputs[rows, 6:10], run.outputs[rows, 10:14]
        self.T, self.delta = commands_at(run, "T", self.t), commands_at(run, "delta", self.t)

    def channel(self, name: str) -> np.ndarray:
        return self.run.channel(name)[self.rows]


def axle(tire, alpha, load, friction=1.0):
    """Lateral force of an axle whose two wheels share its load [N]."""
    if np.ndim(friction) == 0:
        return 2.0 * tire_force(tire, 0.0, alpha, load / 2.0, float(friction))[1]
    rows = zip(np.broadcast_to(alpha, friction.shape), friction, strict=True)
    return np.array([2.0 * tire_force(tire, 0.0, float(a), load / 2.0, float(f))[1] for a, f in rows])


def lateral(seen: Seen, car, *, delta=None, rear_angle=0.0, load_front=None, load_rear=None, friction=1.0):
    """Accelerations (0, v_y', r') that the two axles' lateral forces give, by the textbook's single track."""
    delta = seen.delta if delta is None else delta
    a, b = car.cg_to_front_axle, car.cg_to_rear_axle
    alpha_f = delta - np.arctan((seen.vy + a * seen.r) / seen.vx)
    alpha_r = rear_angle - np.arctan((seen.vy - b * seen.r) / seen.vx)
    front = axle(car.front_tire, alpha_f, car.static_load_front if load_front is None else load_front, friction)
    rear = axle(car.rear_tire, alpha_r, car.static_load_rear if load_rear is None else load_rear, friction)
    front = front * np.cos(delta)
    return 0.0 * front, (front + rear) / car.mass, (a * front - b * rear) / car.yaw_inertia


def less(one, other):
    return tuple(x - y for x, y in zip(one, other, strict=True))


def along(force):
    """Accelerations of a longitudinal specific force."""
    return force, None, None


def expected(term: str, seen: Seen, with_: ProofWorld, without: ProofWorld, size: float, known: dict):
    """The hand formulas: accelerations of v_x, v_y, r that the effect adds; None where nothing is claimed."""
    old, new = without.car, with_.car
    pull = 1.0 / (old.wheel_radius * old.mass)
    at_rest = lateral(seen, old)
    if term == "aero_drag":
        return along(-known["drag"] * seen.vx**2 / old.mass)
    if term == "rolling_resistance":
        return along(-size * G + 0.0 * seen.vx)
    if term == "road_grade":
        s = seen.channel("s") % seen.run.lap_length
        return along(-G * np.sin(np.interp(s, np.arange(512) * seen.run.lap_length / 512, with_.road.grade)))
    if term == "road_bank":
        s = seen.channel("s") % seen.run.lap_length
        bank = np.interp(s, np.arange(len(with_.road.bank)) * with_.road.spacing, with_.road.bank)
        return None, -G * np.sin(bank), None
    if term == "wind":
        yaw = seen.channel("yaw")
        wx, wy = with_.road.wind_x[0], with_.road.wind_y[0]
        air_x = seen.vx - wx * np.cos(yaw) - wy * np.sin(yaw)
        air_y = seen.vy + wx * np.sin(yaw) - wy * np.cos(yaw)
        half = 0.5 * old.air_density / old.mass
        moving, still = np.hypot(air_x, air_y), np.hypot(seen.vx, seen.vy)
        return (
            -half * old.drag_area * (moving * air_x - still * seen.vx),
            -half * old.side_area * (moving * air_y - still * seen.vy),
            None,
        )
    if term == "drive_gain":
        gain = np.where(seen.T > 0, known["drive_gain"], known["brake_gain"])
        return along((gain - 1.0) * seen.T * pull)
    if term == "drive_delay":
        return along((commands_at(seen.run, "T", seen.t - size) - seen.T) * pull)
    if term == "drive_lag":
        return along((seen.channel("T_actual") - seen.T) * pull)
    if term in ("steer_offset", "steer_gain", "steer_delay", "steer_lag", "steer_backlash"):
        return less(lateral(seen, old, delta=seen.channel("delta_actual")), at_rest)
    if term == "friction_scale":
        return less(lateral(seen, old, friction=with_.road.friction[0]), at_rest)
    if term == "friction_patch":
        # Only inside and outside of the whole car: each axle meets the edge at its own time.
        s = seen.channel("s") % seen.run.lap_length
        place = np.arange(512) * with_.road.spacing
        ends = [np.interp(s + d, place, with_.road.friction) for d in (1.2, -1.7)]
        change = less(lateral(seen, old, friction=ends[0]), at_rest)
        return tuple(np.where(np.isclose(*ends), c, np.nan) for c in change)
    if term == "grip_fade":
        tau = known["tau"]
        return less(lateral(seen, old, friction=1.0 - size * (1.0 - np.exp(-seen.t / tau))), at_rest)
    if term == "tire_stiffness":
        return less(lateral(seen, new), at_rest)
    if term == "aero_downforce":
        lift = 0.5 * new.air_density * seen.vx**2
        loads = (
            old.static_load_front + lift * new.downforce_area_front,
            old.static_load_rear + lift * new.downforce_area_rear,
        )
        return less(lateral(seen, old, load_front=loads[0], load_rear=loads[1]), at_rest)
    if term == "load_transfer":
        # The suspension passes a_x on late; the state of the run knows it.
        moved = old.mass * seen.run.states[seen.rows, 20] * size / old.wheelbase
        loads = old.static_load_front - moved, old.static_load_rear + moved
        # What one axle gains the other loses: the moment is what shows, the sum a difference of large numbers.
        return None, None, less(lateral(seen, old, load_front=loads[0], load_rear=loads[1]), at_rest)[2]
    if term == "combined_slip":
        coupled = np.zeros((len(seen.t), 4))
        for wheel in range(4):
            tire = new.front_tire if wheel < 2 else new.rear_tire
            load = seen.channel("load_" + ("fl", "fr", "rl", "rr")[wheel])
            angle = np.arctan(seen.tangent[:, wheel])
            both = tire_force(tire, seen.slip[:, wheel], angle, load)[1]
            coupled[:, wheel] = both - tire_force(tire, 0.0, angle, load)[1]
        front, rear = coupled[:, :2].sum(axis=1), coupled[:, 2:].sum(axis=1)
        a, b = old.cg_to_front_axle, old.cg_to_rear_axle
        return None, (front + rear) / old.mass, (a * front - b * rear) / old.yaw_inertia
    if term == "tire_relaxation":
        motion, change = recorded_motion(seen.run), np.zeros((len(seen.t), 2))
        vx, vy, r = motion[:, 3:6].T
        for number, (tire, load, arm) in enumerate(
            (
                (old.front_tire, old.static_load_front, old.cg_to_front_axle),
                (old.rear_tire, old.static_load_rear, -old.cg_to_rear_axle),
            )
        ):
            steer = seen.run.channel("delta_actual") if number == 0 else 0.0
            angle = steer - np.arctan((vy + arm * r) / vx)
            # The car without the effect has a relaxation too, of tire.relaxation_lateral.
            kept, own = np.exp(-vx * 2e-3 / tire.relaxation_lateral), np.zeros(len(vx))
            for k in range(1, len(vx)):
                own[k] = kept[k] * own[k - 1] + (1.0 - kept[k]) * np.tan(angle[k])
            built = np.arctan(seen.tangent[:, 2 * number])
            change[:, number] = axle(tire, built, load) - axle(tire, np.arctan(own[seen.rows]), load)
        # Both axles lag alike, so that their moments all but cancel: only the sum is a fair test.
        return None, change.sum(axis=1) / old.mass, None
    if term == "mass":
        return along(seen.T / old.wheel_radius * (1.0 / new.mass - 1.0 / old.mass))
    if term == "yaw_inertia":
        return (
            None,
            None,
            np.gradient(seen.run.channel("r"), 2e-3)[seen.rows] * (1.0 - new.yaw_inertia / old.yaw_inertia),
        )
    if term == "cg_shift":
        return less(lateral(seen, new), at_rest)
    if term == "yaw_moment_differential":
        # Spins differ by r track/R; the torque c times that, over R, acts on an arm of a track.
        return None, None, -size * seen.r * (old.track_rear / old.wheel_radius) ** 2 / old.yaw_inertia
    raise KeyError(term)


SIZES = {
    "steer_backlash": 0.02,
    "drive_lag": 0.15,
    "steer_lag": 0.06,
    "friction_scale": 0.25,
    "grip_fade": 0.25,
    "friction_patch": 0.3,
    "combined_slip": 1.0,
    "tire_relaxation": 0.25,
    "load_transfer": 0.4,
}


@pytest.mark.parametrize("term", [t for t in CONCEALED if t not in SENSORS])
def test_an_effect_adds_the_accelerations_that_paper_says(term, world):
    if term == "yaw_moment_differential":
        car = replace(world.car, track_front=1.5, track_rear=1.5)
        world = replace(world, car=car)
    effect = draw_effect(term, np.random.default_rng(4), world)
    size = SIZES.get(term, effect.start)
    without = effect.neutral(world)
    with_ = effect.apply(without, size)
    known = {**effect.shape, **effect.known(without, size)}
    run = drive(with_, Trip(DRIVER_STYLES["brisk"], 0.65, 45.0, 3))
    seen = Seen(run, without)
    claimed = 0
    for channel, formula in enumerate(expected(term, seen, with_, without, size, known)):
        lack = seen.lack[:, channel]
        if formula is None or np.nanstd(formula) + np.abs(np.nanmean(formula)) < 1e-9:
            continue
        valid = np.isfinite(formula)
        formula, lack = formula[valid], lack[valid]
        slope = float(formula @ lack / (formula @ formula))
        # Share of the squared acceleration that the formula leaves.
        left = float(np.sum((lack - slope * formula) ** 2) / np.sum(lack**2))
        assert 0.75 < slope < 1.1, f"{['v_x', 'v_y', 'r'][channel]}: {slope:.3f}"
        assert left < 0.05, f"{['v_x', 'v_y', 'r'][channel]}: {left:.3f} of the square is left"
        claimed += 1
    assert claimed


@pytest.mark.parametrize("term", CONCEALED)
def test_every_parameter_of_a_truth_is_known_or_has_a_guess(term, world):
    effect = draw_effect(term, np.random.default_rng(4), world)
    known = {**effect.shape, **effect.known(effect.neutral(world), effect.start)}
    variants = variants_of_truth(effect, effect.known(effect.neutral(world), effect.start))
    assert variants
    for variant in variants:
        assert set(CATALOGUE[term].parameter_units(variant)) <= {*known, *GUESSES}, variant


def test_sensor_effects_report_what_their_geometry_says(world):
    run = drive(world, Trip(DRIVER_STYLES["brisk"], 0.6, 20.0, 3))
    t = run.t[500:-500:7]
    true = exact_motion(run, world.sensor, t)
    vx, vy, r = true[:, 3:6].T

    def seen(term, size):
        draw = draw_effect if term in CONCEALED else draw_strange
        effect = draw(term, np.random.default_rng(1), world)
        return exact_motion(run, effect.apply(world, size).sensor, t), effect.known(world, size)

    shown, known = seen("sensor_lever_arm", 0.7)
    np.testing.assert_allclose(shown[:, 4] - vy, known["dx"] * r, atol=1e-12)
    np.testing.assert_array_equal(shown[:, [0, 1, 2, 3, 5]], true[:, [0, 1, 2, 3, 5]])
    shown, known = seen("sensor_misalignment", 0.03)
    # The speed is kept, its direction is turned back by the angle; pose and yaw rate know nothing of it.
    np.testing.assert_allclose(np.hypot(shown[:, 3], shown[:, 4]), np.hypot(vx, vy), rtol=1e-12)
    np.testing.assert_allclose(np.arctan2(shown[:, 4], shown[:, 3]), np.arctan2(vy, vx) - known["angle"], atol=1e-12)
    shown, known = seen("sensor_delay", 0.05)
    np.testing.assert_allclose(shown, exact_motion(run, world.sensor, t - 0.05), atol=1e-12)
    shown, _ = seen("gyro_curve", 0.2)
    np.testing.assert_allclose(np.abs(shown[:, 5] / r - 1.0), 0.2 * np.abs(r), atol=1e-9)
    shown, _ = seen("gyro_late", 0.05)
    np.testing.assert_allclose(shown[:, 5], np.interp(t - 0.05, run.t, run.channel("r")), atol=1e-12)
    shown, _ = seen("speed_gain", 0.02)
    np.testing.assert_allclose(np.abs(shown[:, 3] / vx - 1.0), 0.02, atol=1e-12)


def strange_expected(kind: str, seen: Seen, with_: ProofWorld, size: float):
    """The hand formulas of effects outside the catalogue."""
    old, f = with_.car, with_.faults
    pull = 1.0 / (old.wheel_radius * old.mass)
    spin = seen.run.states[:, 6:10].mean(axis=1)
    clock = seen.run.t
    if kind == "torque_bend":
        return along(np.where(seen.T > 0, -size * seen.T**2 / old.max_torque, 0.0) * pull)
    if kind == "ripple":
        angle = np.concatenate([[0.0], np.cumsum(spin[:-1] * np.diff(clock))])
        return along(size * old.max_torque * np.sin(f.ripple_order * angle[seen.rows]) * pull)
    if kind == "brake_fade":
        braking = np.maximum(-seen.run.channel("T_actual"), 0.0) * spin / f.brake_heat_capacity
        heat = np.zeros(len(clock))
        for k in range(1, len(clock)):
            heat[k] = heat[k - 1] + 2e-3 * (braking[k - 1] - heat[k - 1] / f.brake_cooling_time)
        lost = size * np.minimum(heat[seen.rows], 1.0)
        return along(np.where(seen.T < 0, -lost * seen.T, 0.0) * pull)
    if kind == "torque_steer":
        turned = f.torque_steer * seen.channel("T_actual") / old.max_torque
        return less(lateral(seen, old, delta=seen.delta + turned), lateral(seen, old))
    if kind == "rear_steer":
        turned = size * seen.delta * (seen.vx / f.rear_steer_speed - 1.0)
        return less(lateral(seen, old, rear_angle=turned), lateral(seen, old))
    if kind == "damaged_tire":
        corner = next(i for i, c in enumerate(("fl", "fr", "rl", "rr")) if getattr(f, f"grip_loss_{c}") > 0)
        # What the wheel still gives is (1 - loss) of what it would give.
        lost = -size / (1.0 - size) * seen.fy[:, corner]
        arm = old.cg_to_front_axle if corner < 2 else -old.cg_to_rear_axle
        return None, lost / old.mass, arm * lost / old.yaw_inertia
    if kind == "slosh":
        w = 2.0 * np.pi * f.slosh_frequency
        ay = seen.run.channel("ay")
        place, rate, force = 0.0, 0.0, np.zeros(len(clock))
        for k in range(len(clock)):
            force[k] = f.slosh_mass * (w * w * place + 0.2 * w * rate + ay[k])
            rate -= 2e-3 * force[k] / f.slosh_mass
            place += 2e-3 * rate
        force = force[seen.rows]
        return None, force / old.mass, f.slosh_arm * force / old.yaw_inertia
    if kind == "stuck_brake":
        braking = np.maximum(-seen.run.channel("T_actual"), 0.0)
        stuck = np.zeros(len(clock))
        for k in range(1, len(clock)):
            stuck[k] = max(stuck[k - 1] * np.exp(-2e-3 / f.stuck_brake_time), size * braking[k])
        stuck = np.where(braking == 0.0, stuck, 0.0)[seen.rows]
        return along(-stuck * pull)
    raise KeyError(kind)


@pytest.mark.parametrize(
    "kind",
    ["torque_bend", "ripple", "brake_fade", "torque_steer", "rear_steer", "damaged_tire", "slosh", "stuck_brake"],
)
def test_an_effect_outside_the_catalogue_does_what_its_equation_says(kind, world):
    effect = draw_strange(kind, np.random.default_rng(4), world)
    with_ = effect.apply(effect.neutral(world), effect.start)
    run = drive(with_, Trip(DRIVER_STYLES["brisk"], 0.65, 45.0, 3))
    seen = Seen(run, world)
    for channel, formula in enumerate(strange_expected(kind, seen, with_, effect.start)):
        if formula is None or np.std(formula) < 1e-9:
            continue
        lack = seen.lack[:, channel]
        slope = float(formula @ lack / (formula @ formula))
        left = float(np.sum((lack - slope * formula) ** 2) / np.sum(lack**2))
        assert 0.75 < slope < 1.1, f"{['v_x', 'v_y', 'r'][channel]}: {slope:.3f}"
        assert left < 0.1, f"{['v_x', 'v_y', 'r'][channel]}: {left:.3f} of the square is left"


def test_a_stability_control_brakes_the_outer_wheel_only_beyond_its_threshold(world):
    effect = draw_strange("pulses", np.random.default_rng(4), world)
    with_ = effect.apply(world, 6.0)
    run = drive(with_, Trip(DRIVER_STYLES["racer"], 0.75, 45.0, 3))
    seen = Seen(run, world)
    active = np.abs(seen.lack[:, 0]) > 0.5 * with_.faults.pulse_torque / (world.car.wheel_radius * world.car.mass)
    assert 0.01 < active.mean() < 0.4
    # It drags the car, and its moment on the narrow track turns the car out of the turn: against r.
    assert (seen.lack[active, 0] < 0).mean() > 0.97
    assert (seen.lack[active, 2] * seen.r[active] < 0).mean() > 0.9


def test_hot_tires_lose_grip_only_after_sliding(world):
    effect = draw_strange("hot_tires", np.random.default_rng(4), world)
    with_ = effect.apply(world, 0.2)
    run = drive(with_, Trip(DRIVER_STYLES["brisk"], 0.65, 45.0, 3))
    seen = Seen(run, world)
    sliding = np.maximum(run.outputs[:, 16 - 1], 0.0)
    warm = np.zeros(len(run.t))
    for k in range(1, len(warm)):
        warm[k] = warm[k - 1] + 2e-3 / with_.faults.tire_heat_time * (
            sliding[k - 1] / with_.faults.tire_heat_power - warm[k - 1]
        )
    # Tyres that were as hot as can be all along would just have less grip, which has a name.
    assert (warm[seen.rows] < 1.0).mean() > 0.5
    loss = 0.2 * np.minimum(warm[seen.rows], 1.0)
    lost = -loss / (1.0 - loss) * seen.fy.sum(axis=1) / world.car.mass
    slope = float(lost @ seen.lack[:, 1] / (lost @ lost))
    assert 0.75 < slope < 1.1


def test_without_an_effect_the_prediction_is_the_run(world):
    run = drive(world, Trip(DRIVER_STYLES["brisk"], 0.6, 20.0, 3))
    assert np.abs(Seen(run, world).lack).max() < 1e-9


def test_every_strange_effect_has_a_name_of_its_own():
    assert not set(STRANGE) & set(CONCEALED)
