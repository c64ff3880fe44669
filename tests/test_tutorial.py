"""docs/tutorial.md: its commands run as printed, in an empty folder, and do what the page says they do."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pandas
import pytest

from split_cli.export.compiler import STRICT_FLAGS, find_compiler
from split_cli.learning.training_set import read_set
from split_cli.logs.drive import read_drive
from split_cli.prediction import make_predictor
from split_cli.vehicle.integration import phi_matrix
from split_cli.vehicle.parameters import read_vehicle
from split_cli.vehicle.single_track import SingleTrack
from tests.pages import follow, page_text

PAGE = page_text("tutorial.md")


@pytest.fixture(scope="module")
def followed(sample_logs, tmp_path_factory) -> tuple[Path, dict[str, str]]:
    """The folder the page was followed in, and what each command printed."""
    folder = tmp_path_factory.mktemp("tutorial")
    return folder, dict(follow(PAGE, folder, sample_logs))


def test_the_drafted_map_makes_si_of_the_workshops_units(followed):
    folder, said = followed
    (listed,) = (output for line, output in said.items() if line.endswith("--list"))
    assert {"km/h", "deg", "g"} <= set(listed.split())
    drive = read_drive(folder / "small.parquet")
    log = pandas.read_csv(folder / "sample_logs" / "road_small_workshop.csv")
    assert len(drive) == len(log)
    # The log's clock is uniform and has the drive's rate: nothing is interpolated, and doubles are rounded only.
    for name, column, factor in (
        ("vx", "vx(km/h)", 1.0 / 3.6),
        ("r", "r(deg/s)", np.pi / 180.0),
        ("delta", "delta(deg)", np.pi / 180.0),
        ("ax", "ax(g)", 9.80665),
        ("T", "T(N m)", 1.0),
    ):
        np.testing.assert_allclose(drive[name], factor * log[column], rtol=1e-9, atol=1e-9)


def test_the_correction_beats_the_nominal_model_on_the_unseen_drive(followed):
    (said,) = (output for line, output in followed[1].items() if line.startswith("split evaluate"))
    rows: dict[str, list[np.ndarray]] = {}
    for line in said.partition("Labels inside intervals")[0].splitlines():
        for name in ("nominal", "velocity held", "last label held", "bcm", "noise floor"):
            if re.match(rf"{name} {{2}}", line):
                numbers = [float(x) for x in re.findall(r"\b\d+\.\d+\b", line)]
                rows.setdefault(name, []).append(np.array(numbers))
    # One step: weighed by noise, v_x, v_y and r.
    nominal, corrected, held = (rows[name][0][1:4] for name in ("nominal", "bcm", "velocity held"))
    # The unseen drive is a harder one: trust holds back what depends on how the car is driven, and corrections
    # end where the data end.
    assert np.all(corrected < nominal) and corrected[2] < 0.9 * nominal[2] and np.all(nominal < held)
    assert np.all(corrected > rows["noise floor"][0][1:4]) and "last label held" in rows
    # Rollouts over 0.5, 1 and 2 s.
    assert len(rows["bcm"]) == len(rows["nominal"]) == 4
    for before, after in zip(rows["nominal"][1:], rows["bcm"][1:], strict=True):
        assert np.all(after[-4:] < before[-4:])


def test_the_pages_c_compiles_and_answers_as_python_does(followed, tmp_path):
    compiler = find_compiler()
    if compiler is None:
        pytest.skip("there is no C compiler here")
    folder, _ = followed
    (snippet,) = re.findall(r"```c\n(.*?)```", PAGE, flags=re.S)
    include, body = snippet.split("\n", 1)
    x, h = np.array([1.0, 2.0, 0.3, 22.0, 0.1, 0.15, 400.0, 0.02]), 0.05
    names = ("X", "Y", "yaw", "vx", "vy", "r", "torque", "steer")
    given = "".join(f"double {name} = {float(value)!r}; " for name, value in zip(names, x, strict=True))
    told = "".join(
        f'for (int k = 0; k < {count}; ++k) {{ printf("%.17g ", {array}[k]); }}\n'
        for array, count in (("z", "CAR_FEATURES"), ("mean", 3), ("variance", 3), ("next", 8))
    )
    program = f"{include}\n#include <stdio.h>\nint main(void) {{\n{given}double u[2] = {{0.0, 0.0}};\n{body}{told}"
    (tmp_path / "controller.c").write_text(program + "return 0; }\n")
    exported = folder / "controller"
    sources = [tmp_path / "controller.c", exported / "car.c"]
    compiler.build(sources, tmp_path / "controller", [*STRICT_FLAGS, f"-I{exported}"])
    done = subprocess.run([str(tmp_path / "controller")], capture_output=True, text=True, check=True)
    z, mean, variance, after = np.split(np.array(done.stdout.split(), dtype=float), [3, 6, 9])
    model = SingleTrack(read_vehicle(folder / "car.yaml"))
    velocity, inputs = x[3:6], x[6:]
    vehicle, (vx, vy, r), (torque, steer) = model.vehicle, velocity, inputs
    front = steer - np.arctan((vy + vehicle.cg_to_front_axle * r) / vx)
    rear = -np.arctan((vy - vehicle.cg_to_rear_axle * r) / vx)
    np.testing.assert_allclose(z, [front, rear, torque / vehicle.max_torque], rtol=1e-12)
    told = make_predictor("projected", read_set(folder / "car.split")).predict(z[None])
    # The export's own bounds: 1e-12 of the signal's deviation and variance, both of the order of one tenth.
    np.testing.assert_allclose(mean, told.mean[0], atol=1e-12)
    np.testing.assert_allclose(variance, told.variance[0], atol=1e-12)
    # Inputs stand still: the linearised exact step is h Phi of nominal rate and correction together.
    phi = phi_matrix(model.velocity_jacobian(*velocity, *inputs)[None], h)[0]
    rate = model.velocity_derivative(*velocity, *inputs) + mean
    np.testing.assert_allclose(after[3:6], velocity + h * phi @ rate, rtol=1e-9)
