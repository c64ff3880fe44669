"""Driving with an export's CasADi function alone: it says what its set says, and a car is driven by it."""

import json
import runpy
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from split_cli.control.exported import ExportedResidual
from split_cli.control.residual import PredictorResidual
from split_cli.errors import ExportError, SetError, SplitError
from split_cli.learning.training_set import read_set, write_set
from split_cli.vehicle.parameters import EffectSpec, read_vehicle
from split_cli.workflows.export import export_set
from split_cli.workflows.racing.maneuver import ManeuverSettings, run_maneuvers
from split_cli.workflows.racing.race import run_race
from split_cli.workflows.racing.settings import RaceSettings
from tests.control.courses import CAR, ROOT, invoke, ring

WET = ManeuverSettings(grip=0.5, seed=3)


@pytest.fixture(scope="module")
def learned(tmp_path_factory) -> tuple[Path, Path]:
    """A set of one lane change on a wet road, and the folder of its export."""
    folder = tmp_path_factory.mktemp("exported")
    run_maneuvers(replace(WET, speeds=(12.0,)), CAR, set_output=folder / "wet.split")
    export_set(folder / "wet.split", folder / "controller", ["casadi"], predictor="projected", queries=200, insist=True)
    return folder / "wet.split", folder / "controller"


def test_the_exported_function_says_what_the_set_says(learned):
    """CasADi's derivative of the file stands against the predictor's own."""
    trained, folder = learned
    training_set = read_set(trained)
    z = training_set.z[::7] + 0.01
    expected = PredictorResidual(training_set, "projected").of_data(z)
    found = ExportedResidual(folder, read_vehicle(CAR)).of_data(z)
    for name in ("mean", "slope", "variance", "knowledge"):
        value = getattr(expected, name)
        scale = float(np.abs(value).max())
        np.testing.assert_allclose(getattr(found, name), value, rtol=1e-7, atol=1e-8 * scale, err_msg=name)
    assert found.knowledge.max() > 0.5


def test_an_export_passes_where_the_file_of_a_dry_road_does_not(learned):
    _, folder = learned
    fast = replace(WET, speeds=(15.0,))
    (nominal,) = run_maneuvers(fast, CAR).runs
    (exported,) = run_maneuvers(replace(fast, start_set=folder), CAR).runs
    assert nominal.hit > 2 and exported.hit < nominal.hit and exported.deviation < 0.5 * nominal.deviation


def test_a_lap_is_driven_with_an_export(learned, tmp_path):
    done = invoke(
        f"race --vehicle {CAR} --track {ring(tmp_path)} --laps 1 --max-speed 10 --learner none "
        f"--start-set {learned[1]} --json"
    )
    assert done.exit_code == 0, done.output
    driven = json.loads(done.stdout)
    (lap,) = driven["laps"]
    assert not lap["ended"] and lap["outside"] == 0.0 and lap["failures"] == 0
    # A table of `learner none` without points did not say that an export had driven.
    assert driven["start"] == "export wet (projected)"
    done = invoke(
        f"race --vehicle {CAR} --track {ring(tmp_path)} --laps 1 --max-speed 10 --learner none --start-set {learned[0]}"
    )
    assert done.exit_code == 0, done.output
    assert "learner none, begins with set wet.split (bcm)\n" in done.stdout


def test_an_export_brings_the_lags_that_training_found(learned, tmp_path):
    """With the default `--lag` most exports were refused as those of another vehicle: the set's has a lag more."""
    trained = read_set(learned[0])
    lag = EffectSpec("drive_lag", {"tau": 0.05}, "along")
    lagging = replace(trained, vehicle=replace(trained.vehicle, effects=(lag,)), found_effects=1)
    write_set(lagging, tmp_path / "lag.split")
    folder = tmp_path / "controller"
    export_set(tmp_path / "lag.split", folder, ["casadi"], predictor="projected", queries=200, insist=True)
    car = read_vehicle(CAR)
    assert ExportedResidual(folder, car).vehicle.digest() == lagging.vehicle.digest() != car.digest()
    for other in (replace(car, mass=1000.0), replace(car, effects=(lag,))):
        with pytest.raises(SetError, match="another vehicle"):
            ExportedResidual(folder, other)
    (run,) = run_maneuvers(replace(WET, speeds=(10.0,), start_set=folder), CAR).runs
    assert run.hit == 0 and not run.ended


def test_what_is_no_export_of_this_car_is_refused(learned, tmp_path):
    folder = learned[1]
    other = replace(read_vehicle(CAR), mass=1000.0)
    with pytest.raises(SetError, match="another vehicle"):
        ExportedResidual(folder, other)
    with pytest.raises(SplitError, match="learner split cannot go on"):
        run_race(RaceSettings(learner="split", start_set=folder), CAR)
    damaged = shutil.copytree(folder, tmp_path / "damaged")
    manifest = damaged / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"torque_ratio"', '"feature_lag.torque"'))
    with pytest.raises(SetError, match=r"has states of feature_lag as features.*the set brings the term"):
        ExportedResidual(damaged, read_vehicle(CAR))
    shutil.copy(folder / "manifest.json", manifest)
    (damaged / "wet.casadi").write_bytes(b"not a function")
    with pytest.raises(ExportError, match="CasADi cannot read it"):
        ExportedResidual(damaged, read_vehicle(CAR))
    (damaged / "wet.casadi").unlink()
    with pytest.raises(ExportError, match=r"wet\.casadi is missing"):
        ExportedResidual(damaged, read_vehicle(CAR))


def test_the_documented_controller_steers_by_the_exported_step_alone(learned):
    """At a speed where tyres are nearly linear it holds the line through the cones."""
    recipe = runpy.run_path(str(ROOT / "docs" / "recipes" / "lane_change_mpc.py"))
    done = recipe["simulated_car"](learned[1], "wet", 12.0, seed=1, grip=0.5)
    assert done.hit == 0 and done.deviation < 0.4
