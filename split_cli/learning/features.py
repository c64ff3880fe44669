"""What the residual is a function of: z2 = [alpha_f, alpha_r, T/T_max], z1, or any list of named signals."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.errors import DriveError, nearest_names
from split_cli.logs.drive import Drive
from split_cli.signals import CHANNELS
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.effects.recording import Recording
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.single_track import SingleTrack


@dataclass(frozen=True)
class FeatureSet:
    """An ordered list of named features.

    Attributes
    ----------
    names : tuple of str
        ``alpha_f``, ``alpha_r`` [rad], ``torque_ratio`` (T/T_max) [1], ``speed`` [m/s], ``steer_rate`` [rad/s],
        a state of one of the vehicle's terms, as ``drive_lag.torque`` [N m] or ``tire_relaxation.front`` [N], or
        any channel of the drive.

    Notes
    -----
    Features of one moment do not determine the car's past. A state of a term, such as the torque that has arrived
    or the lateral force that has built up, holds a part of it.
    """

    names: tuple[str, ...]

    @property
    def is_z2(self) -> bool:
        """Whether these are the three features the valid region is defined over."""
        return self.names == Z2.names

    @property
    def within_region(self) -> tuple[bool, ...]:
        """For each feature, whether the valid region limits it: those of z2, and states of terms behind them."""
        return tuple(name in Z2.names or "." in name for name in self.names)

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each feature, "1" for a number; "" for a channel that no command knows."""
        return tuple(_unit(name) for name in self.names)

    def compute(self, model: SingleTrack, drive: Drive, recording: Recording | None = None) -> np.ndarray:
        """Return the features of every sample of a drive, shape (N, D); `recording` as of `flow_along`.

        Raises
        ------
        DriveError
            If a feature is neither computed nor a channel of the drive, or of a term that the vehicle lacks.
        """
        return self.of_flow(model, drive, flow_along(model, drive, recording))

    def of_flow(self, model: SingleTrack, drive: Drive, flow: Flow) -> np.ndarray:
        """Return the features of every sample of a drive whose flow is known, see `compute`."""
        drive = _on_the_sensors_clock(model, drive, flow)
        computed = {
            "alpha_f": flow.front.slip_angle,
            "alpha_r": flow.rear.slip_angle,
            "torque_ratio": drive["T"] / model.vehicle.max_torque,
            "speed": np.hypot(drive["vx"], drive["vy"]),
            **{name: flow.values[name] for name in model.state_names},
        }
        if "steer_rate" in self.names:
            computed["steer_rate"] = _steer_rate(drive)
        columns = []
        for name in self.names:
            if name not in computed and name not in drive:
                raise _no_feature(name, [*computed, "steer_rate", *drive.columns], drive, model)
            columns.append(computed[name] if name in computed else drive[name])
        return np.ascontiguousarray(np.stack(columns, axis=1))


def _unit(name: str) -> str:
    term, _, state = name.partition(".")
    if name in _UNITS:
        return _UNITS[name]
    if name in CHANNELS:
        return CHANNELS[name].unit
    return CATALOGUE[term].state_units.get(state, "") if term in CATALOGUE else ""


def _no_feature(name: str, known: Sequence[str], drive: Drive, model: SingleTrack) -> DriveError:
    term, _, state = name.partition(".")
    if term not in CATALOGUE or state not in CATALOGUE[term].states:
        advice = f"{nearest_names(name, known)} The usual features are z2 and z1."
        return DriveError(f"no feature {name!r}", where=drive.name, advice=advice)
    units = CATALOGUE[term].units.items()
    values = ", ".join(f"{parameter}: VALUE" + (f" [{unit}]" if unit != "1" else "") for parameter, unit in units)
    return DriveError(
        f"the feature {name!r} is a state of the term {term}, which the vehicle {model.vehicle.name} lacks",
        advice=f"Add the term under `effects:` of the vehicle file: `- term: {term}`, `parameters` with {values}. "
        "docs/formats.md, Vehicle, shows an example.",
    )


def flow_along(model: SingleTrack, drive: Drive, recording: Recording | None = None) -> Flow:
    """Evaluate a model on every sample of a drive, the memory of its terms followed along each segment.

    Parameters
    ----------
    recording : Recording, optional
        The drive's clock, with what terms remember at its first row where it is a piece of a longer drive; by
        default that of a whole drive.
    """
    yaw = drive.columns.get("yaw", 0.0)
    channels = (drive[name] for name in ("vx", "vy", "r", "T", "delta"))
    # Samples that are not finite are counted and rejected by who asks.
    with np.errstate(invalid="ignore"):
        clock = recording or recording_of(drive)
        return model.flow(*channels, yaw=yaw, t=drive["t"], s=place_of(drive), recording=clock)


def _on_the_sensors_clock(model: SingleTrack, drive: Drive, flow: Flow) -> Drive:
    """Return a drive with commands as old as what late sensors measure; actuators' delays are the car's own."""
    columns = dict(drive.columns)
    for term in model.terms:
        if not getattr(term, "exported", True):
            for channel, delay in getattr(term, "input_delays", {}).items():
                columns[channel] = term.delayed(flow, columns[channel], delay)
    return replace(drive, columns=columns)


def place_of(drive: Drive) -> np.ndarray:
    """Return the track position of every sample [m], shape (N,): the column ``s``, 0 where there is none."""
    return drive["s"] if "s" in drive else np.zeros(len(drive))


def recording_of(drive: Drive) -> Recording:
    """Return a drive's clock and segments, as terms with memory need them."""
    return Recording(drive.period, tuple((run.start, run.stop) for run in drive.segments()))


Z1 = FeatureSet(("vx", "vy", "r", "torque_ratio", "delta"))
Z2 = FeatureSet(("alpha_f", "alpha_r", "torque_ratio"))


_NAMED = {"z1": Z1, "z2": Z2}
_UNITS = {"alpha_f": "rad", "alpha_r": "rad", "torque_ratio": "1", "speed": "m/s", "steer_rate": "rad/s"}


def parse_features(text: str | Sequence[str]) -> FeatureSet:
    """Return the feature set named by a comma-separated list or a sequence.

    Beside single features it may name ``z1`` or ``z2``, or a term for all of its states: ``z2,feature_lag``.
    """
    if isinstance(text, str):
        text = [name.strip() for name in text.split(",") if name.strip()]
    names = tuple(one for name in text for one in _named(name))
    twice = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if twice is not None:
        advice = "Give one of them, or list each signal once." if len(text) > 1 else "List each signal once."
        raise DriveError(f"features {','.join(text)!r} contain {twice} twice", advice=advice)
    if not names:
        raise DriveError("features: no name was given", advice="Give z1, z2 or a comma-separated list of signals.")
    return FeatureSet(names)


def _named(name: str) -> tuple[str, ...]:
    if name.lower() in _NAMED:
        return _NAMED[name.lower()].names
    if name in CATALOGUE and CATALOGUE[name].states:
        return tuple(f"{name}.{state}" for state in CATALOGUE[name].states)
    return (name,)


def _steer_rate(drive: Drive) -> np.ndarray:
    rate = np.zeros(len(drive))
    for run in drive.segments():
        if run.stop - run.start > 1:
            rate[run] = np.gradient(drive["delta"][run], drive.period)
    return rate
