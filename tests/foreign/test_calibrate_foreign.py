"""Calibration on the recordings of others: what the project's vehicle files claim comes out again."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.calibrate import command as calibrate
from split_cli.cli.ingest import command as ingest
from split_cli.vehicle.parameters import read_vehicle

pytestmark = pytest.mark.foreign


def run(command, *arguments) -> str:
    done = CliRunner().invoke(command, [str(argument) for argument in arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def test_tum_tyres_come_out_of_their_training_blocks(tmp_path, datasets):
    drives = []
    for name in ("data_to_train_12", "data_to_run"):
        drives.append(tmp_path / f"{name}.parquet")
        log = datasets / "tum_sim" / f"{name}.csv"
        run(ingest, log, "--vehicle", "tum_sim", "--map", "tum_sim", "-o", drives[-1])
    output = tmp_path / "car.yaml"
    report = json.loads(
        run(
            calibrate,
            *drives,
            "--vehicle",
            "tum_sim",
            "--fit",
            "tires,rolling",
            "--offsets",
            "--training-blocks",
            "-o",
            output,
            "--json",
        )
    )
    ours, library = read_vehicle(output), read_vehicle("tum_sim")
    for axle in ("front_tire", "rear_tire"):
        assert library.origins[f"{axle}.B"] == "calibrated"
        # The library's D is assumed. The axles' forces come later than their slip angles, and no upper bound of D is
        # taken from such loops: D stays, and the slope is near that of the file.
        stiffness = [getattr(car, axle).cornering_stiffness for car in (ours, library)]
        np.testing.assert_allclose(*stiffness, rtol=0.25)
    for c in report["curves"]:
        assert c["peak"][0] <= c["tire"]["D"] and c["peak"][1] is None  # without an upper end
    assert all(c["held_out"]["calibrated"] < 0.5 * c["held_out"]["signal"] for c in report["curves"])


def test_genesis_leaves_its_slopes_open_and_its_published_stiffness_stands(tmp_path, datasets):
    drive, output = tmp_path / "genesis.parquet", tmp_path / "car.yaml"
    log = datasets / "genesis_slow" / "cpg_slow_lap.mat"
    run(
        ingest,
        log,
        "--vehicle",
        "genesis",
        "--map",
        "genesis_slow",
        "--derive",
        "torque-from-acceleration",
        "-o",
        drive,
    )
    report = json.loads(
        run(
            calibrate,
            drive,
            "--vehicle",
            "genesis",
            "--fit",
            "tires",
            "--offsets",
            "--training-blocks",
            "-o",
            output,
            "--json",
        )
    )
    assert any("tyres are kept on both axles" in remark for remark in report["remarks"])
    kept = read_vehicle(output)
    assert kept.digest() == read_vehicle("genesis").digest()
    # Published: 2 x 76,419 and 2 x 134,851 N/rad; the file's B, C, D hold them to their digits.
    np.testing.assert_allclose(kept.front_tire.cornering_stiffness, 2 * 76419, rtol=1e-3)
    np.testing.assert_allclose(kept.rear_tire.cornering_stiffness, 2 * 134851, rtol=1e-3)
