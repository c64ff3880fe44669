"""Plant mistakes in a log, alone and in pairs, ingest it with a vehicle file, and print what is said of each.

Example: ``python -m tests.studies.planted_logs genesis.parquet --vehicle genesis``. The whole of ingest runs, with
clocks, delays and wheel speeds.

Of each case the table says: *right*, the words of the mistake are said of its channel; *told*, something new is
said, also that a relation is not judged; *silent*; and *false*, a channel without a mistake is blamed.
"""

import argparse
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from split_cli.errors import SplitError
from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.drive import Drive, read_drive
from split_cli.logs.raw import RawSignal, TableRecording
from split_cli.logs.signal_map import map_from_mapping
from split_cli.signals import CHANNELS
from split_cli.vehicle.parameters import Vehicle, read_vehicle

_UNITS = {name: channel.unit for name, channel in CHANNELS.items() if name != "t"}
_CORNERS = {"fl": (1, -1), "fr": (1, 1), "rl": (-1, -1), "rr": (-1, 1)}
_TRACK = 0.58
"""Of a car's wheelbase, for the wheel speeds that are made for it [1]."""
_ROWS = 12_000
_IN_MS = "the map says ms"
Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class Defect:
    """A mistake: what it does to the columns of a log, the channel to be told, and words that explain it."""

    change: Callable[[Columns], Columns]
    channels: tuple[str, ...]
    words: str
    around: tuple[str, ...] = ()


def _times(channel: str, factor: float) -> Callable[[Columns], Columns]:
    return lambda c: {channel: c[channel] * factor}


def _late(channel: str, seconds: float) -> Callable[[Columns], Columns]:
    return lambda c: {channel: np.interp(c["t"] - seconds, c["t"], c[channel])}


DEG, G, MPH = 180.0 / np.pi, 9.80665, 0.44704
PLANTED: dict[str, Defect] = {
    "clock in ms as s": Defect(lambda c: {"t": c["t"] * 1e3}, ("time",), "probably in ms"),
    "clock in s as ms": Defect(lambda c: {"t": c["t"], _IN_MS: c["t"]}, ("time",), "probably in s"),
    "rows newest first": Defect(lambda c: {n: v[::-1] for n, v in c.items() if n != "t"}, ("time",), "backwards"),
    "yaw rate in deg/s": Defect(_times("r", DEG), ("r",), "is in deg/s"),
    "yaw rate clockwise": Defect(_times("r", -1.0), ("r",), "left-handed"),
    "yaw rate 0.2 s late": Defect(_late("r", 0.2), ("r",), "late"),
    "yaw in degrees": Defect(_times("yaw", DEG), ("yaw",), "is in deg"),
    "yaw rate copied from the steer angle": Defect(lambda c: {"r": c["delta"]}, ("r", "delta"), "copy"),
    "yaw rate computed from the steer angle": Defect(
        lambda c: {"r": c["vx"] * np.tan(c["delta"]) / (2.0 * c["lr"])}, ("r",), "computed from"
    ),
    "v_x in km/h": Defect(_times("vx", 3.6), ("vx",), "is in km/h"),
    "v_x in mph": Defect(_times("vx", 1 / MPH), ("vx",), "is in mph"),
    "v_x 6 % too large": Defect(_times("vx", 1.06), ("X", "vx"), "times the"),
    "v_y in mm/s": Defect(_times("vy", 1e3), ("vy",), "mm/s"),
    "v_y in km/h": Defect(_times("vy", 3.6), ("vy",), "is in km/h"),
    "v_y right-positive": Defect(_times("vy", -1.0), ("vy",), "right-positive"),
    "v_y of the rear axle": Defect(lambda c: {"vy": c["vy"] - c["lr"] * c["r"]}, ("vy",), "rear_axle"),
    "a_x in g": Defect(_times("ax", 1 / G), ("ax",), "is in g"),
    "a_x in ft/s^2": Defect(_times("ax", 1 / 0.3048), ("ax",), "ft/s"),
    "a_y in g": Defect(_times("ay", 1 / G), ("ay",), "is in g"),
    "a_y right-positive": Defect(_times("ay", -1.0), ("ay",), "right-positive"),
    "a_x and a_y exchanged": Defect(lambda c: {"ax": c["ay"], "ay": c["ax"]}, ("ax", "ay"), "along the other"),
    "position in mm": Defect(lambda c: {n: c[n] * 1e3 for n in "XY"}, ("X",), "mm"),
    "north and east as X and Y": Defect(lambda c: {"X": c["Y"], "Y": c["X"]}, ("X",), "mirrored", ("yaw", "r")),
    "north-east-down, whole pose": Defect(
        lambda c: {"X": c["Y"], "Y": c["X"], "yaw": 0.5 * np.pi - c["yaw"]},
        ("X", "yaw", "r"),
        "world: ned",
        ("r", "ay", "delta", "vy"),
    ),
    "steering wheel's angle": Defect(_times("delta", 15.0), ("delta",), "steering-wheel angle"),
    "steer angle in degrees": Defect(_times("delta", DEG), ("delta",), "is in deg"),
    "steer angle right-positive": Defect(_times("delta", -1.0), ("delta",), "right-positive"),
    "steer angle 0.3 s late": Defect(_late("delta", 0.3), ("delta",), "late"),
    "steer angle 2 deg off": Defect(lambda c: {"delta": c["delta"] + 2.0 / DEG}, ("delta",), "straight"),
    "torque of one wheel": Defect(_times("T", 0.25), ("T",), "one wheel"),
    "torque without the brakes": Defect(lambda c: {"T": np.maximum(c["T"], 0.0)}, ("T",), "without the brakes"),
    "torque 1.4 times too large": Defect(_times("T", 1.4), ("T",), "would fit"),
    "torque in kN m": Defect(_times("T", 1e-3), ("T",), "kN m"),
    "torque positive when braking": Defect(_times("T", -1.0), ("T",), "when braking"),
    "wheels left and right exchanged": Defect(
        lambda c: {a: c[b] for a, b in (("fl", "fr"), ("fr", "fl"), ("rl", "rr"), ("rr", "rl"))},
        ("wheel_speed_fl", "wheel_speed_rl"),
        "exchanged",
    ),
    "wheel speeds in rad/s": Defect(
        lambda c: {n: c[n] / c["radius"] for n in _CORNERS}, ("wheel_speed_fl",), "is in rad/s"
    ),
}
_SHOWN_BY = {"fl": "wheel_speed_fl", "fr": "wheel_speed_fr", "rl": "wheel_speed_rl", "rr": "wheel_speed_rr"}


def columns_of(drive: Drive, vehicle: Vehicle) -> Columns:
    """Return the measured columns of a drive, with wheel speeds, and what changes need of the vehicle."""
    kinds = drive.metadata.kinds
    kept = {c: v for c, v in drive.columns.items() if c in _UNITS and not kinds.get(c, "").startswith("derived")}
    made: Columns = {"t": drive.columns["t"], **{c: np.array(v) for c, v in kept.items()}}
    half = 0.5 * _TRACK * vehicle.wheelbase
    for name, (front, right) in _CORNERS.items():
        across = drive.columns["vy"] + vehicle.cg_to_front_axle * drive.columns["r"] if front > 0 else 0.0
        along = drive.columns["vx"] + right * half * drive.columns["r"]
        turned = drive.columns["delta"] if front > 0 else 0.0
        made[name] = along * np.cos(turned) + across * np.sin(turned)
    made["lr"] = np.full(len(drive), vehicle.cg_to_rear_axle)
    made["radius"] = np.full(len(drive), vehicle.wheel_radius)
    return made


def said_of(columns: Columns, vehicle: Vehicle) -> dict[str, str]:
    """Return what ingest says of a log, by channel; ``time`` holds what it says of clocks and of the whole."""
    shown = {name: v for name, v in columns.items() if name not in ("lr", "radius", _IN_MS)}
    signals = {n: RawSignal(n, None, v, _UNITS.get(n, "m/s" if n in _CORNERS else None)) for n, v in shown.items()}
    entries = {_SHOWN_BY.get(n, n): {"source": n, "unit": signals[n].unit} for n in shown if n != "t"}
    named = {"time": {"source": "t", "unit": "ms" if _IN_MS in columns else "s"}, "channels": entries}
    missing = [c for c in ("T",) if c not in entries]
    settings = IngestSettings(derive=("torque-from-acceleration",) if missing else ())
    try:
        made = assemble_drive(
            TableRecording("log.csv", Path("log.csv"), signals), map_from_mapping(named, where="map"), vehicle, settings
        )
    except SplitError as error:
        # What the checks say with the right clock stands behind it, channel by channel.
        told, *others = re.split(r" (?=(?:" + "|".join([*_UNITS, *_SHOWN_BY.values()]) + r"): )", str(error))
        said = {"time": told}
        for text in others:
            channel, _, words = text.partition(": ")
            said[channel] = f"{said.get(channel, '')} {words}".strip()
        return said
    found: dict[str, str] = {}
    quality = made.quality
    for finding in quality.consistency.findings:
        found[finding.channel] = f"{found.get(finding.channel, '')} {finding.text}".strip()
    for other in quality.consistency.unjudged:
        found[f"not judged: {other.check}"] = other.reason
    for note in (*quality.assumed, *quality.warnings):
        found[f"note: {note[:60]}"] = str(note)
    return found


def _verdict(names: tuple[str, ...], said: dict[str, str], before: dict[str, str]) -> tuple[str, str]:
    """Return one of right, told, silent, with ``, false`` where others are blamed, and the words."""
    new = {c: text for c, text in said.items() if before.get(c) != text}
    fresh = {c: text for c, text in new.items() if not c.startswith(("note", "not judged"))}
    whole = " ".join(said.values())
    results = []
    for name in names:
        planted = PLANTED[name]
        own = " ".join(said.get(c, "") for c in planted.channels)
        spoken = whole if planted.channels == ("time",) else own
        if planted.words in spoken and spoken != " ".join(before.get(c, "") for c in planted.channels):
            results.append("right")
        else:
            results.append("told" if new else "silent")
    touched = {c for n in names for c in (*PLANTED[n].channels, *PLANTED[n].around)}
    touched |= {_SHOWN_BY.get(c, c) for n in names for c in _changed(n)}
    blamed = set(fresh) - touched - set(before) - ({"time"} if "time" in touched else set())
    worst = max(results, key=("right", "told", "silent").index)
    texts = [f"{c}: {text}" for c, text in fresh.items()] or [f"{c}" for c in new]
    return worst + (", false" if blamed and "time" not in touched else ""), " | ".join(texts)[:260]


def _changed(name: str) -> set[str]:
    probe: Columns = {c: np.linspace(1.0, 2.0, 5) for c in (*_UNITS, *_CORNERS, "t", "lr", "radius")}
    return set(PLANTED[name].change(probe)) - {_IN_MS}


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("drive")
    parser.add_argument("--vehicle", required=True)
    parser.add_argument("--every", type=int, default=7, help="take every n-th pair")
    options = parser.parse_args()
    drive, vehicle = read_drive(options.drive), read_vehicle(options.vehicle)
    first = max(0, (len(drive) - _ROWS) // 2)
    drive = drive.select(slice(first, first + _ROWS))
    drive = replace(drive, columns={**drive.columns, "t": drive.columns["t"] - drive.columns["t"][0]})
    columns = columns_of(drive, vehicle)
    before = said_of(columns, vehicle)
    print(f"{options.drive}: {len(drive)} rows; told without a mistake:")
    for channel, text in before.items():
        print(f"  {channel}: {text[:160]}")
    possible = [n for n in PLANTED if _changed(n) <= set(columns)]
    pairs = [p for p in combinations(possible, 2) if not _changed(p[0]) & _changed(p[1])][:: options.every]
    counts: dict[str, dict[str, int]] = {"alone": {}, "in pairs": {}}
    print("\n| mistake | verdict | what is said |\n|---|---|---|")
    for case in [*((n,) for n in possible), *pairs]:
        made = dict(columns)
        for name in case:
            made |= PLANTED[name].change(made)
        verdict, text = _verdict(case, said_of(made, vehicle), before)
        entry = counts["alone" if len(case) == 1 else "in pairs"]
        entry[verdict] = entry.get(verdict, 0) + 1
        if len(case) == 1 or verdict != "right":
            print(f"| {' + '.join(case)} | {verdict} | {text} |")
    for how, entry in counts.items():
        print(f"{how}: {sum(entry.values())} cases, " + ", ".join(f"{n} {v}" for v, n in sorted(entry.items())))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
