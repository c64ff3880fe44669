"""Natural experiments: real recordings in which nature hid an effect, prepared and diagnosed by one command.

`python -m tests.foreign.natural DATASETS OUT` diagnoses all of them, one after another, and prints what was said;
`--only` takes some. `docs/natural.md` tells what an engineer knows of each, and what came out.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.ndimage import uniform_filter1d

from split_cli.diagnosis.statement.result import Diagnosis
from split_cli.logs.assembling.assemble import IngestSettings
from split_cli.logs.drive import Drive, read_drive, write_drive
from split_cli.proof.injection import split_in_blocks
from split_cli.vehicle.parameters import Vehicle, read_vehicle
from split_cli.workflows.diagnose import diagnose_files
from split_cli.workflows.ingesting.ingest import ingest_logs

MAPS = Path(__file__).parent / "maps"
DART_CAR = MAPS / "dart_car.yaml"
KTH_CAR = MAPS / "kth_car.yaml"
_NO_THRUST_SPEED = 8.7  # [m/s] at which the motor would give no torque: least squares on the ramp on rubber
AUTORALLY_CAR = MAPS / "autorally_car.yaml"
_UNSOUND_YAW = 100.0  # [rad] no car on this track has turned so far
_BEFORE_UNSOUND = 1500  # samples before that are left out
_CREEP = 0.3  # [m/s] below which the DART car stands or starts


def dart_drive(datasets: Path, name: str, folder: Path, *, start: float = 0.0, end: float = np.inf) -> Drive:
    """Return a DART recording as a drive: velocities from the pose, torque from throttle and the motor's curve."""
    path = folder / f"{name}.parquet"
    if not path.exists():
        settings = IngestSettings(derive=("velocity-from-pose",))
        ingest_logs(
            [datasets / "dart" / f"{name}.csv"],
            path,
            maps=[MAPS / "dart.yaml"],
            vehicle_path=DART_CAR,
            settings=settings,
        )
    drive = read_drive(path)
    falling = np.clip(1.0 - drive["vx"] / _NO_THRUST_SPEED, 0.0, 1.0)
    columns = {**drive.columns, "T": drive["T"] * falling}
    kinds = {**drive.metadata.kinds, "T": "derived: throttle and the motor's curve"}
    drive = replace(drive, columns=columns, metadata=replace(drive.metadata, kinds=kinds))
    t = drive["t"] - drive["t"][0]
    return drive.select(np.flatnonzero((t >= start) & (t < end))) if np.isfinite(end) or start else drive


def saturated_acceleration(drive: Drive, share: float = 0.1) -> float:
    """Return what lateral acceleration v_x r [m/s^2] only a share of the moving time exceeds: the limit."""
    moving = drive["vx"] > _CREEP
    return float(np.quantile(np.abs(drive["vx"] * drive["r"])[moving], 1.0 - share))


def at_equal_slips(real: Drive, simulated: Drive, vehicle: Vehicle) -> tuple[float, float]:
    """Return the lateral acceleration v_x r of one drive over another's at equal slip, by front and by rear axle.

    Notes
    -----
    In steady circles an axle's force goes with v_x r. Ratios of medians over bins of 0.01 rad, weighted by the
    real samples; slips below 0.02 rad are left out, where an offset of the steering is all there is.
    """
    found = []
    for axle in ("front", "rear"):
        bins, pushed = zip(*(_pushed_at_slips(one, vehicle, axle) for one in (real, simulated)), strict=True)
        both = [k for k in np.unique(bins[0]) if k >= 2 and min(np.sum(one == k) for one in bins) >= 25]
        medians = np.array([[np.median(a[b == k]) for b, a in zip(bins, pushed, strict=True)] for k in both])
        found.append(float(np.average(medians[:, 0] / medians[:, 1], weights=[np.sum(bins[0] == k) for k in both])))
    return found[0], found[1]


def _pushed_at_slips(drive: Drive, vehicle: Vehicle, axle: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the slip of an axle in steps of 0.01 rad and |v_x r| [m/s^2], means over 0.1 s of moving samples."""
    width = max(1, round(0.1 / drive.period))
    vx, vy, r, delta = (uniform_filter1d(drive[name], width) for name in ("vx", "vy", "r", "delta"))
    moving = vx > _CREEP
    arm, angle = (vehicle.cg_to_front_axle, delta) if axle == "front" else (-vehicle.cg_to_rear_axle, 0.0 * delta)
    slip = angle - np.arctan2(vy + arm * r, np.maximum(vx, _CREEP))
    return (np.abs(slip[moving]) / 0.01).astype(int), np.abs(vx * r)[moving]


def slips_at_a_crawl(drive: Drive, vehicle: Vehicle, slowest: float = 0.3, fastest: float = 0.45) -> np.ndarray:
    """Return mean front and rear slip [rad] between two speeds [m/s] that need hardly any force, shape (2,)."""
    width = max(1, round(0.3 / drive.period))
    vx, vy, r, delta = (uniform_filter1d(drive[name], width) for name in ("vx", "vy", "r", "delta"))
    slow = (vx >= slowest) & (vx < fastest)
    front = delta - np.arctan2(vy + vehicle.cg_to_front_axle * r, vx)
    rear = -np.arctan2(vy - vehicle.cg_to_rear_axle * r, vx)
    return np.array([front[slow].mean(), rear[slow].mean()])


def tape_with_angles_of_rubber(datasets: Path, folder: Path) -> Drive:
    """Return the drive on tape with the tracked axis and the steer angle by which it creeps as on rubber."""
    tape, rubber = (dart_drive(datasets, name, folder) for name in (TAPE, RUBBER))
    car = read_vehicle(DART_CAR)
    front, rear = slips_at_a_crawl(rubber, car) - slips_at_a_crawl(tape, car)
    sine, cosine = np.sin(rear), np.cos(rear)
    columns = {
        **tape.columns,
        "vx": cosine * tape["vx"] + sine * tape["vy"],
        "vy": cosine * tape["vy"] - sine * tape["vx"],
        "yaw": tape["yaw"] + rear,
        "delta": tape["delta"] + front - rear,
    }
    return replace(tape, columns=columns)


def kth_drive(datasets: Path, run: str, folder: Path, *layers: str) -> Drive:
    """Return a run of the Volvo S90 as a drive, with the yaw rate of the CAN bus.

    Other layers of the map have the yaw rate of the IMU (``imu``), or position and heading (``antennas``).
    """
    path = folder / f"{'_'.join(['kth', run, *layers])}.parquet"
    if not path.exists():
        maps = [MAPS / "kth_s90.yaml", *(MAPS / f"kth_{layer}.yaml" for layer in layers)]
        ingest_logs([datasets / "kth_s90" / f"S90__{run}.VBO"], path, maps=maps, vehicle_path=KTH_CAR)
    return read_drive(path)


def autorally_drive(datasets: Path, number: int, folder: Path) -> Drive:
    """Return a run of the 1:5 car on dirt as a drive, its 1 kHz matrices thinned to 100 Hz."""
    path = folder / f"autorally_{number}.parquet"
    if not path.exists():
        matrices = loadmat(datasets / "autorally" / f"mppi_states_controls{number}.mat")
        states, inputs = matrices["states"], matrices["inputs"]
        # One tail explodes: position leaves the track by more than the car can go.
        sound = np.abs(states[5]) < _UNSOUND_YAW
        end = len(sound) if sound.all() else int(np.argmin(sound)) - _BEFORE_UNSOUND
        rows = np.column_stack([1e-3 * np.arange(states.shape[1]), states[[0, 1, 2, 5, 6, 7]].T, inputs.T])
        table = folder / f"autorally_{number}.csv"
        names = "t,v_x,v_y,r,yaw,X,Y,steering,throttle"
        np.savetxt(table, rows[:end:10], delimiter=",", header=names, comments="", fmt="%.7g")
        ingest_logs([table], path, maps=[MAPS / "autorally.yaml"], vehicle_path=AUTORALLY_CAR)
    return read_drive(path)


@dataclass(frozen=True)
class NaturalExperiment:
    """One pair, or one recording against the nominal model.

    Attributes
    ----------
    known : str
        What an engineer knows of it.
    pair : callable
        Folder of datasets and folder to work in to the real drive and the simulated one or None.
    vehicle : path or str
    """

    known: str
    pair: Callable[[Path, Path], tuple[Drive, Drive | None]]
    vehicle: Path | str


def _halves(name: str) -> Callable[[Path, Path], tuple[Drive, Drive]]:
    def pair(datasets: Path, folder: Path) -> tuple[Drive, Drive]:
        reference, other = split_in_blocks(dart_drive(datasets, name, folder), 10.0)
        return other, reference

    return pair


RUBBER, TAPE, SLIPPERY = "rubber_steer03_ramp", "tape_tiles_steer03_ramp", "slippery_2025-04-16-17-36-01"
EXPERIMENTS = {
    "tape-nominal": NaturalExperiment(
        "grip of tape over that of rubber, to which the nominal model is fitted: 0.43",
        lambda datasets, folder: (dart_drive(datasets, TAPE, folder), None),
        DART_CAR,
    ),
    "tape-angles": NaturalExperiment(
        "the same with the tracked axis and the steer angle corrected by what rubber and tape have at a crawl",
        lambda datasets, folder: (tape_with_angles_of_rubber(datasets, folder), None),
        DART_CAR,
    ),
    "tape-rubber": NaturalExperiment(
        "the same with the drive on rubber as simulation: 0.43 of the peak, 0.5 to 0.6 at equal slips",
        lambda datasets, folder: (dart_drive(datasets, TAPE, folder), dart_drive(datasets, RUBBER, folder)),
        DART_CAR,
    ),
    "rubber-tape": NaturalExperiment(
        "the same the other way: tape is the simulation, grip of rubber over that of tape is 2.3",
        lambda datasets, folder: (dart_drive(datasets, RUBBER, folder), dart_drive(datasets, TAPE, folder)),
        DART_CAR,
    ),
    "slippery-nominal": NaturalExperiment(
        "a third floor, pose at 20 Hz; lateral acceleration ends at 4.0 m/s^2, on rubber at 7.7: grip about 0.5",
        lambda datasets, folder: (dart_drive(datasets, SLIPPERY, folder), None),
        DART_CAR,
    ),
    "autorally-nominal": NaturalExperiment(
        "drift on dirt: sideslip to 50 degrees, steering 0.2 s late, yaw rate 4 % below the turn of yaw",
        lambda datasets, folder: (autorally_drive(datasets, 6, folder), None),
        AUTORALLY_CAR,
    ),
    "autorally-runs": NaturalExperiment(
        "nothing: two runs of one car on one track",
        lambda datasets, folder: (autorally_drive(datasets, 5, folder), autorally_drive(datasets, 6, folder)),
        AUTORALLY_CAR,
    ),
    "rubber-halves": NaturalExperiment("nothing: one floor, one car", _halves(RUBBER), DART_CAR),
    "tape-halves": NaturalExperiment("nothing: one floor, one car", _halves(TAPE), DART_CAR),
    "free-nominal": NaturalExperiment(
        "steering 40 to 100 ms late (commands of 10 Hz, servo); to the right a third more angle than the map says",
        lambda datasets, folder: (dart_drive(datasets, "free_driving", folder), None),
        DART_CAR,
    ),
    "kth-yaw-rate": NaturalExperiment(
        "the same slalom twice: the yaw rate of the CAN bus is some 40 ms later than the IMU's",
        lambda datasets, folder: (kth_drive(datasets, "038", folder), kth_drive(datasets, "038", folder, "imu")),
        KTH_CAR,
    ),
    "kth-nominal": NaturalExperiment(
        "a brochure's car: steering ratio within some 10 %, yaw rate of the CAN bus 40 ms late",
        lambda datasets, folder: (kth_drive(datasets, "038", folder), None),
        KTH_CAR,
    ),
    "kth-antennas": NaturalExperiment(
        "the same with position and heading of two antennas, after which the yaw rate comes 50 ms late",
        lambda datasets, folder: (kth_drive(datasets, "038", folder, "antennas"), None),
        KTH_CAR,
    ),
    "free-halves": NaturalExperiment("nothing: one floor, one car", _halves("free_driving"), DART_CAR),
}


def run(name: str, datasets: Path, folder: Path) -> Diagnosis:
    """Prepare and diagnose one experiment; its files stay in a folder of its name."""
    one = EXPERIMENTS[name]
    work = folder / name
    work.mkdir(parents=True, exist_ok=True)
    real, simulated = one.pair(datasets, folder)
    write_drive(replace(real, name="real.parquet"), work / "real.parquet")
    paths = []
    if simulated is not None:
        write_drive(replace(simulated, name="sim.parquet"), work / "sim.parquet")
        paths = [work / "sim.parquet"]
    return diagnose_files([work / "real.parquet"], one.vehicle, work / "diagnosis", simulated=paths)


def main() -> None:
    """Diagnose the experiments and print what was said beside what is known."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("datasets", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="*", choices=sorted(EXPERIMENTS), default=sorted(EXPERIMENTS))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.only:
        start = time.perf_counter()
        told = run(name, arguments.datasets, arguments.out)
        print(f"{name} ({time.perf_counter() - start:.0f} s)\n  known: {EXPERIMENTS[name].known}")
        print(f"  said: {told.verdict}, p = {told.p_value}, unexplained {told.unexplained}. {told.summary}", flush=True)


if __name__ == "__main__":
    main()
