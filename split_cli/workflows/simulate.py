"""Drive the plant and write what its sensors recorded, and the truth where asked for."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from split_cli.errors import SplitError
from split_cli.files import refuse_overwriting_inputs, refuse_what_cannot_be_written, sha256_of_file
from split_cli.logs.drive import Drive, DriveMetadata, NoiseEstimate, write_drive
from split_cli.plant.cars import CarParameters, find_car
from split_cli.plant.drivers import find_driver
from split_cli.plant.effects import EFFECTS, EffectKind, Setting, apply_effects, parse_effect
from split_cli.plant.faults import SOUND
from split_cli.plant.maneuvers import CALIBRATION_TESTS, build_maneuver, run_maneuver
from split_cli.plant.recording import TABLE_CHANNELS, write_csv, write_mcap, write_parquet
from split_cli.plant.road import Road
from split_cli.plant.sensors import ChannelSpec, Reading, SensorSpec, lean, measure, perfect, sensors_of
from split_cli.plant.simulation import Trajectory, drive_laps
from split_cli.plant.tracks import find_track

FORMATS = ("mcap", "csv", "parquet")
INSTRUMENTS = ("full", "lean", "perfect")
TABLE_RATE = 100.0
_WHEELS = ("fl", "fr", "rl", "rr")
_TRUTH_EXTRAS = (
    "s",
    "T_actual",
    "delta_actual",
    *(f"load_{wheel}" for wheel in _WHEELS),
    *(f"wheel_speed_{wheel}" for wheel in _WHEELS),
)
_PAUSE_BETWEEN_TESTS = 10.0
# A car's actuators keep a command until the next one.
_BETWEEN = {"T": "held", "delta": "held"}


@dataclass(frozen=True)
class SimulateSettings:
    """What to drive and how to record it."""

    car: str = "road_car"
    track: str | None = None  # laps of this track with a driver
    maneuver: str | None = None  # instead of laps, a standard test
    calibration_tests: bool = False  # instead of either, the set of gentle tests as one drive, a segment a test
    laps: float = 1.0
    duration: float | None = None  # instead of a number of laps [s]
    driver: str = "brisk"
    # Share of the car's grip that is used [1]; by default 0.6 for laps, 0.35 for tests.
    aggressiveness: float | None = None
    seed: int = 0
    format: str | None = None  # mcap, csv or parquet; by default from the name of the output
    instruments: str = "full"  # full, lean or perfect
    workshop_units: bool = False  # a CSV in km/h, deg, deg/s and g
    lead_in: float = 0.0  # recording begins so long after the start, when tyres and actuators have settled [s]
    # What the driver does not know of, each as ``NAME:parameter=value,...``; see `plant.effects`.
    effects: tuple[str, ...] = ()


@dataclass(frozen=True)
class SimulatedLog:
    """What was driven and written."""

    output: Path
    sha256: str  # of the output
    truth: Path | None
    what: str  # the car and what it did, in words
    # duration, distance: [s], [m]
    duration: float
    distance: float
    top_speed: float  # [m/s]
    # lateral_peak, driving_peak, braking_peak: greatest specific forces: across either way, forward, backward
    # [m/s^2].
    lateral_peak: float
    driving_peak: float
    braking_peak: float
    rates: tuple[tuple[str, float], ...]  # device and reports per second [Hz]
    effects: tuple[str, ...] = ()  # what was changed, with every parameter
    notes: tuple[str, ...] = ()


def effect_kinds() -> dict[str, EffectKind]:
    """Return the effects that can be concealed, by name."""
    return dict(EFFECTS)


def simulate_log(settings: SimulateSettings, output: str | Path, *, truth: str | Path | None = None) -> SimulatedLog:
    """Drive the plant once and write the log; with `truth`, the noise-free states as a drive too.

    Raises
    ------
    SplitError
        If a setting makes no sense, the car spun or left the track, or a file cannot be written.
    """
    output = Path(output)
    _check(settings)
    format_name = _format(settings, output)
    if truth is not None:
        refuse_overwriting_inputs([output], truth)
        refuse_what_cannot_be_written(truth)
    refuse_what_cannot_be_written(output)
    effects = tuple(map(parse_effect, settings.effects))
    texts = tuple(effect.text for effect in effects)
    car = find_car(settings.car)
    setting = apply_effects(_setting(settings, car), effects)
    runs, what = _drive(settings, car, setting)
    if settings.lead_in >= min(run.t[-1] for run in runs) - 1.0:
        raise SplitError(
            f"{settings.lead_in:g} s of lead-in leave nothing of the drive to record",
            where="--lead-in",
            advice="Lower --lead-in, or drive longer.",
        )
    rates = _write(settings, format_name, runs, setting.sensors, output)
    if truth is not None:
        write_drive(truth_drive(runs, Path(truth).name, texts, settings.lead_in), truth)
    channel = {name: np.concatenate([run.channel(name) for run in runs]) for name in ("vx", "ax", "ay")}
    return SimulatedLog(
        output=output,
        sha256=sha256_of_file(output),
        truth=None if truth is None else Path(truth),
        what=what,
        duration=float(sum(run.t[-1] for run in runs)),
        distance=float(sum(run.s[-1] - run.s[0] for run in runs)),
        top_speed=float(channel["vx"].max()),
        lateral_peak=float(np.abs(channel["ay"]).max()),
        driving_peak=float(max(channel["ax"].max(), 0.0)),
        braking_peak=float(max(-channel["ax"].min(), 0.0)),
        rates=rates,
        effects=texts,
        notes=_notes(settings, format_name, runs, what),
    )


def _setting(settings: SimulateSettings, car: CarParameters) -> Setting:
    """Return the sound car on a dry road, with the sensors that are asked for."""
    sensors = sensors_of(car.name)
    if settings.instruments != "full":
        sensors = lean(sensors) if settings.instruments == "lean" else perfect(sensors)
    return Setting(car, Road(), SOUND, sensors, find_track(settings.track).length if settings.track else 0.0)


def _write(
    settings: SimulateSettings,
    format_name: str,
    runs: Sequence[Trajectory],
    sensors: tuple[SensorSpec, ...],
    output: Path,
) -> tuple[tuple[str, float], ...]:
    """Write what the sensors record; return each device with its reports per second [Hz]."""
    seed, lead_in = settings.seed, settings.lead_in
    if settings.calibration_tests:
        tables = [_recorded(run, sensors, seed + i, lead_in, one_clock=TABLE_RATE) for i, run in enumerate(runs)]
        write_drive(_drive_of_tests(tables, sensors, output.name), output)
        return tuple((name, TABLE_RATE) for name in ("state", "inertial", "command"))
    if format_name == "mcap":
        readings = _recorded(runs[0], sensors, seed, lead_in)
        write_mcap(readings, output)
        return tuple((reading.sensor.name, reading.sensor.rate) for reading in readings)
    readings = _recorded(runs[0], sensors, seed, lead_in, one_clock=TABLE_RATE)
    if format_name == "csv":
        write_csv(readings, output, workshop_units=settings.workshop_units)
    else:
        write_parquet(readings, output)
    return (("table", TABLE_RATE),)


def _notes(settings: SimulateSettings, format_name: str, runs: Sequence[Trajectory], what: str) -> tuple[str, ...]:
    names = CALIBRATION_TESTS if settings.calibration_tests else [what]
    notes = tuple(
        f"{name} ended early, since the car had slowed to its lowest speed"
        for run, name in zip(runs, names, strict=False)
        if run.ended_early
    )
    if format_name != "mcap" and not settings.calibration_tests:
        notes += (
            "the table does not say that T and delta are commands, held between samples: --held T,delta does, or "
            "`kind: command` in the map",
        )
    return notes


def _recorded(
    run: Trajectory, sensors: tuple[SensorSpec, ...], seed: int, lead_in: float, *, one_clock: float | None = None
) -> tuple[Reading, ...]:
    """Return what the devices report from `lead_in` on, which becomes time 0."""

    def later(reading: Reading) -> Reading:
        kept = reading.stamp >= lead_in - 1e-9
        values = {name: column[kept] for name, column in reading.values.items()}
        return replace(
            reading, stamp=reading.stamp[kept] - lead_in, arrival=reading.arrival[kept] - lead_in, values=values
        )

    readings = measure(run, sensors, seed, one_clock=one_clock)
    return tuple(map(later, readings)) if lead_in else readings


def _check(settings: SimulateSettings) -> None:
    asked = [bool(settings.track), bool(settings.maneuver), settings.calibration_tests]
    if sum(asked) != 1:
        advice = "Give one of --track, --maneuver and --calibration-tests."
        raise SplitError(f"exactly one course is needed, {sum(asked)} were given", advice=advice)
    if settings.instruments not in INSTRUMENTS:
        what = f"no instruments are called {settings.instruments!r}"
        raise SplitError(what, where="--instruments", advice=f"There are: {', '.join(INSTRUMENTS)}.")
    if not 0.0 <= settings.lead_in < float("inf"):
        raise SplitError(f"must not be negative, got {settings.lead_in:g} s", where="--lead-in")
    if settings.seed < 0:
        raise SplitError(f"a seed is a whole number from 0, got {settings.seed}", where="--seed")


def _format(settings: SimulateSettings, output: Path) -> str:
    name = settings.format or output.suffix.lower().lstrip(".")
    if name not in FORMATS:
        what = f"does not say which format to write ({name or 'no suffix'!r})"
        raise SplitError(what, where=str(output), advice=f"Name it with --format: {', '.join(FORMATS)}.")
    if settings.calibration_tests and name != "parquet":
        what = f"calibration tests are written as a drive, which is Parquet, not {name}"
        raise SplitError(what, where=str(output), advice="Give the output the ending .parquet.")
    if settings.workshop_units and name != "csv":
        advice = "Give the output the ending .csv, or leave out --workshop-units."
        raise SplitError(f"workshop units are for csv, not {name}", where="--workshop-units", advice=advice)
    return name


def _drive(settings: SimulateSettings, believed: CarParameters, real: Setting) -> tuple[list[Trajectory], str]:
    """Return the runs of the car as it is, by a driver who believes in a sound one."""
    gentle = 0.35 if settings.aggressiveness is None else settings.aggressiveness
    if settings.track:
        share = 0.6 if settings.aggressiveness is None else settings.aggressiveness
        run = drive_laps(
            real.car,
            find_track(settings.track),
            find_driver(settings.driver),
            aggressiveness=share,
            laps=settings.laps,
            duration=settings.duration,
            seed=settings.seed,
            road=real.road,
            faults=real.faults,
            believed=believed,
        )
        laps = (run.s[-1] - run.s[0]) / run.lap_length
        who = f"{settings.driver} driver at {share:g} of the grip"
        return [run], f"{believed.name}, {laps:.2f} laps of {settings.track}, {who}"

    def tested(name: str, seed: int) -> Trajectory:
        maneuver = build_maneuver(name, believed, gentle)
        return run_maneuver(real.car, maneuver, seed=seed, road=real.road, faults=real.faults)

    if settings.maneuver:
        run = tested(settings.maneuver, settings.seed)
        return [run], f"{believed.name}, {settings.maneuver} at {gentle:g} of the grip"
    runs = [tested(name, settings.seed + i) for i, name in enumerate(CALIBRATION_TESTS)]
    return runs, f"{believed.name}, {len(runs)} tests at {gentle:g} of the grip: {', '.join(CALIBRATION_TESTS)}"


def truth_drive(runs: list[Trajectory], name: str, effects: tuple[str, ...] = (), lead_in: float = 0.0) -> Drive:
    """Return the exact states of runs as a drive at 100 Hz, a segment a run, with loads and wheel speeds beside.

    ``T`` and ``delta`` are the commands; ``T_actual`` and ``delta_actual`` what the actuators delivered. The
    metadata's quality tells the effects.
    """
    every = int(round(1.0 / TABLE_RATE / (runs[0].t[1] - runs[0].t[0])))
    parts = []
    for run in runs:
        first = int(np.searchsorted(run.t, lead_in - 1e-9))
        part = {channel: run.channel(channel)[first::every] for channel in (*TABLE_CHANNELS, *_TRUTH_EXTRAS)}
        part["t"] = part["t"] - lead_in
        # In a drive a wheel's speed is that of its rim [m/s], the plant counts its spin [rad/s].
        spins = [name for name in part if name.startswith("wheel_speed_")]
        part |= {name: part[name] * run.car.wheel_radius for name in spins}
        parts.append(part)
    noise = tuple(NoiseEstimate(channel, 0.0, 0.0) for channel in ("X", "Y", "yaw", "vx", "vy", "r", "ax", "ay"))
    return _joined(parts, name, noise, "exact states of the plant, without sensors", effects)


def _drive_of_tests(tables: list[tuple[Reading, ...]], sensors: tuple[SensorSpec, ...], name: str) -> Drive:
    parts = []
    for readings in tables:
        columns: dict[str, np.ndarray] = {"t": np.round(readings[0].stamp, 6)}
        for reading in readings:
            for channel, values in reading.values.items():
                columns.setdefault(channel, values)
        parts.append({channel: columns[channel] for channel in TABLE_CHANNELS})
    specs: dict[str, ChannelSpec] = {}
    for sensor in sensors:
        for channel, spec in sensor.channels.items():
            specs.setdefault(channel, spec)
    # The rounding's own error is uniform over a step.
    sigmas = {channel: float(np.hypot(s.noise, s.resolution / 12**0.5)) for channel, s in specs.items()}
    noise = tuple(NoiseEstimate(c, sigmas[c], sigmas[c]) for c in TABLE_CHANNELS if c not in ("t", "T", "delta"))
    return _joined(parts, name, noise, "simulated sensors on one clock, seeded noise")


def _joined(
    parts: list[dict[str, np.ndarray]],
    name: str,
    noise: tuple[NoiseEstimate, ...],
    origin: str,
    effects: tuple[str, ...] = (),
) -> Drive:
    start, columns, segment = 0.0, {channel: [] for channel in parts[0]}, []
    for number, part in enumerate(parts):
        for channel, values in part.items():
            columns[channel].append(values + start if channel == "t" else values)
        segment.append(np.full(len(part["t"]), number, dtype=np.int32))
        start = float(columns["t"][-1][-1]) + _PAUSE_BETWEEN_TESTS
    kinds = {channel: "measured" for channel in parts[0] if channel != "t"}
    kinds |= {"T": "command", "delta": "command"}
    quality = {"tests": list(CALIBRATION_TESTS)} if len(parts) == len(CALIBRATION_TESTS) else {}
    if effects:
        quality["effects"] = list(effects)
    return Drive(
        name=name,
        columns={channel: np.concatenate(values) for channel, values in columns.items()},
        segment=np.concatenate(segment),
        period=1.0 / TABLE_RATE,
        metadata=DriveMetadata(kinds=kinds, conversions=(origin,), noise=noise, quality=quality, between=_BETWEEN),
    )
