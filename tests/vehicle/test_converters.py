"""Other projects' parameter files: their forces come out again, and what they lack is told.

The numbers are made up; the keys are those of CommonRoad's vehicle models, the F1TENTH gym and simulator, and
ForzaETH's race stack.
"""

import numpy as np
import pytest
import yaml
from scipy.optimize import least_squares

from split_cli.errors import VehicleError
from split_cli.vehicle.converters import convert_parameters, fit_magic_formula, full_magic_formula
from split_cli.vehicle.parameters import read_vehicle, write_vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.tire import MagicFormula, lateral_force

COMMONROAD = {
    "m": 1100.0,
    "I_z": 1800.0,
    "a": 1.15,
    "b": 1.45,
    "h_cg": 0.57,
    "R_w": 0.34,
    "T_sb": 0.66,
    "T_se": 0,
    "longitudinal": {"a_max": 11.5, "v_max": 50.0},
    "steering": {"max": 1.0, "min": -1.0},
}
COMMONROAD_TIRE = {"tire": {"p_cy1": 1.35, "p_dy1": 1.05, "p_ey1": -0.007, "p_ky1": -22.0, "p_hy1": 0.0027}}
F1TENTH = {
    "mu": 1.05,
    "C_Sf": 4.7,
    "C_Sr": 5.5,
    "lf": 0.16,
    "lr": 0.17,
    "h": 0.07,
    "m": 3.7,
    "I": 0.047,
    "a_max": 9.5,
    "s_min": -0.4,
    "s_max": 0.4,
    "v_max": 20.0,
}
FORZAETH = {
    "C_Pf": [4.8, 2.16, 0.65, 0.37],
    "C_Pr": [7.8, 2.9, 0.54, 0.66],
    "I_z": 0.058,
    "h_cg": 0.014,
    "l_f": 0.162,
    "l_r": 0.145,
    "l_wb": 0.307,
    "m": 3.54,
    "mu": 1,
    "a_max": 3,
    "model_name": "NUC2",
    "tire_model": "pacejka",
}


def written(folder, **files):
    paths = []
    for name, content in files.items():
        path = folder / f"{name}.yaml"
        path.write_text(yaml.safe_dump(content))
        paths.append(path)
    return paths


def test_commonroad_forces_come_out_again(tmp_path):
    found = convert_parameters(written(tmp_path, parameters_vehicle9=COMMONROAD, parameters_tire=COMMONROAD_TIRE))
    assert found.kind == "CommonRoad"
    car = found.vehicle
    load = 1100.0 * 9.81 * 1.45 / 2.60
    # Its lateral law: D = p_dy1 F_z, B C D = |p_ky1| F_z, with a curvature E next to nothing.
    alpha = np.linspace(-0.18, 0.18, 37)
    source = full_magic_formula(22.0 / (1.35 * 1.05), 1.35, 1.05 * load, -0.007, alpha)
    tire = car.front_tire
    error = np.abs(lateral_force(tire.B, tire.C, tire.D, alpha) - source).max()
    assert error < 0.002 * tire.D
    assert error <= found.tires[0].largest_deviation * (1 + 1e-9)
    assert tire.cornering_stiffness == pytest.approx(22.0 * load, rel=0.01)
    assert (car.drive_split_front, car.brake_split_front) == (0.0, 0.66)
    assert car.origins["mass"] == "published"
    assert car.origins["max_torque"] == "assumed"


def test_commonroad_tyre_file_is_found_beside_and_missed_in_words(tmp_path):
    alone = written(tmp_path, parameters_vehicle9=COMMONROAD)
    with pytest.raises(VehicleError, match="holds no tyre.*parameters_tire.yaml"):
        convert_parameters(alone)
    written(tmp_path, parameters_tire=COMMONROAD_TIRE)
    assert convert_parameters(alone).kind == "CommonRoad"


def test_f1tenth_slope_is_its_own_at_small_slip(tmp_path):
    # The gym's single track linearises to F = mu C_S F_z alpha; compared here in its own closed form of v_y'.
    found = convert_parameters(written(tmp_path, params=F1TENTH))
    assert found.kind == "F1TENTH"
    car = found.vehicle
    v, beta, r, delta = 3.0, 1e-4, 2e-3, 3e-4
    g, mu, L = 9.81, 1.05, 0.33
    front, rear = 4.7 * g * 0.17, 5.5 * g * 0.16
    beta_rate = (
        (mu / (v**2 * L) * (rear * 0.17 - front * 0.16) - 1) * r
        - mu / (v * L) * (rear + front) * beta
        + mu / (v * L) * front * delta
    )
    coasting = SingleTrack(car).velocity_derivative(v, v * beta, r, 0.0, delta)
    # v_y' = v beta'; the linear law leaves terms of third order in the angles.
    assert coasting[1] == pytest.approx(v * beta_rate, rel=1e-5)
    assert car.origins["front_tire.C"] == "assumed"
    assert any("linear" in text for text in found.assumed)


@pytest.mark.parametrize("wrapper", ["params", "vehicle_params"])
def test_f1tenth_inside_a_wrapper_and_by_the_simulators_names(tmp_path, wrapper):
    wrapped = convert_parameters(written(tmp_path, a={wrapper: F1TENTH})).vehicle
    long_names = {
        "friction_coeff": 1.05,
        "C_S_front": 4.7,
        "C_S_rear": 5.5,
        "l_cg2front": 0.16,
        "l_cg2rear": 0.17,
        "height_cg": 0.07,
        "mass": 3.7,
        "moment_inertia": 0.047,
        "max_accel": 9.5,
        "wheelbase": 0.33,
    }
    simulator = convert_parameters(written(tmp_path, b=long_names)).vehicle
    assert wrapped.digest() == simulator.digest()


def test_forzaeth_tyres_with_curvature_and_large_shape_factors(tmp_path):
    found = convert_parameters(written(tmp_path, NUC2_pacejka=FORZAETH))
    assert (found.kind, found.vehicle.name) == ("ForzaETH", "NUC2")
    alpha = np.linspace(-0.18, 0.18, 361)
    loads = 3.54 * 9.81 * np.array([0.145, 0.162]) / 0.307
    for report, tire, four, load in zip(
        found.tires,
        (found.vehicle.front_tire, found.vehicle.rear_tire),
        (FORZAETH["C_Pf"], FORZAETH["C_Pr"]),
        loads,
        strict=True,
    ):
        B, C, D, E = four
        source = full_magic_formula(B, C, D * load, E, alpha)
        error = np.abs(lateral_force(tire.B, tire.C, tire.D, alpha) - source)
        assert tire.C < 2.0
        # No optimiser of another make, from a grid of starts, comes closer in the mean.
        rival = min(
            least_squares(
                lambda p, source=source: lateral_force(*p, alpha) - source,
                (b, c, D * load),
                bounds=([0.1, 0.05, 0.1 * D * load], [60.0, 1.99, 9.0 * D * load]),
            ).cost
            for b in (3.0, 10.0)
            for c in (1.2, 1.9)
        )
        assert 0.5 * np.sum(error**2) < 1.001 * rival + 1e-9
        assert report.largest_deviation == pytest.approx(error.max(), rel=1e-6)
        assert report.at == pytest.approx(abs(alpha[error.argmax()]), abs=1e-9)


def test_forzaeth_linear_tyres(tmp_path):
    content = {key: value for key, value in FORZAETH.items() if not key.startswith("C_P")}
    found = convert_parameters(written(tmp_path, NUC6_linear=content | {"C_Sf": 3.3, "C_Sr": 8.0}))
    load = 3.54 * 9.81 * 0.145 / 0.307
    assert found.vehicle.front_tire.cornering_stiffness == pytest.approx(3.3 * load, rel=1e-12)


def test_a_formula_without_curvature_is_fitted_to_itself():
    planted = MagicFormula(9.0, 1.6, 5000.0)
    tire, deviation, _ = fit_magic_formula(
        lambda alpha: lateral_force(9.0, 1.6, 5000.0, alpha), MagicFormula(15.0, 1.2, 3000.0), 0.3
    )
    assert deviation < 1e-3
    np.testing.assert_allclose([tire.B, tire.C, tire.D], [planted.B, planted.C, planted.D], rtol=1e-4)


def test_a_converted_file_is_a_vehicle_file(tmp_path):
    vehicle = convert_parameters(written(tmp_path, params=F1TENTH)).vehicle
    write_vehicle(vehicle, tmp_path / "car.yaml")
    assert read_vehicle(tmp_path / "car.yaml") == vehicle


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"wheels": 4}, "is of no known kind; its keys begin with wheels"),
        ([1, 2], "holds no keys"),
        ({**F1TENTH, "mu": "slippery"}, "mu is 'slippery'"),
        ({key: value for key, value in F1TENTH.items() if key != "I"}, "lacks I"),
        ({**FORZAETH, "C_Pf": [1.0, 2.0]}, r"C_Pf is \[1.0, 2.0\]"),
        ({**F1TENTH, "m": -1.0}, "must be positive"),
    ],
)
def test_files_that_cannot_be_converted(tmp_path, content, message):
    with pytest.raises(VehicleError, match=message):
        convert_parameters(written(tmp_path, bad=content))


def test_missing_file_is_told(tmp_path):
    with pytest.raises(VehicleError, match="no such file"):
        convert_parameters([tmp_path / "none.yaml"])
