"""npz and json targets: points, labels, cells and kernel as documented arrays.

Both hold the same fields, described by ``schema/split-export.schema.json``; json as nested lists, npz as arrays
with the rest as JSON text in the array ``metadata``.
"""

import json
from collections.abc import Container
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.errors import ExportError
from split_cli.export.check import ExportAnswer
from split_cli.export.projection import PROJECTION_ARRAYS, ProjectionData, answer_of
from split_cli.export.provenance import Provenance
from split_cli.export.tables import Constants, TableData
from split_cli.files import parse_json
from split_cli.learning.kernel import Kernel
from split_cli.learning.label_sums import SUMS
from split_cli.learning.training_set import TrainingSet
from split_cli.learning.trust import kept_share
from split_cli.prediction.projected import learning_order, process_of_labels, sums_over_labels

DOCUMENT_FORMAT = "split-export/2"
ARRAYS = (
    "cell_numbers",
    "offsets",
    "z",
    "y",
    "gamma",
    "length_scales",
    "signal_variance",
    "noise_variance",
    "trust",
    "doubt",
)
#: What a table adds.
TABLE_ARRAYS = ("origin", "spacing", "least", "unit", "coefficients")
#: Stands before the names of `PROJECTION_ARRAYS`, which a projected process adds.
_PREFIX = "projected_"
#: In which order a projected process learned the points; exports of before have none.
_ORDER = f"{_PREFIX}order"
#: What all labels of a set told of its points; absent where the set absorbed none.
_SUMS = tuple(_PREFIX + name for name in (*SUMS, "open_share"))
_INTEGERS = {"cell_numbers": np.int64, "offsets": np.int64, _ORDER: np.int64, "coefficients": np.int16}


_AT_ONCE = 1024  # queries


@dataclass(frozen=True)
class Document:
    """A trained set as plain numbers."""

    # `ARRAYS`: cells and points as in `TrainingSet`, the kernel's hyperparameters, trust and doubt an output.
    arrays: dict[str, np.ndarray]
    metadata: dict[str, Any]  # format, provenance, conventions, grid, region


def schema_text() -> str:
    """Return the JSON schema of the json target."""
    return (files("split_cli.export") / "schema" / "split-export.schema.json").read_text(encoding="utf-8")


def document_of(training_set: TrainingSet, provenance: Provenance, constants: Constants | None = None) -> Document:
    """Return everything a prediction needs, and what it means.

    A committee follows from points and kernel; a table and the projected process need their `constants` as well.
    """
    kernel = training_set.kernel
    sources = {
        "cell_numbers": np.asarray(training_set.cell_numbers, dtype=np.int64),
        "offsets": np.asarray(training_set.offsets, dtype=np.int64),
        "z": training_set.z,
        "y": training_set.y,
        "gamma": training_set.gamma,
        "length_scales": kernel.length_scales,
        "signal_variance": kernel.signal_variance,
        "noise_variance": kernel.noise_variance,
        "trust": training_set.trust.array,
        "doubt": training_set.trust.doubts(kernel.signal_variance),
    }
    grid, region = training_set.grid, training_set.region
    metadata = {
        "format": DOCUMENT_FORMAT,
        "split_version": provenance.version,
        "predictor": provenance.predictor,
        "set": {"name": provenance.set_name, "sha256": provenance.set_sha256},
        "vehicle": provenance.vehicle,
        "vehicle_digest": provenance.vehicle_digest,
        "conventions": provenance.conventions,
        "features": list(provenance.features),
        "outputs": ["vx", "vy", "r"],
        "horizon": provenance.horizon,
        "plain_labels": bool(training_set.plain),
        "kept": kept_share(sources["trust"], sources["doubt"], sources["signal_variance"]).tolist(),
        "grid": {
            "edges": list(grid.edges),
            "lower": [_finite_or_none(value) for value in grid.lower],
            "upper": [_finite_or_none(value) for value in grid.upper],
        },
        "region": {
            name: float(getattr(region, name))
            for name in ("p_long", "p_ellipse", "alpha_max", "dalpha_max", "minimum_speed")
        },
    }
    if provenance.memory is not None:
        metadata["memory"] = provenance.memory
    names: tuple[str, ...] = ARRAYS
    if isinstance(constants, TableData):
        sources |= {name: getattr(constants, name) for name in TABLE_ARRAYS}
        names += TABLE_ARRAYS
        metadata["table"] = constants.error
    if isinstance(constants, ProjectionData):
        sources |= {_PREFIX + name: getattr(constants, name) for name in PROJECTION_ARRAYS}
        sources[_ORDER] = learning_order(training_set).astype(np.int64)
        names += (*(_PREFIX + name for name in PROJECTION_ARRAYS), _ORDER)
        if training_set.information is not None:
            sources |= dict(zip(_SUMS, sums_over_labels(training_set), strict=True))
            names += _SUMS
    return Document({name: np.ascontiguousarray(sources[name]) for name in names}, metadata)


def _finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def write_npz(document: Document, path: Path) -> None:
    """Write a document as npz, without pickled objects; equal documents give equal bytes."""
    text = json.dumps(document.metadata, sort_keys=True, allow_nan=False)
    with path.open("wb") as stream:
        np.savez(stream, allow_pickle=False, metadata=np.array(text), **document.arrays)


def write_json(document: Document, path: Path) -> None:
    """Write a document as json; numbers read back to the same bits."""
    content = {**document.metadata, **{name: values.tolist() for name, values in document.arrays.items()}}
    path.write_text(json.dumps(content, sort_keys=True, allow_nan=False) + "\n", encoding="utf-8")


def read_npz(path: Path) -> Document:
    """Read what `write_npz` wrote.

    Raises
    ------
    ExportError
        If the file is damaged or lacks a field.
    """
    try:
        with np.load(path, allow_pickle=False) as content:
            metadata = parse_json(str(content["metadata"]))
            arrays = {name: content[name] for name in _names(metadata, content.files)}
    except (OSError, ValueError, KeyError, EOFError) as error:
        advice = "Export the set again."
        raise ExportError(f"is not a whole npz export ({error})", where=str(path), advice=advice) from error
    except Exception as error:
        # zipfile and zlib have errors of their own, of no common base.
        what = f"is damaged ({type(error).__name__}: {error})"
        raise ExportError(what, where=str(path), advice="Export the set again.") from error
    return _checked(Document(arrays, metadata), path)


def read_json(path: Path) -> Document:
    """Read what `write_json` wrote; raises as `read_npz` does."""
    try:
        content = parse_json(path.read_text(encoding="utf-8"))
        arrays = {
            name: np.array(content.pop(name), dtype=_INTEGERS.get(name, np.float64))
            for name in _names(content, content)
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        advice = "Export the set again."
        raise ExportError(f"is not a whole json export ({error})", where=str(path), advice=advice) from error
    return _checked(Document(arrays, content), path)


def _names(metadata: dict[str, Any], present: Container[str]) -> tuple[str, ...]:
    if "table" in metadata:
        return (*ARRAYS, *TABLE_ARRAYS)
    if metadata["predictor"] != "projected":
        return ARRAYS
    later = (name for name in (_ORDER, *_SUMS) if name in present)
    return (*ARRAYS, *(_PREFIX + name for name in PROJECTION_ARRAYS), *later)


def _checked(document: Document, path: Path) -> Document:
    """Return the document if its arrays fit together."""
    a = document.arrays
    points, cells, width = len(a["z"]), len(a["cell_numbers"]), len(a["length_scales"])
    fits = document.metadata.get("format") == DOCUMENT_FORMAT
    fits = fits and a["z"].shape == (points, width) and a["y"].shape == (points, 3) and a["gamma"].shape == (points,)
    fits = fits and a["signal_variance"].shape == a["noise_variance"].shape == a["trust"].shape == (3,)
    fits = fits and a["doubt"].shape == (3,)
    fits = fits and a["offsets"].shape == (cells + 1,) and a["offsets"][0] == 0 and a["offsets"][-1] == points
    fits = fits and np.array_equal(np.sort(a.get(_ORDER, np.arange(points))), np.arange(points))
    if any(name in a for name in _SUMS):
        expected = [(np.square(np.diff(a["offsets"])).sum(),), (points, 3), (cells,)]
        fits = fits and [a[name].shape if name in a else None for name in _SUMS] == expected
    if not (fits and (np.diff(a["offsets"]) > 0).all()):
        advice = "Export the set again."
        raise ExportError(f"is not a whole export of format {DOCUMENT_FORMAT}", where=str(path), advice=advice)
    return document


def require_equal(written: Document, found: Document, what: str) -> None:
    """Require that a document read back is the one written, bit for bit.

    Raises
    ------
    ExportError
        If a number or a word differs.
    """
    for name, values in written.arrays.items():
        if values.dtype != found.arrays[name].dtype or not np.array_equal(values, found.arrays[name]):
            advice = "Check the disk, and export again."
            raise ExportError(f"{what}: {name} does not read back as written; nothing was written", advice=advice)
    if found.metadata != json.loads(json.dumps(written.metadata)):
        advice = "Check the disk, and export again."
        raise ExportError(f"{what}: the metadata do not read back as written; nothing was written", advice=advice)


def document_answer(document: Document) -> ExportAnswer:
    """Return predictions from the numbers of a document alone: the reader that docs/export.md prints."""
    # Exports of before this key answered with the square of the trust.
    a = document.arrays | {"kept": np.array(document.metadata.get("kept", document.arrays["trust"] ** 2))}
    if "table" in document.metadata:
        return ExportAnswer(lambda z: _table_answer(a, z))
    if document.metadata["predictor"] == "projected":
        own = a | {name: a[_PREFIX + name] for name in PROJECTION_ARRAYS}
        return ExportAnswer(lambda z: _trusted(a, *answer_of(own, z)))
    robust = document.metadata["predictor"] == "rbcm"
    ratio = a["noise_variance"] / a["signal_variance"]
    cells = []
    for first, last in zip(a["offsets"][:-1], a["offsets"][1:], strict=True):
        points = a["z"][first:last] / a["length_scales"]
        away = points[:, None] - points[None]
        values, vectors = np.linalg.eigh(np.exp(-0.5 * (away**2).sum(-1)))
        damped = np.maximum(values, 0.0)[:, None] + ratio
        cells.append((points, vectors, damped, vectors.T @ a["y"][first:last]))

    def predict(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        top, precision = np.zeros((len(z), 3)), np.ones((len(z), 3))
        scaled = z / a["length_scales"]
        for points, vectors, damped, turned in cells:
            # An infinite distance is a correlation of zero; a query of 1e300 has one.
            with np.errstate(over="ignore", under="ignore"):
                t = np.exp(-0.5 * ((scaled[:, None] - points[None]) ** 2).sum(-1)) @ vectors
            q, m = t**2 @ (1.0 / damped), t @ (turned / damped)
            share = (-0.5 * np.log(1.0 - q) if robust else 1.0) / (1.0 - q)
            top += m * share
            precision += q * share
        return _trusted(a, top / precision, a["signal_variance"] / precision)

    return ExportAnswer(predict)


def relearned_error(document: Document, queries: np.ndarray) -> float | None:
    """Return how far a projected process is from one that learns the document's points again.

    That is the largest error of the mean in signal deviations, and of the variance in signal variances, at the
    points and at `queries`, shape (N, D). None where nothing is to be learned, or the order is not known.
    """
    a = document.arrays
    if _ORDER not in a:
        return None
    order = a[_ORDER]
    kernel = Kernel(a["length_scales"], a["signal_variance"], a["noise_variance"])
    process = process_of_labels(kernel, a["z"][order], a["y"][order])
    if _SUMS[0] in a:
        process.inform(a["z"], a["offsets"], *(a[name] for name in _SUMS))
    own = a | {name: a[_PREFIX + name] for name in PROJECTION_ARRAYS}
    worst = [0.0]
    everywhere = np.concatenate([a["z"], queries])
    for first in range(0, len(everywhere), _AT_ONCE):
        z = np.ascontiguousarray(everywhere[first : first + _AT_ONCE])
        mean, variance = answer_of(own, z)
        again, its_variance = process.along(z)[:2]
        worst += [float((np.abs(mean - again) / np.sqrt(kernel.signal_variance)).max())]
        worst += [float((np.abs(variance - its_variance) / kernel.signal_variance).max())]
    return float(np.max(worst))


def other_than_set(document: Document, training_set: TrainingSet) -> list[str]:
    """Return the names of the arrays that are not those of a set, number by number."""
    kernel = training_set.kernel
    of_set = {name: getattr(training_set, name) for name in ("cell_numbers", "offsets", "z", "y", "gamma")}
    of_set |= {name: getattr(kernel, name) for name in ("length_scales", "signal_variance", "noise_variance")}
    of_set |= {"trust": training_set.trust.array, "doubt": training_set.trust.doubts(kernel.signal_variance)}
    return [name for name, values in of_set.items() if not np.array_equal(values, document.arrays[name])]


def _trusted(a: dict[str, np.ndarray], mean: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return a["trust"] * mean, a["kept"] * variance + a["doubt"]


def _table_answer(a: dict[str, np.ndarray], z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Evaluate the spline: 64 coefficients a query."""
    sizes = np.array(a["coefficients"].shape[:3])
    place = np.clip((z - a["origin"]) / a["spacing"], 1.0, sizes - 2.0)
    unknown = np.isnan(z).any(axis=1)
    place[unknown] = 1.0
    first = np.minimum(place.astype(int), sizes - 3)
    t = place - first
    left = 1.0 - t
    weight = (
        np.stack([left**3, 4.0 - 6.0 * t**2 + 3.0 * t**3, 4.0 - 6.0 * left**2 + 3.0 * left**3, t**3], axis=-1) / 6.0
    )
    value = np.zeros((len(z), 6))
    for i, j, k in np.ndindex(4, 4, 4):
        node = a["coefficients"][first[:, 0] - 1 + i, first[:, 1] - 1 + j, first[:, 2] - 1 + k]
        value += (weight[:, 0, i] * weight[:, 1, j] * weight[:, 2, k])[:, None] * node * a["unit"]
    value[unknown] = np.nan
    share = np.minimum(np.maximum(1.0 - value[:, 3:], a["least"]), 1.0)
    return _trusted(a, value[:, :3], a["signal_variance"] * share**2)
