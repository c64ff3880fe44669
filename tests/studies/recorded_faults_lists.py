"""Lists of known faults in real recordings, each fixed before its first row was run; see `recorded_faults.py`."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.proof.altered_car import ALTERATIONS
from split_cli.proof.injection import FAULTS
from split_cli.vehicle.effects import CATALOGUE


@dataclass(frozen=True)
class FaultRow:
    """One fault in one pair.

    Attributes
    ----------
    pair : str
        Recording and split, joined by a comma, or ``against`` and another recording in place of the split.
    fault : str
        Of `proof.injection.FAULTS`, or ``none``. Several are joined by a plus sign, and are put in in that order:
        what changes the car, then commands, then sensors. ``name=size`` is one of that size.
    multiple : float or None
        Size over the one that the pair promises to name, with those faults of the row whose size is given.
    value : float or None
        Size, in the unit of the fault, instead.
    """

    pair: str
    fault: str
    multiple: float | None = None
    value: float | None = None


def _rows(pair: str, *faults: str | tuple[str, float]) -> list[FaultRow]:
    """Return faults of 1.5 times the promise, or of another multiple."""
    pairs = [(one, 1.5) if isinstance(one, str) else one for one in faults]
    return [FaultRow(pair, "none"), *(FaultRow(pair, name, multiple) for name, multiple in pairs)]


def _twice(pair: str, *faults: str) -> list[FaultRow]:
    """Return faults of 1.5 and of 3 times the promise."""
    return _rows(pair, *((name, multiple) for name in faults for multiple in (1.5, 3.0)))


LISTS: dict[str, list[FaultRow]] = {
    "first": [
        *_rows("rubber, blocks", "yaw rate scaled", "torque scaled", "heavier"),
        *_rows("rubber, blocks", "velocity drifts", "speed scaled", "CG moved")[1:],
        *_rows("tum, halves", "yaw rate late", "torque scaled", "steering late"),
        *_rows("free, blocks"),
        FaultRow("free, blocks", "CG moved", value=0.050),
        *_rows("free, blocks", "clocks shifted", "torque scaled", "steering late", "yaw rate scaled")[1:],
        *_rows("kth, halves", "clocks shifted", "lateral velocity late", "steering late"),
        FaultRow("kth, halves", "yaw rate late", value=0.21),
        *_rows("slippery, blocks", "steering late", "clocks shifted", "torque late"),
        *_rows("av21, halves", "yaw rate late", "velocity drifts", "yaw rate biased", "velocity moved"),
        *_rows("tum, blocks", "steering late", ("steering late", 3.0), "torque late", ("torque late", 3.0)),
        *_rows("tum, blocks", "clocks shifted")[1:],
        FaultRow("tum, blocks", "yaw rate late", value=0.074),
        FaultRow("tum, blocks", "softer tyres", value=0.65),
        *_rows("genesis, blocks"),
        FaultRow("genesis, blocks", "lateral velocity late", value=0.90),
        *_rows("genesis, blocks", "steering late", "steering scaled", "speed scaled", "yaw rate late")[1:],
        *_rows("genesis, blocks", "yaw rate biased")[1:],
        *_rows("autorally 5, halves", "clocks shifted", "torque scaled", "lateral velocity late", "speed scaled"),
    ],
    "second": [
        *_rows("tape, swapped blocks", "yaw rate scaled", "velocity biased", "steering scaled"),
        *_rows("slippery, blocks 6", "speed scaled", "velocity moved", "yaw rate biased"),
        *_rows("kth, swapped halves", "steering offset", "yaw rate late", "velocity moved"),
        *_rows("autorally 6, halves", "yaw rate late", "speed scaled", "torque late"),
        *_rows("tum second file, blocks", "steering scaled", "clocks shifted", "lateral acceleration biased"),
        *_rows("genesis, swapped halves", "steering offset", "velocity rotated", "speed scaled"),
    ],
    "third": [
        *_twice("race, halves", "steering late", "yaw rate biased"),
        *_twice("steering, blocks", "steering scaled", "velocity moved"),
        *_twice("kth step, blocks 4", "yaw rate scaled", "steering offset"),
        *_twice("tum second file, halves", "torque scaled", "velocity rotated"),
        *_twice("tum, swapped blocks", "steering offset", "lateral velocity late"),
        *_twice("rubber, blocks 15", "steering logged late", "velocity moved"),
        *_twice("tape, blocks 6", "torque late", "yaw rate biased"),
        *_twice("free, halves", "clocks shifted", "velocity biased"),
        *_twice("slippery, swapped blocks", "steering offset", "torque scaled"),
        *_twice("autorally 6, swapped halves", "steering late", "velocity rotated"),
        *_twice("av21, blocks 20", "speed scaled", "steering scaled"),
        *_twice("genesis, halves", "yaw rate scaled", "lateral velocity late"),
    ],
    "fourth": [
        *_rows("rubber, blocks 8", ("front tyres softer", 2.0), ("more yaw inertia", 2.0)),
        *_rows("tape, blocks 8", ("velocity moved + torque scaled", 3.0)),
        FaultRow("tape, blocks 8", "grip falls", value=0.75),
        *_rows("slippery, swapped blocks 6", ("speed scaled + steering scaled", 2.0)),
        FaultRow("slippery, swapped blocks 6", "rows lost", value=0.1),
        *_rows("free, swapped halves", ("torque late", 5.0), ("steering late + torque scaled", 3.0)),
        FaultRow("free, swapped halves", "clocks drift", value=0.3),
        FaultRow("free, swapped halves", "steering scaled to the left", value=0.7),
        *_rows("kth, blocks 4", ("velocity moved + yaw rate late", 2.0)),
        FaultRow("kth, blocks 4", "yaw rate reversed", value=-1.0),
        *_rows("autorally 5, blocks 6", ("torque fades", 4.0), ("yaw rate scaled + velocity rotated", 2.0)),
        *_rows("av21, thirds", ("steering offset steps", 4.0), ("velocity biased", 5.0)),
        *_rows("genesis, thirds", ("yaw rate drifts", 4.0), ("speed scaled + yaw rate late", 3.0)),
        *_rows("tum, thirds", ("more yaw inertia", 3.0), ("steering late + velocity rotated", 2.0)),
        *_rows("tum second file, swapped halves", ("front tyres softer", 3.0), ("yaw rate late now and then", 4.0)),
    ],
    "fifth": [
        *_rows("rubber, swapped halves", ("steering scaled", 2.0), ("velocity biased", 2.0)),
        *_rows("tape, halves", ("steering late", 2.0), ("yaw rate scaled", 2.0)),
        *_rows("slippery, halves", ("torque scaled", 2.0), ("velocity moved", 2.0)),
        *_rows("free, blocks 12", ("yaw rate late", 2.0), ("speed scaled", 2.0)),
        *_rows("race, swapped halves", ("yaw rate scaled", 2.0), ("steering scaled", 2.0)),
        *_rows("steering, swapped blocks", ("clocks shifted", 2.0), ("velocity rotated", 2.0)),
        *_rows("tum, swapped halves", ("steering scaled", 2.0), ("yaw rate biased", 2.0)),
        *_rows("tum second file, swapped blocks", ("yaw rate late", 2.0), ("velocity moved", 2.0)),
        *_rows("genesis, swapped blocks 15", ("steering late", 2.0), ("velocity rotated", 2.0)),
        *_rows("av21, swapped halves", ("yaw rate scaled", 2.0), ("lateral velocity late", 2.0)),
        *_rows("autorally 5, swapped halves", ("steering offset", 2.0), ("yaw rate scaled", 2.0)),
        *_rows("autorally 6, blocks 12", ("velocity moved", 2.0), ("torque scaled", 2.0)),
        *_rows("kth step, swapped halves", ("speed scaled", 2.0), ("steering late", 2.0)),
    ],
    "sixth": [
        *_rows("slippery, blocks 15", ("steering late", 1.2), ("yaw rate late", 1.5)),
        *_rows("free, swapped blocks 12", ("velocity moved", 1.5), ("torque scaled + velocity rotated", 2.5)),
        *_rows("rubber, swapped blocks 15", ("torque scaled", 1.5), ("yaw rate biased", 1.2)),
        *_rows("tape, blocks 12", ("velocity rotated", 1.5), ("torque late", 1.5)),
        *_rows("genesis, blocks 30", ("velocity biased", 1.5), ("yaw rate late", 1.5)),
        *_rows("av21, swapped blocks 15", ("yaw rate late", 1.5), ("velocity rotated", 1.2)),
        *_rows("autorally 5, blocks 12", ("steering late", 1.5), ("speed scaled", 1.5)),
        *_rows("tum, blocks 15", ("yaw rate scaled", 1.2), ("velocity moved + steering late", 2.5)),
        *_rows("tum second file, blocks 20", ("steering offset", 1.5), ("torque late", 1.5)),
        *_rows("tum, against tum second file", ("steering scaled", 1.5), ("velocity rotated", 1.5)),
        *_rows("autorally 6, against autorally 5", ("yaw rate scaled", 1.5)),
        *_rows("kth step, against kth", ("yaw rate late", 1.5), ("steering offset", 1.5)),
        *_rows("free, against steering", ("steering offset", 1.5)),
    ],
    "beside": [
        FaultRow("slippery, blocks", "steering scaled + velocity moved=0.04", 1.5),
        FaultRow("slippery, blocks", "torque late + velocity moved=0.04", 1.5),
        FaultRow("free, blocks", "steering late=0.15 + torque scaled", 1.5),
        FaultRow("free, blocks", "steering late=0.15 + velocity rotated", 1.5),
        FaultRow("rubber, blocks", "torque scaled=0.6 + steering scaled", 1.5),
        FaultRow("kth, halves", "steering late=0.16 + velocity rotated", 1.5),
        FaultRow("tum, blocks", "steering scaled=0.75 + yaw rate late", 1.5),
    ],
    "several": [
        *_rows("rubber, blocks", ("steering late + yaw rate scaled", 2.0), ("torque scaled + steering scaled", 2.0)),
        *_rows("rubber, blocks", ("heavier + steering late + speed scaled", 3.0))[1:],
        *_rows("tape, blocks", ("steering scaled + yaw rate late", 2.0), ("steering late + velocity rotated", 3.0)),
        *_rows("slippery, blocks", ("torque late + yaw rate biased", 2.0), ("steering late + velocity moved", 3.0)),
        *_rows("free, blocks", ("torque scaled + steering late", 2.0), ("steering late + yaw rate scaled", 3.0)),
        *_rows("free, blocks", ("torque scaled + steering scaled + velocity rotated", 3.0))[1:],
        *_rows("kth, halves", ("steering late + velocity rotated", 2.0), ("yaw rate scaled + steering scaled", 3.0)),
        *_rows("tum, blocks", ("torque scaled + steering late", 2.0), ("steering scaled + yaw rate late", 3.0)),
        *_rows("tum, blocks", ("torque scaled + steering offset + velocity moved", 3.0))[1:],
        *_rows("av21, halves", ("velocity moved + yaw rate late", 2.0), ("velocity rotated + yaw rate scaled", 3.0)),
        *_rows("genesis, blocks", ("steering scaled + speed scaled", 2.0), ("steering late + yaw rate biased", 3.0)),
        *_rows("autorally 5, halves", ("torque scaled + yaw rate late", 2.0), ("steering late + speed scaled", 3.0)),
    ],
    "several again": [
        FaultRow("rubber, swapped blocks", "none"),
        FaultRow("rubber, swapped blocks", "steering late=0.08 + speed scaled=0.95"),
        FaultRow("rubber, swapped blocks", "torque scaled=0.6 + steering scaled=0.85 + yaw rate biased=0.03"),
        FaultRow("tape, swapped blocks", "none"),
        FaultRow("tape, swapped blocks", "steering scaled=0.85 + yaw rate scaled=0.93"),
        FaultRow("tape, swapped blocks", "steering late=0.1 + velocity biased=0.06"),
        FaultRow("free, swapped blocks", "none"),
        FaultRow("free, swapped blocks", "torque scaled=0.6 + steering late=0.1 + velocity rotated=0.05"),
        FaultRow("free, swapped blocks", "heavier=1.4 + yaw rate late=0.08"),
        FaultRow("slippery, blocks 6", "none"),
        FaultRow("slippery, blocks 6", "steering scaled=0.85 + yaw rate scaled=0.95 + velocity moved=0.04"),
        FaultRow("kth, swapped halves", "none"),
        FaultRow("kth, swapped halves", "steering scaled=0.85 + yaw rate late=0.1"),
        FaultRow("kth, swapped halves", "steering offset=0.02 + speed scaled=0.95"),
        FaultRow("tum second file, blocks", "none"),
        FaultRow("tum second file, blocks", "steering scaled=0.8 + torque scaled=0.6"),
        FaultRow("tum second file, blocks", "steering late=0.1 + velocity rotated=0.03"),
        FaultRow("av21, halves", "none"),
        FaultRow("av21, halves", "velocity rotated=0.03 + yaw rate late=0.1"),
        FaultRow("av21, halves", "steering scaled=0.8 + yaw rate biased=0.02"),
        FaultRow("genesis, swapped halves", "none"),
        FaultRow("genesis, swapped halves", "steering scaled=0.8 + yaw rate scaled=0.95"),
        FaultRow("genesis, swapped halves", "steering offset=0.03 + velocity rotated=0.03 + speed scaled=0.95"),
        FaultRow("autorally 6, halves", "none"),
        FaultRow("autorally 6, halves", "torque scaled=0.6 + yaw rate late=0.1"),
        FaultRow("autorally 6, halves", "steering late=0.1 + speed scaled=0.93"),
    ],
}
"""By name. ``first`` are the 42 faults of docs/records/recorded_faults.md at today's sizes.
``second`` has parts and faults that no search had seen when the list was fixed, on 25 November 2026;
``third`` has recordings, parts and faults of no list before, fixed on 26 November 2026, and ``beside`` faults of
1.5 times what is promised beside another fault, fixed the same day.
``fourth`` has parts, pairs of faults and faults that change in the course of a drive (`changing_faults.py`),
fixed on 26 November 2026 before any row of it was run.
``fifth`` has parts and sizes of no list before, fixed the same day before any row of it was run.
``sixth`` has other blocks, and other drives of the same car as simulations, fixed on 27 November 2026 before any
row of it was run.
``several`` has two or three faults at once, fixed on 26 November 2026 before any such pair had been diagnosed,
and ``several again`` other parts with round sizes, fixed the same day after ``several`` had been run once."""


def drawn_list(seed: int, pairs: int, recordings: Sequence[str]) -> list[FaultRow]:
    """Return pairs that nobody chose, of each recording in turn: clean, with one fault, and with two.

    Equal seeds give equal lists. Parts are halves, thirds or blocks of 5 to 30 s, in either order. One fault has 1.5 to
    3 times the size that the pair promises to name, of two each has 2 to 3 times that size.
    """
    rng = np.random.default_rng(seed)
    rows, names = [], sorted(FAULTS)
    turns = rng.permutation(len(recordings))
    for k in range(pairs):
        part = ("halves", "thirds", f"blocks {rng.integers(5, 31)}")[rng.choice(3, p=(0.2, 0.1, 0.7))]
        order = "swapped " if rng.random() < 0.5 else ""
        pair = f"{recordings[turns[k % len(turns)]]}, {order}{part}"
        one, *both = (names[j] for j in rng.choice(len(names), 3, replace=False))
        single, double = (round(float(rng.uniform(*range_)), 2) for range_ in ((1.5, 3.0), (2.0, 3.0)))
        rows += _rows(pair, (one, single), (" + ".join(sorted(both, key=_stage)), double))
    return rows


def _stage(fault: str) -> int:
    """Return when a fault is put in among others: the car's first, then those of commands, then of sensors."""
    term = FAULTS[fault].term
    return 0 if term in ALTERATIONS else 1 if CATALOGUE[term].exported else 2
