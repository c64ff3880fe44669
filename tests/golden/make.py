"""Write the golden files of this version's formats: `python -m tests.golden.make FOLDER`.

They are committed once a format version and never written again: every later version must read them. A new format
version adds files beside the old ones. ``set-1.split`` was written by the last version that knew no trust, the
parent of commit 865ddc5, from the points of ``set-2.split``. That one was written by version 0.1.0, which kept no sums
over labels, as was ``export-1``. ``set-3.split`` has them, and ``export-2`` predicts with them.
"""

import shutil
import sys
from dataclasses import replace
from pathlib import Path

from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.learning.features import parse_features
from split_cli.learning.label_file import write_labels
from split_cli.learning.labels import compute_labels
from split_cli.learning.region import Region
from split_cli.learning.training_set import read_set, write_set
from split_cli.logs.drive import DriveMetadata, NoiseEstimate, Source, read_drive, write_drive
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.export import export_set
from split_cli.workflows.ingesting.ingest_manifest import MANIFEST_NAME, IngestManifest
from tests.factories import kernel_to_yaml, make_drive, make_training_set, road_car

MAP = """name: golden
about: every key of a signal map
time: {source: time_ms, unit: ms}
frame: frd
world: ned
extras: [oil_temperature]
datum: [48.1, 11.6]
despike: false
channels:
  vx: {source: speed, unit: km/h, position: {x: -0.4, y: 0.1}}
  vy: {source: v_lat, unit: m/s, delay: 0.02, position: rear_axle}
  r: {source: yaw_rate, unit: deg/s, scale: -1.0}
  yaw: {source: [qx, qy, qz, qw], convert: yaw_from_quaternion}
  delta: {source: steer, curve: [[-1, -0.42], [0, 0], [1, 0.38]], unit: rad, kind: command}
  T: {kind: measured, sum: [{source: tl, unit: N m}, {source: tr, unit: N m}]}
derivations:
  torque_from_throttle_and_brake: {brake_full_scale: 2757900.0}
"""


def write(folder: Path) -> None:
    """Write one small file of every format."""
    car = road_car()
    write_vehicle(car, folder / "vehicle-1.yaml")
    (folder / "map-1.yaml").write_text(MAP)
    drive = make_drive(4, segments=2, seconds=2.0, vehicle=car, name="drive-1.parquet")
    metadata = DriveMetadata(
        sources=(Source("lap.csv", "0" * 64),),
        vehicle=car.name,
        kinds={"vx": "measured", "T": "derived: by hand", "delta": "command"},
        signal_map={"map": "golden"},
        conversions=("vx: km/h to m/s",),
        noise=(NoiseEstimate("vx", 0.02, 0.03, (1.0, 0.2)), NoiseEstimate("T", None, None, reason="derived")),
        quality={"assumed": ["yaw in rad"], "consistency": {"findings": []}},
        between={"delta": "held", "T": "continuous"},
    )
    write_drive(replace(drive, metadata=metadata), folder / "drive-1.parquet")
    stored = read_drive(folder / "drive-1.parquet")
    labels = compute_labels(stored, car, parse_features("z2"), Region.of(car), horizon=0.05)
    write_labels(labels, folder / "labels-1.parquet")
    trained = make_training_set(seed=4, points=80, vehicle=car)
    write_set(trained, folder / "set-2.split")
    write_of_all_labels(folder)
    (folder / "hyperparameters-1.yaml").write_text(kernel_to_yaml(trained.kernel, trained.features))
    export_set(folder / "set-2.split", folder / "export-1", ["npz", "json"], queries=100, insist=True)
    assert read_set(folder / "set-2.split").size == trained.size
    (folder / "evaluation-1.json").write_text(evaluated(folder))
    compared(folder, folder / "comparison-1")
    (folder / "drives-1").mkdir()
    manifest = IngestManifest(folder / "drives-1" / MANIFEST_NAME)
    copy = shutil.copy(folder / "drive-1.parquet", manifest.path.parent)
    manifest.add("lap.csv", "0" * 64, "0" * 64, "drive-1.parquet", Path(copy))
    manifest.write()


def write_of_all_labels(folder: Path) -> None:
    """Write a set that keeps what all labels tell, and an export of the predictor that uses it."""
    trained = make_training_set(seed=5, points=80, vehicle=road_car(), capacity=3)
    write_set(trained, folder / "set-3.split")
    export_set(folder / "set-3.split", folder / "export-2", ["json"], queries=100, insist=True, predictor="projected")


def evaluated(folder: Path) -> str:
    """Return what `split evaluate --json` prints of the drive and the set in a folder of golden files."""
    what = ("--vehicle", folder / "vehicle-1.yaml", "--set", folder / "set-2.split", "--predictor", "bcm")
    return _printed("evaluate", folder / "drive-1.parquet", *what, "--rollout", "0.2", "--blocks", 2, "--json")


def compared(folder: Path, output: Path) -> None:
    """Write what `split compare` writes of them."""
    models = (f"car={folder / 'vehicle-1.yaml'}", f"set={folder / 'set-2.split'}")
    _printed("compare", *models, "--on", folder / "drive-1.parquet", "--horizon", "0.04", "-o", output)


def _printed(*arguments: object) -> str:
    done = CliRunner().invoke(group, [str(one) for one in arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


if __name__ == "__main__":
    write(Path(sys.argv[1]))
