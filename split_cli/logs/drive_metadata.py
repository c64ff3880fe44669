"""What a drive's file says beside its samples: sources, noise, kinds of channels, how it was made."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

import pyarrow as pa
import pyarrow.parquet

from split_cli.errors import DriveError
from split_cli.files import parse_json

_FORMAT = "split-drive/1"
#: Checks whose findings make what is learned from a drive wrong, where they are about a channel of the model.
_FAULTS = ("scale", "sign", "hand", "swapped", "range", "constant", "copied", "clock")
_MODEL_CHANNELS = ("vx", "vy", "r", "T", "delta")
#: Words of a v_y that a measured side-slip angle gives.
MEASURED_SIDESLIP = "the measured sideslip angle"
#: Words of motion that position and yaw give.
OF_POSE = "from X, Y, yaw"
#: Words of a v_x that wheel speeds give.
OF_WHEELS = "speed of the"
#: Words of a yaw rate that the lateral acceleration gives, and of the v_y beside it where the rear tyres give that.
WITHOUT_GYRO = "from a_y"
OF_REAR_TIRES = "and the slip of the vehicle file's rear tyres"
_ASSUMED_SIDESLIP = "no yaw rate was recorded: r and v_y follow from a_y and the rear tyres of the vehicle file"
_DERIVED_YAW_RATE = "no yaw rate was recorded: r follows from a_y and v_y"
#: Why the error of a state says nothing of the car: an input or the state itself was made of the model.
CIRCULAR = {"v_x": "T was derived from the motion", "v_y": "v_y was derived with the rear tyres of the vehicle file"}
#: Words of a torque that was derived from what was asked of the drive train.
_ASKED = ("throttle", "pedal", "brake", "current", "N m/A")


def is_derived(kind: object) -> bool:
    """Tell whether a kind of channel, see `DriveMetadata.kinds`, is that of one computed from others."""
    return isinstance(kind, str) and kind.startswith("derived")


def yaw_rate_is_of_acceleration(kinds: Mapping[str, str]) -> bool:
    """Tell whether r was derived from a_y: neither judges the other, and a mistake of a_y is in both."""
    return is_derived(kinds.get("r", "")) and WITHOUT_GYRO in kinds["r"]


@dataclass(frozen=True)
class Source:
    """A file a drive was made of: its name (no folder) and the SHA-256 of its content."""

    name: str
    sha256: str


@dataclass(frozen=True)
class NoiseEstimate:
    """Sensor noise of one channel."""

    channel: str
    # Standard deviation of a sample of the drive, after its filter [SI unit of the channel]; None if unknown.
    sigma: float | None
    sigma_raw: float | None  # the same at the recording's full rate, before any filter
    # Autocorrelation of the noise on the drive's clock at lags 0, 1, 2, ... samples, from the filter's impulse
    # response; ``(1.0,)`` for white noise.
    autocorrelation: tuple[float, ...] = (1.0,)
    reason: str = ""  # why sigma is None, else empty


@dataclass(frozen=True)
class DriveMetadata:
    """What is known of a drive beside its samples."""

    sources: tuple[Source, ...] = ()  # the recordings it was made of
    vehicle: str = ""  # name of the vehicle file it was made with; empty if none
    # For a channel, ``command``, ``measured`` or ``derived: how``.
    kinds: Mapping[str, str] = field(default_factory=dict)
    # The map as applied, channel by channel, with what was assumed.
    signal_map: Mapping[str, object] = field(default_factory=dict)
    conversions: tuple[str, ...] = ()  # frame, sign, unit and time conversions that were made, in words
    noise: tuple[NoiseEstimate, ...] = ()
    # The quality report: rates, gaps, drops by reason, spikes, ranges, findings of the consistency checks.
    quality: Mapping[str, object] = field(default_factory=dict)
    # What a channel does between its samples: ``held`` keeps its value until the next sample, ``continuous`` runs
    # there in a straight line. A channel that is not named is taken as continuous.
    between: Mapping[str, str] = field(default_factory=dict)

    @property
    def contradictions(self) -> tuple[str, ...]:
        """What the checks found that makes what is learned wrong: a unit, a sign, a swap, a dead channel."""
        return tuple(_clause(f) for f in self._findings if _is_fault(f))

    @property
    def faults(self) -> tuple[str, ...]:
        """Why a controller should not use what is learned: contradictions, and a sideslip that was assumed."""
        return (*self.contradictions, *((_ASSUMED_SIDESLIP,) if self.sideslip_is_of_tires else ()))

    @property
    def remarks(self) -> tuple[str, ...]:
        """What else the checks at ingest found, one clause each."""
        found = tuple(_clause(f) for f in self._findings if not _is_fault(f))
        only_r = yaw_rate_is_of_acceleration(self.kinds) and not self.sideslip_is_of_tires
        return (*found, _DERIVED_YAW_RATE) if only_r else found

    @property
    def _findings(self) -> list[Mapping[str, Any]]:
        consistency = self.quality.get("consistency")
        findings = consistency.get("findings") if isinstance(consistency, Mapping) else None
        return [f for f in findings or () if isinstance(f, Mapping) and f.get("text")]

    @property
    def reported_kinds(self) -> tuple[str, ...]:
        """The channels with their kinds, those of one kind together: ``vx, vy, r measured``."""
        alike: dict[str, list[str]] = {}
        for channel, kind in self.kinds.items():
            alike.setdefault(kind, []).append(channel)
        return tuple(f"{', '.join(channels)} {kind}" for kind, channels in alike.items())

    @property
    def speed_is_of_wheels(self) -> bool:
        """Whether v_x was derived from wheel speeds: their slip under torque is in it."""
        return self.is_derived("vx") and OF_WHEELS in self.kinds["vx"]

    @property
    def lateral_velocity_is_integrated(self) -> bool:
        """Whether v_y was integrated from a_y: no sensor of velocity shows in it, and what a_y reads does."""
        return self.is_derived("vy") and "a_y" in self.kinds["vy"] and not self.sideslip_is_of_tires

    @property
    def sideslip_is_of_tires(self) -> bool:
        """Whether r and v_y are what the rear tyres of the vehicle file need for a_y: no recording contradicts them."""
        return self.is_derived("vy") and OF_REAR_TIRES in self.kinds["vy"]

    @property
    def torque_follows_motion(self) -> bool:
        """Whether T was derived from the motion, or nobody says from what: it cannot contradict it then."""
        return self.is_derived("T") and not self.torque_is_from_pedals

    @property
    def circular(self) -> tuple[str, ...]:
        """The states whose error says nothing of the car, keys of `CIRCULAR`."""
        holds = {"v_x": self.torque_follows_motion, "v_y": self.sideslip_is_of_tires}
        return tuple(state for state in CIRCULAR if holds[state])

    @property
    def torque_is_from_pedals(self) -> bool:
        """Whether T was derived from pedals or a motor's current: a command with an assumed map."""
        kind = self.kinds.get("T", "") if self.is_derived("T") else ""
        return "by the nominal model" not in kind and any(word in kind for word in _ASKED)

    def is_derived(self, channel: str) -> bool:
        """Tell whether a channel was computed from others."""
        return is_derived(self.kinds.get(channel, ""))

    def noise_of(self, channel: str) -> NoiseEstimate | None:
        """Return the noise estimate of a channel, None when ingest made none."""
        return next((estimate for estimate in self.noise if estimate.channel == channel), None)


class SaysNothing(Protocol):
    """A drive, its labels or a source of a set: what knows of which states it says nothing."""

    @property
    def circular(self) -> tuple[str, ...]:
        """Keys of `CIRCULAR`."""


def circular_in_any(drives: Iterable[SaysNothing]) -> tuple[str, ...]:
    """Return the states of which at least one of the drives says nothing, keys of `CIRCULAR`: no error is judged."""
    found = {state for drive in drives for state in drive.circular}
    return tuple(state for state in CIRCULAR if state in found)


def circular_in_all(drives: Sequence[SaysNothing]) -> tuple[str, ...]:
    """Return the states of which no drive says anything, keys of `CIRCULAR`: nothing can be learned. None of none."""
    return tuple(state for state in CIRCULAR if drives and all(state in drive.circular for drive in drives))


def ingest_found(name: str, clauses: Sequence[str]) -> tuple[str, ...]:
    """Return what ingest found in the drive of that name as a note; nothing where it found nothing."""
    return (f"{name}: ingest found that {'; '.join(clauses)}",) if clauses else ()


def _is_fault(finding: Mapping[str, Any]) -> bool:
    return finding.get("check") in _FAULTS and finding.get("channel") in _MODEL_CHANNELS


def _clause(finding: Mapping[str, Any]) -> str:
    """Return the first clause of a finding: what is wrong, without its figures and advice."""
    text = str(finding["text"])
    for end in (" (", ". ", ": "):
        text = text.split(end)[0]
    return text.rstrip(".")


def schema_of(metadata: DriveMetadata, period: float) -> dict[bytes, bytes]:
    """Return what a drive's file holds of metadata and period [s]; `metadata_from_schema` reads it."""
    stored = {"format": _FORMAT, "period": period, **asdict(metadata)}
    return {b"split": json.dumps(stored, sort_keys=True, allow_nan=False).encode()}


def metadata_from_schema(raw: Mapping[bytes, bytes], path: Path) -> tuple[DriveMetadata, float | None]:
    """Return metadata and period [s] of a drive's file; nothing and None where another program wrote it.

    Raises
    ------
    DriveError
        If they are damaged, or of another version.
    """
    if b"split" not in raw:
        return DriveMetadata(), None
    try:
        stored = parse_json(raw[b"split"])
        if stored["format"] != _FORMAT:
            what = f"is of format {stored['format']!r}, this version reads {_FORMAT!r}"
            raise DriveError(what, where=str(path), advice="Ingest the recording again.")
        _check_kinds_of_values(stored)
        noise = tuple(
            NoiseEstimate(**{**entry, "autocorrelation": tuple(entry["autocorrelation"])}) for entry in stored["noise"]
        )
        metadata = DriveMetadata(
            sources=tuple(Source(**entry) for entry in stored["sources"]),
            vehicle=stored["vehicle"],
            kinds=stored["kinds"],
            signal_map=stored["signal_map"],
            conversions=tuple(stored["conversions"]),
            noise=noise,
            quality=stored["quality"],
            between=_between(stored.get("between", {})),
        )
        period = float(stored["period"])
        if not 0.0 < period < float("inf"):
            raise ValueError(f"a period of {period:g} s")
        return metadata, period
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        advice = "Ingest the recording again."
        raise DriveError(f"its metadata is damaged ({error})", where=str(path), advice=advice) from error


def metadata_of_drive(path: Path) -> DriveMetadata | None:
    """Return what a drive's file says of itself; None where the file is no drive of ours."""
    if path.suffix.lower() not in (".parquet", ".pq") or not path.is_file():
        return None
    try:
        raw = pa.parquet.read_schema(path).metadata or {}
    except (pa.ArrowException, OSError, ValueError):
        return None
    return metadata_from_schema(raw, path)[0] if b"split" in raw else None


def _check_kinds_of_values(stored: Mapping[str, Any]) -> None:
    """Refuse a forged file whose values are of another kind than those that `schema_of` writes."""
    kinds = {
        "sources": list,
        "vehicle": str,
        "kinds": dict,
        "signal_map": dict,
        "conversions": list,
        "noise": list,
        "quality": dict,
    }
    wrong = [name for name, kind in kinds.items() if not isinstance(stored[name], kind)]
    between = stored.get("between", {})
    texts = {
        "sources": [value for entry in stored["sources"] for value in dict(entry).values()],
        "kinds": stored["kinds"].values() if isinstance(stored["kinds"], dict) else (),
        "conversions": stored["conversions"],
        "between": between.values() if isinstance(between, dict) else (None,),
        "noise": [dict(entry)["channel"] for entry in stored["noise"]],
    }
    wrong += [name for name, values in texts.items() if not all(isinstance(value, str) for value in values)]
    for entry in stored["noise"]:
        numbers = (entry["sigma"], entry["sigma_raw"], *entry["autocorrelation"])
        if not all(value is None or type(value) in (int, float) and abs(value) < 1e300 for value in numbers):
            wrong.append("noise")
    if wrong:
        raise ValueError(f"{wrong[0]} is of another kind than what a drive holds")


def _between(stored: Mapping[str, str]) -> dict[str, str]:
    unknown = sorted(set(stored.values()) - {"held", "continuous"})
    if unknown:
        raise ValueError(f"a channel is {unknown[0]!r} between samples")
    return dict(stored)
