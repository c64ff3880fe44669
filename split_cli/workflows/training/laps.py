"""What each lap of a drive added to a set: the paper's table."""

from dataclasses import dataclass

import numpy as np

from split_cli.learning.cells import extend
from split_cli.learning.labels import Labels
from split_cli.learning.training_set import TrainingSet
from split_cli.logs.drive import Drive
from split_cli.logs.laps import lap_numbers
from split_cli.vehicle.parameters import Vehicle
from split_cli.workflows.training.labelled_drives import LabelledDrives


@dataclass(frozen=True)
class LapRow:
    """One lap of the table (SPLIT paper, table of the racing experiments)."""

    drive: str
    lap: int  # from 1
    time: float  # [s]; of the last lap only when it was finished
    finished: bool  # whether another lap began after it
    mean_speed: float  # [m/s]
    largest_lateral_acceleration: float  # of v_x r, 99.9 % quantile [m/s^2]
    updates: int  # insertions and replacements
    # points, cells: size of the set and non-empty cells after the lap.
    points: int
    cells: int
    valid_share: float | None  # of the valid region's cells, how many are not empty [1]


def check_laps(drives: LabelledDrives, vehicle: Vehicle) -> None:
    """Stop before anything is learned if a drive has no laps: hyperparameters take minutes.

    Raises
    ------
    DriveError
        If a drive has no laps.
    """
    for number in range(len(drives)):
        drive = drives.drive(number)
        if drive is not None:
            lap_numbers(drive, vehicle.wheelbase)


def lap_rows(drive: Drive, labels: Labels, begin: TrainingSet) -> tuple[LapRow, ...]:
    """Return a row a lap, learning the drive's labels lap by lap from `begin`.

    Learning is in order, so that after its last lap the set holds what one run over the drive gives.

    Raises
    ------
    DriveError
        If the drive has no laps.
    """
    numbers = lap_numbers(drive, begin.vehicle.wheelbase)
    rows, trained = [], begin
    lap_of_label = numbers[labels.row]
    for lap in range(1, int(numbers.max()) + 1):
        here = numbers == lap
        trained = extend(trained, [labels.take(lap_of_label == lap)])
        learned = trained.sources[-1]
        speed = np.hypot(drive["vx"], drive["vy"])[here]
        rows.append(
            LapRow(
                drive=drive.name,
                lap=lap,
                time=float(here.sum() * drive.period),
                finished=lap < numbers.max(),
                mean_speed=float(speed.mean()),
                largest_lateral_acceleration=float(np.quantile(np.abs(drive["vx"] * drive["r"])[here], 0.999)),
                updates=learned.insertions + learned.replacements,
                points=trained.size,
                cells=trained.cell_count,
                valid_share=trained.valid_share(),
            )
        )
    return tuple(rows)
