"""Put mistakes of unit, sign and axis into drives, alone and in pairs, and print what ingest says of them.

Example: ``python -m tests.studies.mistakes genesis.parquet --vehicle genesis``. What the drive is told without a
mistake is not counted. A mistake is *named* if its channel is told its words, and *seen* if the channel is told
anything new. Cases in which a channel without a mistake is told something new are counted too.
"""

import argparse
from dataclasses import replace
from itertools import combinations

import numpy as np

from split_cli.logs.checking.consistency import check_consistency
from split_cli.logs.drive import Drive, read_drive
from split_cli.vehicle.parameters import Vehicle, read_vehicle
from tests.logs.test_mistakes import MISTAKES

_ROWS = 40_000
_MORE = {
    "speeds in knots": ({"vx": lambda v: v / 0.514444, "vy": lambda v: v / 0.514444}, "vx", "is in kn"),
    "position in cm": ({"X": lambda v: 100.0 * v, "Y": lambda v: 100.0 * v}, "X", "cm"),
    "Y flipped": ({"Y": lambda v: -v}, "X", "mirrored"),
}
_EXCHANGED = {
    "X and Y exchanged": (("X", "Y"), "X", "mirrored"),
    "a_x and a_y exchanged": (("ax", "ay"), "ax", "along the other axis"),
    "v_x and v_y exchanged": (("vx", "vy"), "vx", "swapped"),
}
_ALL = (*MISTAKES, *_MORE, *_EXCHANGED)


def _of(name: str) -> tuple[tuple[str, ...], str, str]:
    """Return the columns that a mistake changes, the channel that should be told and the words."""
    if name in _EXCHANGED:
        return _EXCHANGED[name]
    changes, channel, words = {**MISTAKES, **_MORE}[name]
    return tuple(changes), channel, words


def _with(drive: Drive, names: tuple[str, ...]) -> Drive:
    columns = dict(drive.columns)
    for name in names:
        if name in _EXCHANGED:
            first, second = _EXCHANGED[name][0]
            columns[first], columns[second] = columns[second], columns[first]
        else:
            columns |= {c: change(columns[c]) for c, change in {**MISTAKES, **_MORE}[name][0].items()}
    return replace(drive, columns=columns)


def _said(drive: Drive, vehicle: Vehicle) -> dict[str, str]:
    found: dict[str, str] = {}
    for finding in check_consistency(drive, vehicle, drive.metadata.kinds).findings:
        found[finding.channel] = f"{found.get(finding.channel, '')} {finding.text}"
    return found


def _possible(drive: Drive) -> list[str]:
    kinds = drive.metadata.kinds

    def recorded(channel: str) -> bool:
        measured = channel in drive.columns and not kinds.get(channel, "").startswith("derived")
        return measured and float(np.nanstd(drive.columns[channel])) > 0.0

    return [name for name in _ALL if all(recorded(channel) for channel in _of(name)[0])]


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("drive")
    parser.add_argument("--vehicle", required=True)
    parser.add_argument("--every", type=int, default=1, help="take every n-th pair")
    options = parser.parse_args()
    whole, vehicle = read_drive(options.drive), read_vehicle(options.vehicle)
    first = max(0, (len(whole) - _ROWS) // 2)
    drive = whole.select(slice(first, first + _ROWS))
    before = _said(drive, vehicle)
    print(f"{options.drive}: {len(drive)} rows, told without a mistake: {', '.join(sorted(before)) or 'nothing'}")
    names = _possible(drive)
    pairs = [p for p in combinations(names, 2) if not set(_of(p[0])[0]) & set(_of(p[1])[0])][:: options.every]
    print("\n| mistake | what is said |\n|---|---|")
    counted = {"alone": [0, 0, 0, 0], "in pairs": [0, 0, 0, 0]}
    for case in [*((name,) for name in names), *pairs]:
        said = _said(_with(drive, case), vehicle)
        named = [_of(n)[2] in said.get(_of(n)[1], "").removeprefix(before.get(_of(n)[1], "-")) for n in case]
        seen = [any(said.get(c, "") != before.get(c, "") for c in (*_of(n)[0], _of(n)[1])) for n in case]
        blamed = {c for n in case for c in (*_of(n)[0], _of(n)[1])}
        other = {c for c in said if c not in before and c not in blamed}
        entry = counted["alone" if len(case) == 1 else "in pairs"]
        for place, value in enumerate((1, all(named), all(seen), bool(other))):
            entry[place] += value
        if len(case) == 1:
            text = said.get(_of(case[0])[1], "nothing").strip().split(". ")[0].split(" (")[0]
            print(f"| {case[0]} | {'**' if not named[0] else ''}{text[:110]}{'**' if not named[0] else ''} |")
        elif not all(named):
            missed = [n for n, is_named in zip(case, named, strict=True) if not is_named]
            print(f"| {' + '.join(case)} | not named: {', '.join(missed)}; told: {', '.join(sorted(said))} |")
    for how, (count, named_all, seen_all, others) in counted.items():
        print(f"{how}: {count} cases, all named {named_all}, all seen {seen_all}, another channel told {others}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
