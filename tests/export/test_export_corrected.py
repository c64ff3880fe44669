"""A corrected vehicle file from a drive to the controller: trained, exported, driven, verified, forged."""

import ctypes
import json
from dataclasses import replace

import casadi
import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.export import command as export_command
from split_cli.cli.train import command as train_command
from split_cli.export.casadi_function import committee_function, model_step
from split_cli.export.compiler import STRICT_FLAGS
from split_cli.export.symbolic import build_nominal
from split_cli.export.tables import build_tables
from split_cli.export.verify import verify_folder
from split_cli.files import sha256_of_file
from split_cli.learning.labels import inputs_along
from split_cli.learning.training_set import read_set
from split_cli.logs.drive import Drive, write_drive
from split_cli.prediction import make_predictor
from split_cli.scoring.rollouts import Correction, roll_out
from split_cli.vehicle.effects import build_terms
from split_cli.vehicle.integration import Situation, integrate_with_memory
from split_cli.vehicle.parameters import EffectSpec, write_vehicle
from split_cli.vehicle.single_track import SingleTrack
from tests.export.effect_cases import STEP, Exported, effect
from tests.factories import MissingForce, road_car

PERIOD, WINDOW = 0.01, 5


def lagging_drive(vehicle) -> Drive:
    """Return 10 runs of 5 s of a car as the vehicle file has it, which loses 15 % of its front grip as well.

    Recorded every 10 ms; commands are linear over steps of 50 ms, as a controller gives them.
    """
    model = SingleTrack(vehicle, [*build_terms(vehicle), MissingForce({"front_grip_loss": 0.15})])
    rng = np.random.default_rng(6)
    runs, samples = 10, 501
    speed = rng.uniform(10.0, 25.0, runs)
    knots = STEP * np.arange(101)

    def command(size: np.ndarray, rate: float) -> np.ndarray:
        waves = np.sin(np.outer(rng.uniform(0.3, 1.0, runs) * rate, knots) + rng.uniform(0.0, 6.0, (runs, 1)))
        return np.array([np.interp(PERIOD * np.arange(samples), knots, wave) for wave in size[:, None] * waves])

    steer = command(np.minimum(0.08, 9.0 * vehicle.wheelbase / speed**2), 3.0)
    torque = command(np.full(runs, 900.0), 2.0)
    state, memory = np.column_stack([np.zeros((runs, 3)), speed, np.zeros((runs, 2))]), None
    path = [state]
    for k in range(samples - 1):
        inputs = torque[:, k : k + 2], steer[:, k : k + 2]
        state, memory = integrate_with_memory(model, state, *inputs, PERIOD, 4, Situation(states=memory))
        path.append(state)
    columns = dict(zip(("X", "Y", "yaw", "vx", "vy", "r"), np.stack(path, axis=1).reshape(-1, 6).T, strict=True))
    number = np.repeat(np.arange(runs), samples)
    clock = np.tile(PERIOD * np.arange(samples), runs) + 10.0 * number
    columns |= {"t": clock, "T": torque.ravel(), "delta": steer.ravel()}
    return Drive("real.parquet", columns, number.astype(np.int32), PERIOD)


@pytest.fixture(scope="module")
def corrected(tmp_path_factory):
    """A corrected vehicle file, a recording of that car, which has more, and the exported set of both."""
    folder = tmp_path_factory.mktemp("corrected")
    vehicle = road_car(effects=(effect("steer_lag"),))
    write_vehicle(vehicle, folder / "vehicle_corrected.yaml")
    drive = lagging_drive(vehicle)
    write_drive(drive, folder / "real.parquet")
    arguments = [str(folder / "real.parquet"), "--vehicle", str(folder / "vehicle_corrected.yaml")]
    # The angle that has arrived is a feature of its own: a state of a term as any other signal.
    arguments += ["--features", "alpha_f,alpha_r,torque_ratio,steer_lag.angle"]
    arguments += ["--hyperparameters", "default", "-o", str(folder / "car.split")]
    done = CliRunner().invoke(train_command, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    targets = ["--target", "c", "--target", "casadi"]
    arguments = [str(folder / "car.split"), *targets, "-o", str(folder / "out"), "--queries", "300"]
    done = CliRunner().invoke(export_command, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return folder, drive


def test_a_corrected_vehicle_goes_from_training_to_the_controller(corrected, compiler, tmp_path):
    """The exported C against the rollouts that `split evaluate` scores, and against the exported CasADi step."""
    folder, drive = corrected
    training_set = read_set(folder / "car.split")
    model = SingleTrack(training_set.vehicle)
    z = training_set.features.compute(model, drive)
    correction = Correction(training_set.features, z, make_predictor("projected", training_set).mean)
    starts = 501 * np.arange(0, 10, 2) + 100
    expected = roll_out(model, drive, starts, 15, WINDOW, correction)
    assert np.abs(expected - roll_out(model, drive, starts, 15, WINDOW)).max() > 0.01
    flags = [*STRICT_FLAGS, "-O0", "-shared", "-fPIC"]
    compiler.build([folder / "out" / "car.c"], tmp_path / "car.so", flags)
    graph = build_nominal(model, training_set.features)
    car = Exported(model, graph, training_set, "car", ctypes.CDLL(str(tmp_path / "car.so")))
    step = casadi.Function.load(str(folder / "out" / "car_step.casadi"))
    memory = inputs_along(model, drive).situation.states
    commands = np.stack([drive["T"], drive["delta"]], axis=1)
    for start, path in zip(starts, expected, strict=True):
        state = np.array([drive[name][start] for name in ("X", "Y", "yaw", "vx", "vy", "r")])
        for k in range(15):
            now, end = start + k * WINDOW, start + (k + 1) * WINDOW
            x, u = np.concatenate([state, commands[now], memory[now]]), (commands[end] - commands[now]) / STEP
            after, exact = np.empty(9), np.empty(9)
            # Python takes one substep a sample of 10 ms: five a step.
            car.call("step_rk4", x, u, STEP, WINDOW, after)
            # Features along the rollout take the recorded lag at a recorded speed: the same to rounding.
            assert np.allclose(after[:6], path[k], rtol=0, atol=1e-9)
            car.call("step", x, u, STEP, exact)
            assert np.allclose(exact, np.asarray(step(x, u, STEP)).ravel(), rtol=1e-10, atol=1e-10)
            # The lag's next state is that of the recording, which is solved exactly.
            assert np.allclose(exact[8], memory[end, 0], rtol=1e-12, atol=1e-14)
            state = after[:6]


def test_an_export_with_memory_verifies_and_a_forged_step_does_not(corrected):
    folder, _ = corrected
    out = folder / "out"
    findings = verify_folder(out)
    assert all(finding.passed for finding in findings)
    assert "drives" in next(f.detail for f in findings if f.check == "c: self-test")
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["memory"]["states"] == ["steer_lag.angle [rad]"]
    assert "steer_lag.angle [rad]" in (out / "car.h").read_text()
    training_set = read_set(folder / "car.split")
    slower = replace(training_set.vehicle, effects=(EffectSpec("steer_lag", {"tau": 0.1001}),))
    graph = build_nominal(SingleTrack(slower), training_set.features)
    forged = model_step(committee_function(build_tables(training_set), "car"), graph, "car_step")
    forged.save(str(out / "car_step.casadi"))
    manifest["files"]["car_step.casadi"] = sha256_of_file(out / "car_step.casadi")
    (out / "manifest.json").write_text(json.dumps(manifest))
    assert {f.check: f.passed for f in verify_folder(out)}["casadi: answers"] is False
