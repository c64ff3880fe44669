"""Pairs of drives by seed: a car, drivers, courses and effects are drawn, driven, recorded and ingested."""

import json
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from split_cli.files import atomic_directory, atomic_write_text
from split_cli.vehicle.calibration.calibrate import CalibrationSettings
from split_cli.workflows.calibrate import calibrate_files
from split_cli.workflows.ingesting.ingest import ingest_logs
from tests.studies.other_cars.cars import KINDS, Car, CarKind
from tests.studies.other_cars.course import STYLES, draw_course
from tests.studies.other_cars.driver import Driven, LostCar, draw_driver, drive
from tests.studies.other_cars.effects import EFFECTS, STRANGE, PlantedEffect, may_join
from tests.studies.other_cars.recording import SensorFaults, recorded, signal_map, vehicle_text, write_log
from tests.studies.other_cars.sizes import LEAST_VISIBLE, effect_over_noise

#: Shares of pairs without an effect, with one, with two to four, and with a strange one.
_SHARES = (0.15, 0.30, 0.45, 0.10)
_TRIALS = 60
#: Courses on which the engineer fits tyres: turns of every size, with little done at once.
_FOR_TYRES = ("closed course", "figure eight")
#: By which the engineer's drag and rolling resistance are wrong, relative standard deviation [1].
_RESISTANCE = 0.08


@dataclass(frozen=True)
class PairTruth:
    """What was put into a pair.

    Attributes
    ----------
    number : int
        Of the pair in its list, from 0 on.
    car, sim_course, real_course : str
        Names of car and courses.
    period : float
        Of both recordings [s].
    position, acceleration : bool
        Whether position and yaw, and accelerations, were recorded.
    effects : tuple of PlantedEffect
    sizes : tuple of float
        What each effect changes in 0.05 s, over noise [1].
    """

    number: int
    car: str
    sim_course: str
    real_course: str
    period: float
    position: bool
    acceleration: bool
    effects: tuple[PlantedEffect, ...] = ()
    sizes: tuple[float, ...] = ()
    paces: dict[str, float] = field(default_factory=dict)

    @property
    def is_strange(self) -> bool:
        """Whether an effect is outside the catalogue."""
        return any(not effect.term for effect in self.effects)


def pair_name(number: int) -> str:
    """Return the name of a pair's folder."""
    return f"{number:03d}"


def case_folder(root: Path, number: int) -> Path:
    """Return the folder of what a diagnosis may read of a pair."""
    return root / "cases" / pair_name(number)


def generate_pairs(root: Path, seed: int, numbers: Sequence[int]) -> list[PairTruth]:
    """Write the pairs that are not there yet and FOLDER/truth.json, and return the truth of all that are asked for.

    Raises
    ------
    ValueError
        If the folder holds pairs of another seed.
    """
    path = root / "truth.json"
    stored = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"seed": seed, "pairs": []}
    if stored["seed"] != seed:
        raise ValueError(f"{path} has seed {stored['seed']}, not {seed}")
    known = {entry["number"]: truth_from(entry) for entry in stored["pairs"]}
    for number in numbers:
        if number not in known or not case_folder(root, number).exists():
            known[number] = write_pair(root, seed, number)
            pairs = [asdict(known[one]) for one in sorted(known)]
            atomic_write_text(path, json.dumps({"seed": seed, "pairs": pairs}, indent=1) + "\n")
    return [known[number] for number in numbers]


def truth_from(entry: dict) -> PairTruth:
    """Return a truth from its JSON."""
    effects = tuple(PlantedEffect(**effect) for effect in entry["effects"])
    return PairTruth(**{**entry, "effects": effects, "sizes": tuple(entry["sizes"])})


def write_pair(
    root: Path, seed: int, number: int, planted: Sequence[PlantedEffect] | None = None, car_name: str = ""
) -> PairTruth:
    """Draw one pair, write its folder, and return its truth; equal seeds give equal files.

    Parameters
    ----------
    planted : sequence of PlantedEffect, optional
        Put in instead of effects that are drawn, whatever their size.
    car_name : str, optional
        Of `KINDS`, instead of one that is drawn.
    """
    rng = np.random.default_rng([seed, number])
    kind = list(KINDS.values())[rng.integers(len(KINDS))]
    kind = KINDS[car_name] if car_name else kind
    car = kind.varied(rng)
    period = float(rng.choice(kind.periods))
    position, acceleration = bool(rng.random() < 0.6), bool(rng.random() < 0.75)
    duration = float(rng.uniform(70.0, 100.0)) * (0.7 if kind.name == "model car" else 1.0)
    sim_style, real_style = (str(rng.choice(STYLES)) for _ in range(2))
    tyre_style = str(rng.choice(_FOR_TYRES))
    share = rng.random()
    is_strange = share > 1.0 - _SHARES[3]
    count = 0 if share < _SHARES[0] else 1 if share < _SHARES[0] + _SHARES[1] or is_strange else rng.integers(2, 5)
    simulated, sim_pace = _any_drive(kind, car, sim_style, duration, rng)
    of_tyres, _ = _any_drive(kind, car, tyre_style, duration, rng)
    for _ in range(_TRIALS):
        course = draw_course(rng, real_style, kind.room)
        driver = draw_driver(rng, real_style)
        hands = int(rng.integers(2**31))
        try:
            probe = drive(kind, car, course, driver, duration, np.random.default_rng(hands))
            if planted is None:
                effects, sizes = _drawn_effects(kind, probe, STRANGE if is_strange else EFFECTS, int(count), rng)
            else:
                effects = tuple(planted)
                sizes = tuple(effect_over_noise(kind, probe, effect) for effect in effects)
            changed, sensors = _with_effects(car, effects)
            real = drive(kind, changed, course, driver, duration, np.random.default_rng(hands))
            break
        except LostCar:
            continue
    else:
        raise RuntimeError(f"pair {number} of seed {seed} has no drive on its course")
    position = position or any(effect.needs_position for effect in effects)
    given = {"position": position, "acceleration": acceleration}
    recordings = {
        "real": recorded(kind, real, sensors, period, rng, **given),
        "sim": recorded(kind, simulated, SensorFaults(), period, rng, **given),
        "tyres": recorded(kind, of_tyres, SensorFaults(), period, rng, **given),
    }
    wrong = np.exp(_RESISTANCE * rng.standard_normal(2))
    file = vehicle_text(kind, car._replace(drag=car.drag * wrong[0], rolling=car.rolling * wrong[1]))
    _write_case(kind, recordings, file, case_folder(root, number))
    styles, paces = (sim_style, real_style), {"sim": sim_pace, "real": driver.pace}
    return PairTruth(number, kind.name, *styles, period, position, acceleration, effects, sizes, paces)


def _any_drive(kind: CarKind, car: Car, style: str, duration: float, rng: np.random.Generator) -> tuple[Driven, float]:
    """Return a drive of a course and driver that are drawn until the car stays on its course, and the pace."""
    for _ in range(_TRIALS):
        course, driver = draw_course(rng, style, kind.room), draw_driver(rng, style)
        try:
            return drive(kind, car, course, driver, duration, rng), driver.pace
        except LostCar:
            continue
    raise RuntimeError(f"no driver keeps the {kind.name} on a course of the style {style}")


def _drawn_effects(
    kind: CarKind, probe: Driven, among: dict, count: int, rng: np.random.Generator
) -> tuple[tuple[PlantedEffect, ...], tuple[float, ...]]:
    """Return effects that may stand together, each visible by itself, and their sizes over noise."""
    effects: list[PlantedEffect] = []
    sizes: list[float] = []
    names = list(among)
    while len(effects) < count:
        effect = among[names[rng.integers(len(names))]](rng, kind, probe.car, probe.course)
        if not may_join(effect, effects):
            continue
        size = effect_over_noise(kind, probe, effect)
        if size >= LEAST_VISIBLE:
            effects.append(effect)
            sizes.append(size)
    return tuple(effects), tuple(sizes)


def _with_effects(car: Car, effects: Sequence[PlantedEffect]) -> tuple[Car, SensorFaults]:
    sensors = SensorFaults()
    for effect in effects:
        car, sensors = effect.on_car(car), effect.on_sensors(sensors)
    return car, sensors


def _write_case(kind: CarKind, recordings: dict[str, dict], vehicle: str, folder: Path) -> None:
    """Ingest the logs of a pair as a user does, fit the tyres to a third drive, and write the folder whole."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as rough, atomic_directory(folder) as out:
        logs = Path(rough)
        (logs / "map.yaml").write_text(signal_map(kind), encoding="utf-8")
        (logs / "car.yaml").write_text(vehicle, encoding="utf-8")
        for name, columns in recordings.items():
            write_log(kind, columns, logs / f"{name}.csv")
            made = (logs if name == "tyres" else out) / f"{name}.parquet"
            ingest_logs([logs / f"{name}.csv"], made, maps=[logs / "map.yaml"], vehicle_path=logs / "car.yaml")
        settings = CalibrationSettings(parts=("tires",))
        calibrate_files([logs / "tyres.parquet"], logs / "car.yaml", out / "vehicle.yaml", settings)
