"""Give every command that takes a trained set one that was forged, with digests that fit.

Example: ``python -m tests.studies.forged --only append``. The rules are those of `tests.studies.hostile`. Prints a
row a command, which forged sets it took, and each run that broke a rule. ``--random 40 --seed 1`` forges 40 sets
at random instead: values of the header exchanged or scaled, or some numbers of the points.
"""

import argparse
import json
import random
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from split_cli.errors import SplitError
from split_cli.learning.kernel import OUTPUTS
from split_cli.learning.label_sums import SUMS
from split_cli.learning.training_set import TrainingSet, read_set, write_set
from tests.factories import write_forged_set
from tests.studies.fuzz import mutate_json, places
from tests.studies.hostile import load_commands, prepared_folders, try_run
from tests.studies.kill import run


def at(*keys: str | int, value: object) -> Callable[[dict], None]:
    """Return what gives the header another value at a place; a function is given the present one."""

    def change(described: dict) -> None:
        inner = described
        for key in keys[:-1]:
            inner = inner[key]
        inner[keys[-1]] = value(inner[keys[-1]]) if callable(value) else value

    return change


def points(name: str, value: Callable[[np.ndarray], np.ndarray]) -> Callable[[TrainingSet], TrainingSet]:
    """Return what changes one array of the points."""
    return lambda s: replace(s, **{name: value(getattr(s, name).copy())})


def _every(number: float, *keys: str) -> Callable[[dict], None]:
    return at(*keys, value=lambda old: [number] * len(old or OUTPUTS))


HEADERS = {
    **{f"edges {e:g}": _every(e, "grid", "edges") for e in (1e-9, 1e-3, 1e290)},
    **{
        f"{name} {e:g}": _every(e, "kernel", name)
        for name in ("length_scales", "signal_variance", "noise_variance")
        for e in (-1.0, 0.0, 1e-299, 1e-160, 10.0, 1e20, 1e299)
    },
    **{f"{name} {e:g}": _every(e, "trust", name) for name in ("share", "doubt") for e in (-1.0, 5.0, 1e299)},
    **{f"forgetting {e:g}": at("forgetting", value=e) for e in (-1.0, 1e-299, 1e299)},
    **{f"region {e:g}": at("region", value=lambda r, e=e: dict.fromkeys(r, e)) for e in (1e-9, 999.0, 1e299)},
    **{f"horizon {e:g}": at("horizon", value=e) for e in (-1.0, 0.0, 1e-299, 9.9, 1e9)},
    **{f"capacity {e}": at("capacity", value=e) for e in (0, 1, 1000, 10**9)},
    **{f"threshold {e:g}": at("threshold", value=e) for e in (-1.0, 1.0, 2.0)},
    "start time 1e299": at("sources", 0, "start_time", value=1e299),
    "duration 1e299": at("sources", 0, "duration", value=1e299),
    "another vehicle": at("vehicle", "mass", value=2500.0),
}
POINTS = {
    **{f"z {e:g}": points("z", lambda v, e=e: np.full_like(v, e)) for e in (1e300, -1e150, 0.0, np.nan)},
    "z moved": points("z", lambda v: v + 50.0),
    "z within its cells": points("z", lambda v: v + 1e-6),
    **{f"y {e:g}": points("y", lambda v, e=e: np.full_like(v, e)) for e in (np.nan, 1e300, -1e15, 1e6)},
    **{f"gamma {e:g}": points("gamma", lambda v, e=e: np.full_like(v, e)) for e in (-1e300, 1e300, 0.5)},
    **{f"t {e:g}": points("t", lambda v, e=e: np.full_like(v, e)) for e in (1e300, -1e14)},
    "t both ways": points("t", lambda v: np.where(np.arange(len(v)) % 2, 1e299, -1e299)),
    "cells moved": points("cell_numbers", lambda v: v + 2**62),
    "cells turned round": points("cell_numbers", lambda v: v[::-1].copy()),
    "cells alike": points("cell_numbers", lambda v: np.full_like(v, v[0])),
    "rows below zero": points("row", lambda v: np.full_like(v, -5)),
    "rows of no drive": points("row", lambda v: np.full_like(v, 2**63 - 1)),
    "drives of none": points("source", lambda v: v + 5),
    **{
        f"{name} {e:g}": points(name, lambda v, e=e: np.full_like(v, e))
        for name in SUMS
        for e in (np.nan, np.inf, 1e300, -1e15, 0.0)
    },
    **{f"{name} times {e:g}": points(name, lambda v, e=e: v * e) for name in SUMS for e in (-1.0, 0.5, 2.0, 1e12)},
    "information not symmetric": points("information", lambda v: v + 1e-6 * np.arange(len(v))),
    "information cut": points("information", lambda v: v[:-1]),
    "absorbed cut": points("absorbed", lambda v: v[:-1]),
    "absorbed moved": points("absorbed", lambda v: v + 50.0),
    **{
        f"labels beside points times {e:g}": lambda s, e=e: replace(s, absorbed=s.y + e * (s.absorbed - s.y))
        for e in (2.0, 1e6)
    },
}
_TRACK = ("--vehicle", "road_car.yaml", "--start-set", "turn.split")
COMMANDS = {
    "append": ("train", "d1.parquet", "--vehicle", "car.yaml", "-o", "a.split", "--append"),
    "export c": ("export", "a.split", "--target", "c", "-o", "out", "--queries", "100"),
    "export json": ("export", "a.split", "--target", "json", "--predictor", "bcm", "-o", "out", "--queries", "100"),
    "export ggv": ("export", "a.split", "--target", "ggv", "-o", "out"),
    "evaluate": ("evaluate", "d1.parquet", "--vehicle", "car.yaml", "--set", "a.split"),
    "compare": ("compare", "car.yaml", "a.split", "--on", "d1.parquet"),
    "race": ("race", *_TRACK, "--laps", "1", "--max-speed", "11"),
    "maneuver": ("maneuver", "brake-avoid", *_TRACK),
    "verify": ("verify", "a.split"),
    "info": ("info", "a.split"),
}


def random_header(rng: random.Random) -> Callable[[dict], None]:
    """Return what exchanges values of a header, or scales one to three of its numbers."""

    def change(described: dict) -> None:
        if rng.random() < 0.3:
            forged = json.loads(mutate_json(json.dumps(described).encode(), rng), parse_constant=lambda _: 0.0)
            described.clear()
            described.update(forged)
            return
        for _ in range(rng.choice((1, 1, 2, 3))):
            numbers = [place for place in places(described) if isinstance(place[0][place[1]], float)]
            inner, key = rng.choice(numbers)
            inner[key] *= rng.choice((-1.0, 1.0, 1.0)) * 10.0 ** rng.gauss(0.0, 2.0)

    return change


def random_points(rng: random.Random) -> Callable[[TrainingSet], TrainingSet]:
    """Return what scales some numbers of one array of the points."""
    name, share, power = (
        rng.choice(("z", "y", "gamma", "t", "row")),
        rng.choice((0.01, 0.2, 1.0)),
        rng.gauss(0.0, 2.0),
    )
    draws = np.random.default_rng(rng.randrange(2**32))
    return points(name, lambda v: np.where(draws.random(v.shape) < share, v * 10.0**power, v).astype(v.dtype))


def _is_refused(path: Path) -> bool:
    try:
        read_set(path)
    except SplitError:
        return True
    return False


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="commands whose name holds one of these, with commas between")
    parser.add_argument("--readable", action="store_true", help="only sets that reading alone does not refuse")
    parser.add_argument("--patience", type=float, default=40.0, help="processor time after which a run is stopped [s]")
    parser.add_argument("--random", type=int, default=0, help="instead, so many sets forged at random")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    load_commands()
    broken, rng = 0, random.Random(given.seed)
    headers, forged_points = HEADERS, POINTS
    if given.random:
        headers = {f"header {number}": random_header(rng) for number in range(given.random // 2)}
        forged_points = {f"points {number}": random_points(rng) for number in range(given.random // 2)}
    with prepared_folders() as (source, work):
        made = ("maneuver", "brake-avoid", "--vehicle", "road_car.yaml", "--set", "turn.split")
        if run(source, made) != 0:
            raise RuntimeError("no set of a manoeuvre could be made")
        for name, arguments in COMMANDS.items():
            if not any(word in name for word in given.only.split(",")):
                continue
            path = source / next(word for word in arguments if word.endswith(".split"))
            whole, counts, took = read_set(path), Counter(), []
            for kind in (*headers, *forged_points):
                if kind in headers:
                    write_forged_set(whole, path, headers[kind])
                else:
                    write_set(forged_points[kind](whole), path)
                if given.readable and _is_refused(path):
                    counts["refused when read"] += 1
                    continue
                how, fault = try_run(source, work, arguments[0], arguments[1:], given.patience)
                counts[how] += 1
                took += [kind] if how not in ("refused", "usage") else []
                if fault:
                    broken += 1
                    print(f"{name} {kind}: {fault}", flush=True)
            write_set(whole, path)
            print(f"{name:12} {dict(counts)}, not refused: {', '.join(took) or 'none'}", flush=True)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
