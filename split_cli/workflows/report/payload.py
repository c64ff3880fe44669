"""The numbers that a report embeds for its charts, as JSON that is small and safe inside HTML."""

import hashlib
import json
import math
import re
from typing import Any

import numpy as np

from split_cli.diagnosis.statement.document import diagnosis_to_text
from split_cli.diagnosis.statement.improvement import HorizonErrors, Improvement
from split_cli.diagnosis.statement.result import Diagnosis, GapSeries, Location
from split_cli.workflows.report.words import CHANNELS, FORCE_IDS, FORCES, readable

_MOST_ROWS = 12_000
_LEVELS = 5_000
_STAGES = ("before", "physics", "split_only", "after", "persistence")


def embedded_json(content: object) -> str:
    """Return JSON that may stand inside a ``<script>`` element whatever strings it holds."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def digest_entry(content: str) -> dict[str, Any]:
    """Return the entry of a page's numbers that names the file they are of: the SHA-256 of its content."""
    return {"shows": hashlib.sha256(content.encode("utf-8")).hexdigest()}


def shown_digest(page: str) -> str | None:
    """Return the digest that `digest_entry` wrote into a page; None where it has none."""
    found = re.search(r'"shows":"([0-9a-f]{64})"', page)
    return found[1] if found else None


def chart_numbers(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return what the page's script reads."""
    rows = sum(len(gap.t) for gap in diagnosis.gaps)
    every = max(1, math.ceil(rows / _MOST_ROWS))
    return {
        **digest_entry(diagnosis_to_text(diagnosis)),
        "verdict": diagnosis.verdict,
        "forces": [FORCES[name] for name in FORCE_IDS],
        "named": bool(diagnosis.findings),
        "location": _location(diagnosis.location),
        "drives": [_drive(gap, every) for gap in diagnosis.gaps if len(gap.t)],
        "help": _improvement(diagnosis.improvement),
    }


def _location(location: Location | None) -> dict[str, Any] | None:
    if location is None:
        return None
    place = location.place
    return {
        "channel": max(range(3), key=lambda k: location.forces[FORCE_IDS[k]]),
        "time": location.time,
        "place": None if place is None else [place.s_start, place.s_end],
    }


def _drive(gap: GapSeries, every: int) -> dict[str, Any]:
    """Pack one recording, `every` rows to one: forces averaged, the rest taken from the middle one."""
    step = float(np.median(np.diff(gap.t))) if len(gap.t) > 1 else 1.0
    run = np.concatenate([[0], np.cumsum(np.diff(gap.t) > 2.5 * step)])
    order = np.arange(len(gap.t)) - np.searchsorted(run, run)
    begin = np.flatnonzero(order % every == 0)
    count = np.diff(np.append(begin, len(gap.t)))
    middle = begin + count // 2

    def averaged(forces: np.ndarray) -> list[dict[str, Any]]:
        return [packed(np.add.reduceat(column, begin) / count) for column in forces.T]

    names = ("alpha_f", "alpha_r", "torque", "speed")
    points = {name: packed(column[middle]) for name, column in zip(names, gap.operating_point.T, strict=True)}
    return {
        "name": readable(gap.drive),
        "step": step * every,
        "run": np.flatnonzero(np.diff(run[middle], prepend=-1)).tolist(),
        "t": packed(gap.t[middle]),
        "s": packed(gap.s[middle]),
        "x": packed(gap.x[middle]),
        "y": packed(gap.y[middle]),
        **points,
        "compared": [int(flag) for flag in gap.compared[middle]],
        "before": averaged(gap.forces),
        "after": averaged(gap.remainder),
    }


def packed(values: np.ndarray) -> dict[str, Any]:
    """Return whole numbers and the step they count, a power of ten; null where there is no number."""
    values = np.asarray(values, dtype=float)
    finite = np.isfinite(values)
    spread = float(np.ptp(values[finite])) if finite.any() else 0.0
    exponent = math.floor(math.log10(spread / _LEVELS)) if spread > 0.0 else -3
    origin = float(values[finite].min()) if finite.any() else 0.0
    counted = np.round((np.where(finite, values, origin) - origin) * 10.0**-exponent).astype(np.int64)
    whole = [int(v) if good else None for v, good in zip(counted, finite, strict=True)]
    return {"origin": origin, "exponent": exponent, "values": whole}


def _improvement(improvement: Improvement | None) -> dict[str, Any] | None:
    if improvement is None:
        return None
    floor = improvement.noise_floor
    return {
        "channels": [{"symbol": symbol, "name": name, "unit": unit} for symbol, name, unit in CHANNELS],
        "errors": _stages(improvement),
        "floor": None if floor is None else [float(v) for v in floor],
        "rollouts": [
            {"horizon": one.horizon, "errors": _stages(one), "floor": [float(v) for v in one.noise_floor]}
            for one in improvement.rollouts
        ],
    }


def _stages(errors: Improvement | HorizonErrors) -> dict[str, Any]:
    out = {}
    for stage in _STAGES:
        interval = errors.confidence.get(stage)
        out[stage] = {
            "rms": [float(v) for v in getattr(errors, stage)],
            "interval": [[float(low), float(high)] for low, high in interval] if interval else None,
        }
    return out
