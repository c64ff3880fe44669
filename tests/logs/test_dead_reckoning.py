"""Lateral velocity from accelerations: planted truth with bank, roll and bias, and conditioning as oracle."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import MapError
from split_cli.logs.assembling import dead_reckoning
from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.assembling.dead_reckoning import lateral_velocity_from_accelerations
from split_cli.logs.assembling.derivation import DerivationInputs
from split_cli.logs.assembling.derivations import derivation_named
from tests.factories import road_car
from tests.logs.planted import PlantedDrive, planted_map

CAR = road_car()
PERIOD = 0.02
NAME = "lateral-velocity-from-accelerations"


def _laps(seconds: float = 120.0, seed: int = 0) -> dict[str, np.ndarray]:
    """Return channels of a car on turns of five seconds with straights between; its tyres slide in hard ones."""
    t = np.arange(0.0, seconds, PERIOD)
    vx = 20.0 + 3.0 * np.sin(0.11 * t)
    size = np.array([0.30, -0.12, 0.22, -0.34, 0.1])[(t // 12.0).astype(int) % 5]
    phase = np.clip((t % 12.0) / 5.0, 0.0, 1.0)
    r = size * np.sin(np.pi * phase) ** 2
    across = vx * r
    vy = CAR.cg_to_rear_axle * r - vx * (7e-3 * across + 3e-4 * across**3)
    rng = np.random.default_rng(seed)
    felt = 1.06 * (np.gradient(vy, PERIOD) + across) + 0.4 + 0.2 * np.sin(0.05 * t)
    return {"t": t, "vx": vx, "vy": vy, "r": r, "ay": felt + 0.1 * rng.standard_normal(len(t))}


def _derived(columns: dict[str, np.ndarray], **more) -> DerivationInputs:
    given = {name: columns[name] for name in ("vx", "r", "ay")}
    return DerivationInputs(given, PERIOD, [slice(0, len(columns["vx"]))], **{"vehicle": CAR, "settings": {}, **more})


def test_planted_lateral_velocity_comes_back_through_bias_bank_and_roll():
    columns = _laps()
    made = lateral_velocity_from_accelerations(columns, PERIOD, [slice(0, len(columns["vx"]))], CAR)
    error = made.vy - columns["vy"]
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.sqrt(np.mean(columns["vy"] ** 2))
    assert made.gain == pytest.approx(0.06, abs=0.02)  # a_y = 1.06 v_x r: v_x r times 1.06
    assert made.bias[0] > 0.1 and made.bias[1] < 0.7
    assert np.mean(np.abs(error) < 1.96 * made.std) > 0.9
    assert made.contradicted == 0.0


def test_it_forgets_gaps_and_does_not_need_the_stiffness_of_the_file():
    columns = _laps()
    half = len(columns["vx"]) // 2
    segments = [slice(0, half - 100), slice(half - 100, len(columns["vx"]))]
    softer = replace(CAR, rear_tire=replace(CAR.rear_tire, B=0.5 * CAR.rear_tire.B))
    made = lateral_velocity_from_accelerations(columns, PERIOD, segments, softer)
    assert np.sqrt(np.mean((made.vy - columns["vy"]) ** 2)) < 0.15 * np.sqrt(np.mean(columns["vy"] ** 2))


def test_smoother_is_conditioning_of_the_joint_normal_distribution():
    rng, count = np.random.default_rng(1), 24
    step, turned = np.full(count, 0.1), rng.normal(0.0, 0.4, count)
    fresh = np.isin(np.arange(count), (0, 13))
    held = rng.random(count) < 0.4
    told, slipping = rng.normal(0.0, 0.1, count), rng.normal(0.0, 30.0, count)
    unknown, variance = np.full(count, 2.0), np.full(count, 0.05)
    mean, deviation, unused = dead_reckoning._smoother(step, turned, fresh, unknown, held, told, slipping, variance)
    assert unused == 0.0
    # The same from the covariance of all nodes: each noise is followed through to where it arrives.
    walk, bias_walk = dead_reckoning._WALK, dead_reckoning._BIAS_WALK
    causes = []
    slip = np.zeros((count, 4))
    slip[:, 3] = 1.0
    causes.append(dead_reckoning._SLIP[1] * slip)
    for node in range(count):
        noise = np.zeros((4, 4))
        if fresh[node]:
            noise[0, 0], noise[1, 1] = np.sqrt(unknown[node]), dead_reckoning._BIAS
        else:
            h = step[node]
            q = np.array(
                [
                    [walk**2 * h + bias_walk**2 * h**3 / 3, -(bias_walk**2) * h * h / 2],
                    [-(bias_walk**2) * h * h / 2, bias_walk**2 * h],
                ]
            )
            noise[:2, :2] = np.linalg.cholesky(q)
        if node == 0:
            noise[2, 2] = dead_reckoning._ROLL
        for column in noise.T[:3]:
            path = np.zeros((count, 4))
            path[node] = column
            for later in range(node + 1, count):
                F = dead_reckoning._transition(step[later], turned[later], fresh[later])
                path[later] = F @ path[later - 1]
            causes.append(path)
    A = np.stack([path[:, 0] for path in causes], axis=1)
    H = (A + slipping[:, None] * np.stack([path[:, 3] for path in causes], axis=1))[held]
    prior = slipping[held] * dead_reckoning._SLIP[0]
    gain = A @ H.T @ np.linalg.inv(H @ H.T + np.diag(variance[held]))
    np.testing.assert_allclose(mean[:, 0], gain @ (told[held] - prior), atol=1e-9)
    np.testing.assert_allclose(deviation**2, np.diag(A @ A.T - gain @ H @ A.T), atol=1e-9)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"ay": lambda c: -c["ay"]}, r"contradicts v_x r at \d+ % of the moments of gentle driving\. "),
        ({"ay": lambda c: c["ay"] / 9.81}, r"a_y fits 0\.1\d times v_x r"),
        ({"r": lambda c: 0.0 * c["r"] + 0.5, "ay": lambda c: 0.5 * c["vx"]}, "gentle driving"),
    ],
)
def test_what_cannot_be_held_is_refused(change, what):
    columns = _laps()
    columns |= {name: make(columns) for name, make in change.items()}
    with pytest.raises(MapError, match=what):
        derivation_named(NAME).run(_derived(columns))


def test_it_needs_the_vehicle():
    with pytest.raises(MapError, match="--vehicle|needs the vehicle"):
        derivation_named(NAME).run(_derived(_laps(), vehicle=None))


def test_rows_far_from_gentle_driving_are_left_out():
    columns = _laps(240.0)
    circle = slice(2000, 6000)  # 80 s at 8 m/s^2
    columns["r"][circle] = 0.4
    columns["ay"][circle] = columns["vx"][circle] * 0.4 + 0.4
    made = derivation_named(NAME).run(_derived(columns))
    unknown = np.isnan(made.columns["vy"])
    assert unknown[3500:4500].all() and not unknown[:1900].any() and not unknown[-3000:].any()
    assert "rows left out" in made.how and np.isfinite(made.columns["vy_std"]).all()


def test_a_log_without_lateral_velocity_becomes_a_drive_that_says_so():
    planted = PlantedDrive()
    whole = planted_map()
    entries = tuple(entry for entry in whole.channels if entry.channel not in ("vy", "X", "Y", "yaw"))
    lacking = replace(whole, channels=entries)
    with pytest.raises(MapError, match=f"vy: map a recorded signal, or derive it with --derive {NAME}"):
        assemble_drive(planted.recording(), lacking, CAR)
    made = assemble_drive(planted.recording(), lacking, CAR, IngestSettings(derive=(NAME,)))
    drive = made.drive
    assert drive.metadata.kinds["vy"].startswith("derived: v_y from a_y - v_x r")
    assert drive.metadata.noise_of("vy").sigma is None
    assert "vy_std" in drive.columns
    assert any("its label repeats a_y" in text for text in made.quality.warnings)


def test_yaw_rate_from_yaw_is_its_derivative():
    t = np.arange(0.0, 10.0, PERIOD)
    inputs = DerivationInputs({"yaw": np.sin(0.6 * t)}, PERIOD, [slice(0, len(t))], None, {})
    made = derivation_named("yaw-rate-from-yaw").run(inputs)
    np.testing.assert_allclose(made.columns["r"], 0.6 * np.cos(0.6 * t), atol=2e-4)
