"""A lag that acts as far as a set knows: exports against rollouts, and against the file where nothing is known."""

import ctypes
from dataclasses import replace

import casadi
import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.export import command as export_command
from split_cli.export.compiler import STRICT_FLAGS
from split_cli.export.reference import CommitteeReference
from split_cli.export.stepped_model import SteppedModel
from split_cli.export.symbolic import build_nominal
from split_cli.export.tables import build_tables
from split_cli.export.targets import casadi_functions
from split_cli.learning.features import Z2
from split_cli.learning.in_memory import train_in_memory
from split_cli.learning.labels import compute_labels, inputs_along
from split_cli.learning.training_set import TrainingSet, write_set
from split_cli.learning.trust import Trust
from split_cli.logs.drive import Drive
from split_cli.prediction import make_predictor
from split_cli.scoring.application import correction_from
from split_cli.scoring.rollouts import roll_out
from split_cli.vehicle.integration import integrate_recorded
from split_cli.vehicle.parameters import EffectSpec
from split_cli.vehicle.single_track import SingleTrack
from tests.export.effect_cases import STEP, Exported
from tests.export.export_support import source_of
from tests.export.test_export_corrected import WINDOW, lagging_drive
from tests.factories import road_car

LAG = EffectSpec("steer_lag", {"tau": 0.1}, "learned")


@pytest.fixture(scope="module")
def learned() -> tuple[TrainingSet, Drive]:
    """A set of a car whose steering is late, which is trusted in part, and the drive it was learned from."""
    car = road_car(effects=(LAG,))
    drive = lagging_drive(car)
    labels = compute_labels(drive, car, Z2)
    gentle = labels.take(np.abs(labels.z[:, 0]) < 0.02)  # of slips up to 0.06 rad
    made = train_in_memory([gentle.take(slice(None, None, 3))], car)
    return replace(made, found_effects=1, trust=Trust((0.5, 0.9, 0.8), "given")), drive


@pytest.fixture(scope="module", params=["bcm", "rbcm", "projected", "table"])
def exported(request, learned, compiler, tmp_path_factory):
    """The C and the CasADi step of a predictor."""
    folder, training_set = tmp_path_factory.mktemp(request.param), learned[0]
    write_set(training_set, folder / "car.split")
    arguments = [str(folder / "car.split"), "--predictor", request.param, "--target", "c", "--target", "casadi"]
    done = CliRunner().invoke(export_command, [*arguments, "-o", str(folder / "out"), "--queries", "200"])
    assert done.exit_code == 0, done.output
    compiler.build([folder / "out" / "car.c"], folder / "car.so", [*STRICT_FLAGS, "-O0", "-shared", "-fPIC"])
    model = SingleTrack(training_set.vehicle)
    graph = build_nominal(model, training_set.features)
    car = Exported(model, graph, training_set, "car", ctypes.CDLL(str(folder / "car.so")))
    return request.param, car, casadi.Function.load(str(folder / "out" / "car_step.casadi"))


def test_python_and_casadi_step_alike(learned):
    """What exports are compared with steps as rollouts do; CasADi steps as it does."""
    training_set, drive = learned
    model = SingleTrack(training_set.vehicle)
    graph, predictor = build_nominal(model, Z2, STEP), make_predictor("bcm", training_set)
    stepped = SteppedModel(graph, training_set, CommitteeReference(training_set))
    z, starts = Z2.compute(model, drive), 501 * np.arange(10) + 200
    x = np.stack([drive[c][starts] for c in ("X", "Y", "yaw", "vx", "vy", "r", "T", "delta")], axis=1)
    x = np.column_stack([x, inputs_along(model, drive).situation.states[starts]])
    u = np.stack([(drive[c][starts + WINDOW] - drive[c][starts]) / STEP for c in ("T", "delta")], axis=1)
    stepped.substeps = WINDOW
    exact, recorded = stepped.one_step(x, u, np.zeros((len(x), 2)))
    correction = correction_from(predictor, drive, z, starts)
    expected = roll_out(model, drive, starts, 1, WINDOW, correction)[:, 0]
    np.testing.assert_allclose(recorded[:, :6], expected, rtol=0.0, atol=1e-9)
    step = casadi_functions(build_tables(training_set), graph, "car", training_set).step
    found = np.array([np.asarray(step(*one, STEP)).ravel() for one in zip(x, u, strict=True)])
    np.testing.assert_allclose(found, exact, rtol=0.0, atol=1e-9)


def test_exports_step_as_rollouts_do(exported, learned):
    """In double, C and rollouts share equations and steps of Runge-Kutta: only rounding is between them."""
    name, car, step = exported
    training_set, drive = learned
    model, predictor = SingleTrack(training_set.vehicle), make_predictor(name, training_set)
    z = training_set.features.compute(model, drive)
    starts = (501 * np.arange(10)[:, None] + np.arange(50, 450, 100)).ravel()
    correction = correction_from(predictor, drive, z, starts)
    known = correction.answers(z[starts], True)[1]
    assert known.min() < 0.3 and known.max() > 0.9
    (expected,) = roll_out(model, drive, starts, 1, WINDOW, correction).transpose(1, 0, 2)
    whole = roll_out(model, drive, starts, 1, WINDOW, replace(correction, informed=None))
    assert np.abs(whole[:, 0] - expected).max() > 1e-4
    memory = inputs_along(model, drive).situation.states
    commands = np.stack([drive["T"], drive["delta"]], axis=1)
    for start, after in zip(starts, expected, strict=True):
        x = np.concatenate([[drive[c][start] for c in ("X", "Y", "yaw", "vx", "vy", "r")], commands[start]])
        x, u = np.concatenate([x, memory[start]]), (commands[start + WINDOW] - commands[start]) / STEP
        found, exact = np.empty(9), np.empty(9)
        car.call("step_rk4", x, u, STEP, WINDOW, found)
        np.testing.assert_allclose(found[:6], after, rtol=0.0, atol=1e-11)
        car.call("step", x, u, STEP, exact)
        np.testing.assert_allclose(np.asarray(step(x, u, STEP)).ravel(), exact, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("real", ["double", "float"])
def test_a_step_asks_the_predictor_once(learned, compiler, tmp_path, real):
    """Mean, slopes and what is known are answers to one query, since all are asked at one place."""
    training_set = learned[0]
    source = source_of(training_set, real)
    entry = "real *open)\n{\n"
    assert source.source.count(entry) == 1
    text = source.source.replace(entry, f"{entry}    asked += 1;\n").replace("\nenum {", "\nint asked;\nenum {", 1)
    (tmp_path / "car.h").write_text(source.header)
    (tmp_path / "car.c").write_text(text)
    compiler.build([tmp_path / "car.c"], tmp_path / "car.so", ["-std=c99", "-O0", "-shared", "-fPIC"])
    library = ctypes.CDLL(str(tmp_path / "car.so"))
    x = np.array([1.0, 2.0, 0.3, 10.0, 0.2, 0.2, 300.0, 0.02, 0.03], dtype=real)
    u, end, size = np.array([50.0, 0.3], dtype=real), np.empty(9, dtype=real), len(x)
    A, B = np.empty((size, size), dtype=real), np.empty((size, 2), dtype=real)
    step = (ctypes.c_float if real == "float" else ctypes.c_double)(STEP)
    calls = {"step": (x, u, step, end), "step_rk4": (x, u, step, 4, end), "linearise": (x, u, step, A, B)}
    calls["rates"] = (x, u, end)
    asked = ctypes.c_int.in_dll(library, "asked")
    for name, arguments in calls.items():
        before = asked.value
        getattr(library, f"car_{name}")(*(a.ctypes if isinstance(a, np.ndarray) else a for a in arguments))
        assert asked.value == before + 1, name


def test_where_nothing_is_known_the_step_is_that_of_the_vehicle_file(exported):
    """Sixty degrees of slip are far beyond any label: neither correction nor lag acts, whatever has arrived."""
    _, car, step = exported
    x, u = np.array([1.0, 2.0, 0.3, 10.0, 18.0, 0.2, 300.0, 0.05, -0.04]), np.array([50.0, 0.3])
    bare = SingleTrack(car.training_set.nominal_vehicle)
    ends = x[6:8] + STEP * u
    courses = (np.linspace(x[6 + c], ends[c], 9)[None] for c in (0, 1))
    expected = integrate_recorded(bare, x[None, :6], *courses, STEP / 8)[0]
    found = np.empty(9)
    car.call("step_rk4", x, u, STEP, 8, found)
    np.testing.assert_allclose(found[:6], expected, rtol=0.0, atol=1e-9)
    # The steering goes on to follow its command all the same: tau a' = delta - a, delta a ramp.
    tau = LAG.parameters["tau"]
    steady = x[7] - u[1] * tau
    angle = steady + u[1] * STEP + (x[8] - steady) * np.exp(-STEP / tau)
    assert found[8] == pytest.approx(angle, abs=1e-7)
    assert np.asarray(step(x, u, STEP)).ravel()[8] == pytest.approx(angle, abs=1e-9)
    with_lag = SingleTrack(car.training_set.vehicle)
    other = roll_rates(with_lag, x)
    assert np.abs(other - roll_rates(bare, x)).max() > 0.01


def roll_rates(model: SingleTrack, x: np.ndarray) -> np.ndarray:
    """Return v_x', v_y', r' with the angle that has arrived."""
    states = {"steer_lag.angle": x[8]} if model.terms else None
    return np.array(model.velocity_derivative(*x[3:8], states=states))
