"""Laps of a track in closed loop: a contouring controller that learns while it drives the plant."""

from collections.abc import Callable, Sequence
from pathlib import Path as FilePath

from split_cli.errors import SplitError
from split_cli.files import refuse_overwriting_inputs, refuse_what_cannot_be_written
from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.racing.driving import Race
from split_cli.workflows.racing.result import RaceResult
from split_cli.workflows.racing.settings import RaceSettings


def run_race(
    settings: RaceSettings,
    vehicle_path: str | FilePath,
    *,
    output: str | FilePath | None = None,
    set_output: str | FilePath | None = None,
    progress: Callable[[str], None] | None = None,
    others: Sequence[RaceResult] = (),
) -> RaceResult:
    """Drive the laps; write the drive, and the set after each lap.

    Parameters
    ----------
    others : sequence of RaceResult
        Driven before with the same settings but the learner. The verdict compares with the one of no learner.

    Raises
    ------
    SplitError
        If an input is at fault or the start is infeasible; nothing is driven then.
    """
    for path in (output, set_output):
        if path is not None:
            refuse_overwriting_inputs((vehicle_path, settings.start_set or vehicle_path), path)
            refuse_what_cannot_be_written(path)
    if set_output is not None and settings.learner == "none":
        raise SplitError(
            "the learner none learns nothing, so no set would be written",
            where="--set",
            advice="Use --learner split, or train on the drive that -o writes.",
        )
    race = Race(settings, read_vehicle(vehicle_path), set_output, progress or (lambda text: None))
    race.begin()
    race.run()
    if output is not None:
        race.write(FilePath(output))
    return race.result(output, others)
