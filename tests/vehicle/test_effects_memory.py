"""Terms with a memory: states and delays along a recording, in windows, and what sensors do to a recording."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from split_cli.errors import VehicleError
from split_cli.vehicle.effects import CATALOGUE, Recording
from split_cli.vehicle.effects.recording import ResultCache, first_order_response, phase_shifted, play_response, shifted
from split_cli.vehicle.integration import integrate_recorded
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.windows import recorded_inputs
from tests.factories import road_car

CAR = road_car(max_brake_torque=6500.0)
PERIOD = 0.01


def term(name: str, variant: str = "", **parameters: float):
    return CATALOGUE[name](parameters, variant)


LATE_LOAD = term("load_transfer", "late", cg_height=0.5, tau=0.08)


def inputs(t):
    return 600.0 + 500.0 * np.sin(1.7 * t), 0.03 * np.sin(2.1 * t) + 0.02 * np.sin(5.3 * t)


def test_a_delay_of_whole_and_half_samples():
    clock = Recording(PERIOD, ((0, 6), (6, 10)))
    x = np.array([0.0, 1, 2, 3, 4, 5, 100, 101, 102, 103])
    np.testing.assert_allclose(shifted(x, 0.02, clock), [0, 0, 0, 1, 2, 3, 100, 100, 100, 101])
    np.testing.assert_allclose(shifted(x, 0.015, clock), [0, 0, 0.5, 1.5, 2.5, 3.5, 100, 100, 100.5, 101.5])
    np.testing.assert_allclose(shifted(x, -0.01, clock), [1, 2, 3, 4, 5, 5, 101, 102, 103, 103])


def test_noise_that_is_moved_by_its_phase_keeps_its_strength_and_its_place():
    """Whole samples are moved as they are, and half of one damps nothing: straight lines leave half the variance."""
    x, clock = np.random.default_rng(4).normal(size=1001), Recording(0.01, ((0, 601), (601, 1001)))
    moved = phase_shifted(x, 0.02, clock)
    np.testing.assert_allclose(moved[2:601], x[:599], atol=1e-12)
    np.testing.assert_allclose(moved[603:], x[601:-2], atol=1e-12)
    half = phase_shifted(x, 0.005, clock)
    assert np.var(half) == pytest.approx(np.var(x), rel=0.01) and np.var(shifted(x, 0.005, clock)) < 0.6 * np.var(x)
    np.testing.assert_allclose(phase_shifted(half, -0.005, clock), x, atol=0.1)
    # A wave of 10 Hz is where it was 3.7 ms before.
    t = 0.01 * np.arange(600)
    wave = phase_shifted(np.sin(20.0 * np.pi * t), 0.0037, Recording(0.01, ((0, 600),)))
    np.testing.assert_allclose(wave, np.sin(20.0 * np.pi * (t - 0.0037)), atol=1e-9)


def test_first_order_response_is_exact_for_ramps():
    t = np.arange(300) * PERIOD
    y = first_order_response(2.0 * t, 4.0, Recording.single(PERIOD, 300))
    # tau y' = u - y, u = 2 t, y(0) = 0: y = 2 (t - tau + tau e^(-t/tau)).
    np.testing.assert_allclose(y, 2.0 * (t - 0.25 + 0.25 * np.exp(-4.0 * t)), atol=1e-12)


def test_a_constant_rate_answers_as_a_rate_that_is_given_at_every_sample():
    clock = Recording(PERIOD, ((0, 40), (40, 41), (41, 100)))
    x = np.random.default_rng(2).standard_normal(100)
    for rate in (0.0, 1e-7, 3.0, 400.0):
        np.testing.assert_array_equal(
            first_order_response(x, rate, clock), first_order_response(x, np.full(100, rate), clock)
        )


def test_memory_starts_anew_and_steady_at_a_gap():
    clock = Recording(PERIOD, ((0, 50), (50, 100)))
    x = np.concatenate([np.linspace(0, 1, 50), np.linspace(7, 9, 50)])
    whole = first_order_response(x, 5.0, clock)
    np.testing.assert_allclose(whole[50:], first_order_response(x[50:], 5.0, Recording.single(PERIOD, 50)))
    assert whole[50] == 7.0
    assert play_response(x, 0.5, clock)[50] == 7.0


def test_play_keeps_still_until_pushed():
    x = np.concatenate([np.linspace(0, 1, 11), np.linspace(0.9, -1.0, 20)])
    y = play_response(x, 0.4, Recording.single(PERIOD, 31))
    np.testing.assert_allclose(y[10], 0.8)  # pushed up, half the play behind
    np.testing.assert_allclose(y[11:15], 0.8)  # going back through the play, nothing moves
    np.testing.assert_allclose(y[-1], -0.8)  # pulled down


@pytest.mark.parametrize("shared, tau", [(0.0, 0.06), (0.05, 0.06), (0.05, -0.03), (0.05, -0.08)])
def test_a_changed_lag_is_the_command_and_the_difference_of_two_responses(shared, tau):
    t = np.arange(600) * PERIOD
    torque, delta = inputs(t)
    clock = Recording.single(PERIOD, 600)

    def arrived(*terms):
        vx = np.full(600, 12.0)
        flow = SingleTrack(CAR, terms).flow(vx, 0.0 * vx, 0.0 * vx, torque, delta, recording=clock)
        return flow.delta

    def response(tau):
        return first_order_response(delta, 1.0 / tau, clock) if tau > 0.0 else delta

    found = arrived(term("steer_lag", "changed", tau=tau, shared=shared))
    np.testing.assert_allclose(found, delta + response(shared + tau) - response(shared), atol=1e-14)
    if not shared:
        np.testing.assert_allclose(found, arrived(term("steer_lag", tau=tau)), atol=1e-14)


@pytest.mark.parametrize(
    "model",
    [
        term("steer_lag", tau=0.08),
        term("drive_lag", "changed", tau=0.1, shared=0.05),
        term("drive_lag", tau=0.15),
        term("tire_relaxation", length=0.6),
        term("tire_relaxation", "changed", length=-0.2, shared=0.6),
        LATE_LOAD,
        term("steer_backlash", width=0.015),
        term("feature_lag", tau=0.08),
    ],
    ids=lambda model: model.id,
)
def test_windows_with_states_meet_an_independent_integrator(model):
    """RK4 over recorded inputs against an adaptive integrator on velocities and states together."""
    track = SingleTrack(CAR, [model])
    t = np.arange(201) * PERIOD
    torque, steer = inputs(t)
    start = np.array([[20.0, 0.1, 0.05]])
    end = integrate_recorded(track, start, torque[None], steer[None], PERIOD)[0]
    names = track.state_names
    steady = track.flow(*start[0], torque[0], steer[0]).values

    def rhs(time, x):
        T, delta = np.interp(time, t, torque), np.interp(time, t, steer)
        flow = track.flow(*x[:3], T, delta, states=dict(zip(names, x[3:], strict=True)))
        return [*track.balance(flow), *(flow.rates[n] for n in names)]

    x0 = [*start[0], *(steady[n] for n in names)]
    # Steps of at most a sample: the inputs have kinks there.
    oracle = solve_ivp(rhs, (0.0, 2.0), x0, rtol=1e-9, atol=1e-10, max_step=PERIOD).y[:3, -1]
    # RK4's own error at |lambda| step up to about 1 (relaxation at 20 m/s: 0.33) is 1e-6 of a unit signal;
    # backlash switches inside steps and is held to a hundredth of its effect.
    tolerance = 2e-4 if model.id == "steer_backlash" else 1e-5
    np.testing.assert_allclose(end, oracle, atol=tolerance)


def test_states_along_a_recording_continue_in_a_window():
    """Starting a window with the states of its history is the same as having driven there."""
    track = SingleTrack(CAR, [term("steer_lag", tau=0.2), term("steer_delay", delay=0.035)])
    t = np.arange(400) * PERIOD
    torque, steer = inputs(t)
    clock = Recording.single(PERIOD, 400)
    late = shifted(steer, 0.035, clock)
    start = np.array([[20.0, 0.0, 0.0]])
    whole = integrate_recorded(track, start, torque[None], late[None], PERIOD)
    middle = integrate_recorded(track, start, torque[None, :201], late[None, :201], PERIOD)
    recorded = recorded_inputs(track, np.repeat(start, 400, axis=0), torque, steer, clock)
    np.testing.assert_allclose(recorded.steer_angle, late)
    resumed = integrate_recorded(
        track, middle, torque[None, 200:], late[None, 200:], PERIOD, 1, recorded.situation.at(np.array([200]))
    )
    # The lag along the recording is exact, inside RK4 it is right to (step/tau)^4/120, 5e-8.
    np.testing.assert_allclose(resumed, whole, atol=1e-7)
    steady = integrate_recorded(track, middle, torque[None, 200:], late[None, 200:], PERIOD)
    assert np.abs(steady - whole).max() > 1e-5  # forgetting the history is visible


def test_relaxation_is_a_lag_in_distance():
    """At twice the speed the force answers in half the time."""
    model = term("tire_relaxation", length=1.2)
    clock = Recording.single(0.001, 2000)
    for speed in (10.0, 20.0):
        steer = np.where(np.arange(2000) < 100, 0.0, 0.01)
        zero = np.zeros(2000)
        flow = SingleTrack(CAR, [model]).flow(zero + speed, zero, zero, zero, steer, recording=clock)
        force = flow.front.lateral_force
        reached = np.flatnonzero(force >= (1 - np.exp(-1)) * force[-1])[0] - 100
        assert reached == pytest.approx(1200.0 / speed, abs=2)


def test_late_load_builds_up_to_what_moves_at_once():
    """A step of the force along the car moves F h/L (1 - exp(-t/tau)), and tyres in proportion follow the load."""
    t = np.arange(400) * 0.001
    steps = np.where(t < 0.1, 0.0, 400.0)
    zero = np.zeros(len(t))
    clock = Recording.single(0.001, len(t))
    late, at_once = (
        SingleTrack(CAR, [one]).flow(zero + 20.0, zero, zero, steps, zero, recording=clock)
        for one in (LATE_LOAD, term("load_transfer", cg_height=0.5))
    )
    share = np.where(t < 0.1, 0.0, 1.0 - np.exp(-(t - 0.1) / 0.08))
    for axle in ("front", "rear"):
        begin, end, found = getattr(at_once, axle).D[0], getattr(at_once, axle).D[-1], getattr(late, axle).D
        np.testing.assert_allclose(found, begin + share * (end - begin), atol=0.02 * abs(end - begin))


def test_sensor_delay_reads_as_both_actuators_late():
    t = np.arange(500) * PERIOD
    torque, steer = inputs(t)
    clock = Recording.single(PERIOD, 500)
    velocity = (20.0 + 0.0 * t, 0.1 * np.sin(t), 0.2 * np.cos(t))
    one = SingleTrack(CAR, [term("sensor_delay", delay=0.043)])
    other = SingleTrack(CAR, [term("steer_delay", delay=0.043), term("drive_delay", delay=0.043)])
    for a, b in zip(
        one.velocity_derivative(*velocity, torque, steer, recording=clock),
        other.velocity_derivative(*velocity, torque, steer, recording=clock),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)


def test_steering_that_is_logged_late_acts_as_it_was_before_the_log():
    t = np.arange(500) * PERIOD
    torque, steer = inputs(t)
    clock = Recording.single(PERIOD, 500)
    velocity = (20.0 + 0.0 * t, 0.1 * np.sin(t), 0.2 * np.cos(t))
    late = term("steer_signal_delay", delay=3 * PERIOD)
    logged = late.corrupt({"delta": steer}, clock)["delta"]
    one = SingleTrack(CAR, [late]).velocity_derivative(*velocity, torque, logged, recording=clock)
    other = SingleTrack(CAR, []).velocity_derivative(*velocity, torque, steer, recording=clock)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a[:-4], b[:-4], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "model",
    [
        term("sensor_lever_arm", dx=0.4),
        term("sensor_misalignment", angle=0.03),
        term("sensor_delay", delay=0.02),
        term("steer_signal_delay", delay=0.02),
    ],
    ids=lambda model: model.id,
)
def test_correcting_undoes_what_the_sensor_did(model):
    t = np.arange(300) * PERIOD
    torque, steer = inputs(t)
    columns = {
        "t": t,
        "vx": 20 + np.sin(t),
        "vy": 0.3 * np.sin(2 * t),
        "r": 0.2 * np.cos(t),
        "T": torque,
        "delta": steer,
    }
    clock = Recording.single(PERIOD, 300)
    bad = model.corrupt(columns, clock)
    assert any(np.abs(bad[n] - columns[n]).max() > 1e-3 for n in ("vx", "vy", "delta"))
    good = model.correct(bad, clock)
    for name in columns:
        # A delay of whole samples is undone exactly but for what was pushed off the ends.
        np.testing.assert_allclose(good[name][:-2], columns[name][:-2], atol=1e-12)
    # The first-order signs of the contract: v_y + dx r, v_y - angle v_x.
    if model.id == "sensor_lever_arm":
        np.testing.assert_allclose(bad["vy"], columns["vy"] + 0.4 * columns["r"])
    if model.id == "sensor_misalignment":
        np.testing.assert_allclose(bad["vy"], columns["vy"] - 0.03 * columns["vx"], atol=5e-4)


def test_feature_lag_keeps_the_past_and_changes_no_force():
    track, plain = SingleTrack(CAR, [term("feature_lag", tau=0.08)]), SingleTrack(CAR)
    clock, zero = Recording.single(PERIOD, 200), np.zeros(200)
    t = np.arange(200) * PERIOD
    torque, steer = inputs(t)
    flow = track.flow(zero + 20.0, zero, zero, torque, steer, recording=clock)
    np.testing.assert_array_equal(
        track.balance(flow), plain.balance(plain.flow(zero + 20.0, zero, zero, torque, steer))
    )
    for name, source in (("alpha_f", flow.front.slip_angle), ("alpha_r", flow.rear.slip_angle), ("torque", torque)):
        np.testing.assert_allclose(
            flow.values[f"feature_lag.{name}"], first_order_response(source + zero, 1.0 / 0.08, clock)
        )


def test_feature_lag_of_no_time_is_the_feature_itself():
    zero = np.zeros(200)
    torque, steer = inputs(np.arange(200) * PERIOD)
    track = SingleTrack(CAR, [term("feature_lag", tau=0.0)])
    flow = track.flow(zero + 20.0, zero, zero, torque, steer, recording=Recording.single(PERIOD, 200))
    np.testing.assert_array_equal(flow.values["feature_lag.alpha_f"], flow.front.slip_angle)


def test_a_simulation_that_has_diverged_is_no_term_that_is_too_fast():
    """A relaxation reacts within length/v_x: at the speeds of a diverged rollout that is no time at all."""
    track = SingleTrack(CAR, [term("tire_relaxation", length=0.1)])
    still = np.zeros((2, 3))
    state = np.array([[20.0, 0.0, 0.0], [1e9, 3.0, np.nan]])
    with np.errstate(all="ignore"):
        end = integrate_recorded(track, state, still, still, PERIOD)
    alone = integrate_recorded(track, state[:1], still[:1], still[:1], PERIOD)
    assert end[0] == pytest.approx(alone[0], rel=1e-6) and not np.isfinite(end[1]).all()
    with pytest.raises(VehicleError, match="too fast"):
        too_fast = SingleTrack(CAR, [term("steer_lag", tau=1.1e-4)])
        integrate_recorded(too_fast, state[:1], still[:1], still[:1], 0.2)


@pytest.mark.parametrize("name", ["steer_lag", "drive_lag"])
@pytest.mark.parametrize("tau", [0.0, 1e-5])
def test_a_lag_of_no_time_is_the_nominal_model(name, tau):
    """The limit of tau y' = u - y at tau = 0, which a fit of several terms may reach and then runs freely."""
    t = np.arange(101) * PERIOD
    torque, steer = (np.tile(u, (2, 1)) for u in inputs(t))
    state = np.array([[20.0, 0.0, 0.0], [12.0, 0.1, 0.05]])
    end = [
        integrate_recorded(track, state, torque, steer, PERIOD)
        for track in (SingleTrack(CAR, [term(name, tau=tau)]), SingleTrack(CAR))
    ]
    np.testing.assert_allclose(*end, rtol=1e-12)
    short = integrate_recorded(SingleTrack(CAR, [term(name, tau=1e-3)]), state, torque, steer, PERIOD)
    assert 0.0 < np.abs(short - end[0]).max() < 0.02


def test_a_relaxation_of_no_length_is_the_nominal_model_at_every_rate():
    steer = np.full((1, 3), 0.02)
    ends = [
        integrate_recorded(track, np.array([[20.0, 0.0, 0.0]]), 0.0 * steer, steer, 0.1, substeps=20)
        for track in (SingleTrack(CAR, [term("tire_relaxation", length=0.0)]), SingleTrack(CAR))
    ]
    np.testing.assert_allclose(*ends, rtol=1e-12)


def test_cached_results_are_of_the_very_arrays_that_are_given():
    """A new array may get the id of one that was deleted; it must not get its result."""
    cache, rng = ResultCache(), np.random.default_rng(3)
    clock = Recording(PERIOD, ((0, 40), (40, 100)), cache=cache)
    for _ in range(50):
        x = rng.normal(size=100)
        expected = first_order_response(x, 4.0, replace(clock, cache=None))
        np.testing.assert_array_equal(first_order_response(x, 4.0, clock), expected)
        assert first_order_response(x, 2.0 + 2.0, clock) is first_order_response(x, 4.0, clock)
        assert not np.array_equal(first_order_response(x, 5.0, clock), expected)
        del x


def test_a_learned_lag_acts_by_the_share_that_is_known():
    """delta + k (arrived - delta): the file's angle where nothing is known, the lag's where all is, else between."""
    car = road_car()
    learned, plain = (SingleTrack(car, [CATALOGUE["steer_lag"]({"tau": 0.1}, v)]) for v in ("learned", ""))
    assert learned.asks_knowledge and not plain.asks_knowledge
    states, knowledge = {"steer_lag.angle": np.full(3, 0.02)}, np.array([0.0, 0.25, 1.0])
    motion = [np.full(3, value) for value in (20.0, 0.3, 0.1, 200.0, 0.06)]
    flow = learned.flow(*motion, states=states, knowledge=knowledge)
    np.testing.assert_allclose(flow.delta, [0.06, 0.05, 0.02], rtol=1e-14)
    # What arrives does not depend on what is known.
    np.testing.assert_allclose(flow.rates["steer_lag.angle"], (0.06 - 0.02) / 0.1, rtol=1e-14)
    assert plain.flow(*motion, states=states, knowledge=knowledge).delta == pytest.approx(0.02)
    # Not said otherwise, as for a label, the whole of it acts, along a window too.
    steer = np.array([[0.06, 0.05, 0.06]])
    windows = recorded_inputs(
        learned, np.array([[20.0, 0.3, 0.1]] * 3), np.full(3, 200.0), steer[0], Recording.single(0.01, 3)
    ).windows(np.array([0]), 2)
    ends = []
    for model, known in ((plain, None), (learned, None), (SingleTrack(car), None), (learned, np.zeros(1))):
        asked, state = windows.knowing(known), np.array([[20.0, 0.3, 0.1]])
        if not model.terms:
            asked = replace(asked, situation=replace(asked.situation, states=None))
        ends.append(asked.predict(model, state, asked.jacobian(model, state)))
    np.testing.assert_allclose(ends[1], ends[0], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(ends[3], ends[2], rtol=0.0, atol=1e-9)
