"""Recordings prepared for a vehicle file with effects: sensor faults corrected, track position added."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from split_cli.errors import DriveError, SplitError
from split_cli.learning.features import recording_of
from split_cli.logs.drive import Drive, open_drive
from split_cli.logs.track_position import TrackReference, build_reference, track_position
from split_cli.scoring.vehicle_match import Belonging, belonging
from split_cli.vehicle.effects import build_terms
from split_cli.vehicle.parameters import Vehicle


class RecordingCorrection:
    """What a vehicle's effects mean for recordings of it.

    Terms of the sensors correct the recorded channels; `sensor_delay` alone does not, since the model takes the
    commands of before instead. Terms of place need the column ``s``: arc length along the first drive given, as
    in the diagnosis, unless a drive brings its own.

    Attributes
    ----------
    counts_places : bool
        Whether the vehicle has effects of place, so that the first drive decides where s begins.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        terms = build_terms(vehicle)
        self._sensors = [term for term in terms if term.corrects]
        self.counts_places = any({"s_start", "wavelength"} & set(term.parameters) for term in terms)
        self._wheelbase = vehicle.wheelbase
        self._first: tuple[str, str] | None = None
        self._reference: TrackReference | None = None
        self._notes: dict[str, None] = {}

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader of results should know of it."""
        return tuple(self._notes)

    def __call__(self, drive: Drive) -> Drive:
        """Return a drive corrected; the first one given is that which s counts along."""
        if self.counts_places and "s" not in drive:
            columns = dict(drive.columns)
            # A drive may be read several times: the first is known by what it is, not by when it comes.
            key = drive.name, drive.sha256
            if self._first is None:
                self._first, self._reference = key, build_reference(drive, self._wheelbase)
                self._notes[f"s, which effects of place act on, counts along {drive.name}"] = None
            columns["s"], kind = track_position(drive, self._reference, first=key == self._first)
            if kind != "position":
                self._notes[f"{drive.name} has no position: its s is the distance driven"] = None
            drive = replace(drive, columns=columns)
        return self.sensors(drive)

    def sensors(self, drive: Drive) -> Drive:
        """Return a drive with the faults of its sensors taken off, and nothing else."""
        if not self._sensors:
            return drive
        columns = dict(drive.columns)
        for term in self._sensors:
            columns = term.correct(columns, recording_of(drive))
        return replace(drive, columns=columns)


def usable_drives(
    paths: Sequence[Path],
    vehicle: Vehicle,
    held: Sequence[str] | None,
    any_vehicle: bool,
    opened: dict[Path, Drive] | None = None,
) -> tuple[list[Path], tuple[str, ...]]:
    """Return the drives that can be read and are of the vehicle, and in words why the others are left out.

    Files of labels are taken as they are; they are judged when they are learned. `opened` takes the drives, for who
    holds all of them anyway.

    Raises
    ------
    SplitError
        If no drive is left: the error of the first.
    """
    usable: list[Path] = []
    errors: list[SplitError] = []
    correct = RecordingCorrection(vehicle)
    for path in paths:
        try:
            if ".labels" not in path.name:
                drive = open_drive(path, held, beside=len(paths))
                vehicle_warnings([correct(drive)], vehicle, any_vehicle)
                if opened is not None:
                    opened[path] = drive
        except SplitError as error:
            errors.append(error)
        else:
            usable.append(path)
    if errors and not usable:
        raise errors[0]
    return usable, tuple(map(str, errors))


def vehicle_warnings(
    drives: Sequence[Drive], vehicle: Vehicle, any_vehicle: bool = False, shown: Sequence[Belonging] | None = None
) -> tuple[str, ...]:
    """Return warnings about drives that the vehicle can hardly have made.

    Parameters
    ----------
    any_vehicle : bool
        Warn, where the drive contradicts the vehicle, instead of refusing.
    shown : sequence of Belonging, optional
        What each drive shows of the vehicle's numbers, where that is known already.

    Raises
    ------
    DriveError
        If a drive is of another vehicle: its geometry, grip or mass contradict the file by more than a factor 2.5. Or
        if its steering or torque acts to the other side.
    """
    warnings = []
    shown = [belonging(drive, vehicle) for drive in drives] if shown is None else shown
    for drive, one in zip(drives, shown, strict=True):
        contradictions = one.contradictions()
        signs_only = contradictions == one.turned_signs()
        verb = "contradicts" if signs_only else "is not of"
        wrong = f"{verb} the vehicle {vehicle.name!r}: {'; '.join(contradictions)}"
        if contradictions and not any_vehicle:
            advice = "Check vehicle file, units and signs with `split info`, or go on with --any-vehicle."
            if signs_only:
                advice = "Turn it with `scale: -1` in the map, and ingest again; or go on with --any-vehicle."
            raise DriveError(wrong, where=drive.name, advice=advice)
        if contradictions:
            warnings.append(f"WARNING: {drive.name} {wrong}")
        warnings += [f"WARNING: {drive.name}: {doubt}: other tyres, load or road" for doubt in one.doubts()]
    return tuple(warnings)


def looks_like_another_car(drive: Drive, vehicle: Vehicle) -> str:
    """Return in words that a drive is rather of another car than that its map is wrong; empty where it is not.

    One wrong unit contradicts a vehicle file in one way. Steering, grip and torque do not all have a wrong unit.
    """
    shown = belonging(drive, vehicle)
    contradictions = [one for one in shown.contradictions() if one not in shown.turned_signs()]
    if len(contradictions) < 2:
        return ""
    return (
        f"this looks like a recording of another car than {vehicle.name!r} ({vehicle.mass:.4g} kg, wheelbase "
        f"{vehicle.wheelbase:.3g} m): {'; '.join(contradictions)}. If so, give the file of its car with --vehicle "
        "before you change the map"
    )
