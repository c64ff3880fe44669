"""Describe a file: its kind, and what is in it."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from split_cli.errors import SplitError, reason_of
from split_cli.files import parse_json, refuse_no_regular_file
from split_cli.vehicle.parameters import EffectSpec
from split_cli.workflows.page_facts import describe_folder, describe_page
from split_cli.workflows.sources import LOG_SUFFIXES, SourceFile, find_sources, typed_address


@dataclass(frozen=True)
class FileDescription:
    """What a file is."""

    path: str
    # drive, labels, trained set, vehicle, signal map, export, diagnosis, evaluation, comparison, race, or recording
    kind: str
    facts: tuple[tuple[str, str], ...]  # what is known of it, in reading order


#: What is described of a folder; JSON and pages are parts of a result, which its own folder names.
_KINDS = (*LOG_SUFFIXES, ".split", ".yaml", ".yml")


def describe_files(addresses: Sequence[str | Path]) -> tuple[list[FileDescription], list[SplitError]]:
    """Return what files are, and the errors of those among several that cannot be read.

    Parameters
    ----------
    addresses : sequence of path-like
        Files and results as `describe_file` takes them; other folders, globs and addresses as `find_sources` does.

    Raises
    ------
    SplitError
        If there is one file only, and it cannot be read, or an address stands for nothing.
    """
    sources: list[SourceFile] = []
    for address in addresses:
        folder = Path(typed_address(address))
        if (folder / "manifest.json").is_file() or (folder / "report.html").is_file():
            sources.append(SourceFile(str(folder), folder.name))
        else:
            sources += find_sources([address], _KINDS, what="file that can be described")
    described, failures = [], []
    for source in sources:
        try:
            with source.local() as path:
                one = describe_file(path)
            facts = tuple((label, text.replace(str(path), source.address)) for label, text in one.facts)
            described.append(replace(one, path=source.address, facts=facts))
        except SplitError as error:
            if len(sources) == 1:
                raise
            failures.append(source.in_its_folder(error))
    return described, failures


def describe_file(path: str | Path) -> FileDescription:
    """Return what `path` is: any file this program writes, or a recording it can read.

    Raises
    ------
    SplitError
        If there is no such file, or it is damaged or of no kind known here.
    """
    path = Path(path)
    refuse_no_regular_file(path)
    if not path.exists():
        raise SplitError("no such file", where=str(path), advice="Is the path right?")
    suffix = path.suffix.lower()
    if path.is_dir() and (path / "manifest.json").is_file():
        return _export(path)
    if path.is_dir() and (path / "report.html").is_file():
        return FileDescription(str(path), *describe_folder(path))
    if suffix == ".html":
        return FileDescription(str(path), *describe_page(path))
    if suffix in (".yaml", ".yml"):
        return _yaml(path)
    if suffix == ".split":
        return _trained_set(path)
    if suffix == ".json":
        return _json(path)
    if suffix == ".parquet":
        return _parquet(path)
    return _recording(path)


def _found_in_training(effect: EffectSpec) -> tuple[str, str]:
    """Return an effect that a set has beyond its vehicle file, with values and units."""
    from split_cli.vehicle.effects import CATALOGUE

    units = CATALOGUE[effect.term].parameter_units(effect.variant)
    values = (f"{name} {value:.4g} {units[name]}".removesuffix(" 1") for name, value in effect.parameters.items())
    variant = f", variant {effect.variant}" if effect.variant else ""
    return f"found in training: {effect.term}{variant}", ", ".join(values)


def _trained_set(path: Path) -> FileDescription:
    from split_cli.learning.region import valid_cell_count
    from split_cli.learning.training_set import read_set
    from split_cli.scoring.circular import limits_of
    from split_cli.scoring.evidence import WHOLE_DRIVES

    trained = read_set(path)
    kernel = trained.kernel
    units = zip(trained.features.names, trained.features.units, strict=True)
    features = [f"{name} [{unit}]" if unit else name for name, unit in units]
    lone = trained.trust.origin == "held-out" and len(trained.sources) < WHOLE_DRIVES
    facts = [
        ("vehicle", f"{trained.vehicle.name} (sha256 {trained.vehicle.digest()[:12]})"),
        ("features", ", ".join(trained.features.names)),
        ("points", f"{trained.size} in {trained.cell_count} cells, at most {trained.capacity} a cell"),
    ]
    share = trained.valid_share()
    if share is not None:
        valid = valid_cell_count(trained.vehicle, trained.region, trained.grid)
        facts.append(("valid region", f"{valid} cells, {100.0 * share:.1f} % non-empty"))
    facts += [
        ("cell edges", _named(features, trained.grid.edges)),
        ("label interval", f"{trained.horizon:g} s"),
        ("trust", trained.trust.words()),
        *([("intervals", _ONE_DRIVE)] if lone else []),
        *([("intervals hold", _NEAR_POINTS)] if trained.trust.origin == "held-out" else []),
        *(_found_in_training(effect) for effect in trained.found),
        *(("cannot say", text) for text in limits_of(trained)),
        ("length scales", f"{_named(features, kernel.length_scales)} ({kernel.origin})"),
        ("signal deviation", _named(_LABELS, np.sqrt(kernel.signal_variance))),
        ("noise deviation", _named(_LABELS, np.sqrt(kernel.noise_variance))),
        ("threshold", f"gain [1] {trained.threshold:g}, the least of a point that enters a cell with room"),
        ("forgetting", "off" if trained.forgetting is None else f"{trained.forgetting:g} s"),
    ]
    for source in trained.sources:
        facts.append(
            (
                f"source {source.name}",
                f"{source.samples} labels, {source.accepted} valid, {source.insertions} inserted, "
                f"{source.replacements} replaced (sha256 {source.sha256[:12]})",
            )
        )
        facts += [("ingest found", "; ".join(found))] if (found := (*source.faults, *source.remarks)) else []
    return FileDescription(str(path), "trained set", tuple(facts))


def _parquet(path: Path) -> FileDescription:
    import pyarrow as pa
    import pyarrow.parquet

    try:
        names = pa.parquet.read_schema(path).names
        reasons = None
        if {"y_vx", "y_vy", "y_r", "reason"} <= set(names):
            reasons = pa.parquet.read_table(path, columns=["reason"])["reason"]
    except (pa.ArrowException, OSError, ValueError) as error:
        what = f"is not a whole Parquet file ({reason_of(error)})"
        raise SplitError(what, where=str(path), advice="Copy the file again, or make it anew.") from error
    if reasons is not None:
        counts = reasons.value_counts().to_pylist()
        by_reason = ", ".join(f"{entry['counts']} {entry['values'] or 'accepted'}" for entry in counts)
        features = [n for n in names if n not in ("t", "row", "segment", "y_vx", "y_vy", "y_r", "reason")]
        facts = (("labels", str(len(reasons))), ("features", ", ".join(features)), ("by reason", by_reason))
        return FileDescription(str(path), "labels", facts)
    if {"vx", "vy", "r"} <= {name.split("(")[0].strip() for name in names}:
        return _drive(path)
    return _recording(path)


def _drive(path: Path) -> FileDescription:
    from split_cli.logs.drive import read_drive

    drive = read_drive(path)
    speed = np.hypot(drive["vx"], drive["vy"])
    facts = [
        ("samples", f"{len(drive)} at {drive.rate:g} Hz, {len(drive) * drive.period:.1f} s"),
        ("segments", str(len(drive.segments()))),
        ("channels", ", ".join(drive.columns)),
        ("speed", f"{speed.min():.1f} to {speed.max():.1f} m/s"),
    ]
    facts += [(f"{channel} is", kind) for channel, kind in drive.metadata.kinds.items()]
    facts += [("source", f"{s.name} (sha256 {s.sha256[:12]})") for s in drive.metadata.sources]
    facts += [("converted", text) for text in drive.metadata.conversions]
    facts += [("concealed", text) for text in drive.metadata.quality.get("effects", ())]
    return FileDescription(str(path), "drive", tuple(facts))


def _yaml(path: Path) -> FileDescription:
    from split_cli.vehicle.parameters import read_vehicle
    from split_cli.yaml_file import read_yaml_mapping

    content = read_yaml_mapping(path, SplitError)
    if "channels" in content or "preset" in content:
        channels = content.get("channels") or {}
        return FileDescription(str(path), "signal map", (("channels", ", ".join(map(str, channels)) or "-"),))
    car = read_vehicle(path)
    facts = [
        ("name", car.name),
        ("sha256 of the physics", car.digest()[:12]),
        ("mass", f"{car.mass:g} kg"),
        ("yaw inertia", f"{car.yaw_inertia:g} kg m^2"),
        ("wheelbase", f"{car.wheelbase:g} m (l_f {car.cg_to_front_axle:g}, l_r {car.cg_to_rear_axle:g})"),
        (
            "cornering stiffness",
            f"{car.front_tire.cornering_stiffness:.4g} front, {car.rear_tire.cornering_stiffness:.4g} rear N/rad",
        ),
        ("peak lateral force", f"{car.front_tire.D:.4g} front, {car.rear_tire.D:.4g} rear N"),
        ("effects", ", ".join(effect.term for effect in car.effects) or "none"),
        ("minimum speed", f"{car.minimum_speed:.3g} m/s"),
    ]
    for origin in ("published", "assumed", "calibrated"):
        keys = [key for key, said in car.origins.items() if said == origin]
        if keys:
            facts.append((origin, ", ".join(keys)))
    return FileDescription(str(path), "vehicle", tuple(facts))


_LABELS = ("v_x [m/s^2]", "v_y [m/s^2]", "r [rad/s^2]")
_ONE_DRIVE = "hold for other stretches of the same driving only, since the set was trained on one drive or two"
_NEAR_POINTS = "within a length scale of the points; beyond they only carry the size of the residual in training"
_READS = "Name a drive, a trained set, labels, a vehicle file, a map, an export, or a folder with a report."


def _named(names: Sequence[str], values: Iterable[float]) -> str:
    """Return values with their names, to three digits."""
    return ", ".join(f"{name} {value:.3g}" for name, value in zip(names, values, strict=True))


def _load_json(path: Path) -> dict:
    try:
        content = parse_json(path.read_text(encoding="utf-8"))
    except (ValueError, OSError) as error:
        advice = "Copy the file again, or make it anew."
        raise SplitError(f"is not JSON ({error})", where=str(path), advice=advice) from error
    if not isinstance(content, dict):
        raise SplitError("is JSON that this program did not write", where=str(path), advice=_READS)
    return content


def _json(path: Path) -> FileDescription:
    content = _load_json(path)
    if content.get("schema") == "split-diagnosis/1":
        try:
            found = ", ".join(str(entry["term"]) for entry in content["findings"]) or "none"
            facts = [("findings", found), *((name, str(content[name])) for name in ("verdict", "unexplained"))]
        except (LookupError, TypeError) as error:
            raise SplitError("is a diagnosis that was damaged or forged", where=str(path)) from error
        return FileDescription(str(path), "diagnosis", tuple(facts))
    if (path.parent / "manifest.json").is_file():
        return _export(path.parent)
    raise SplitError("is JSON that this program did not write", where=str(path), advice=_READS)


def _export(folder: Path) -> FileDescription:
    manifest = _load_json(folder / "manifest.json")
    facts = [(key, _short(value)) for key, value in manifest.items()]
    return FileDescription(str(folder), "export", tuple(facts))


def _short(value: object) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 160 else text[:157] + "..."


_MOST_LINES = 200


def _recording(path: Path) -> FileDescription:
    from split_cli.logs.listing import listed_channels
    from split_cli.logs.readers import open_recording

    recording = open_recording(path)
    lines = listed_channels(recording)
    alone = "each channel has its own" if getattr(recording, "own_clocks", False) else "a column"
    facts = [("clocks", ", ".join(recording.clocks) or alone), ("channels", str(len(recording.channels())))]
    for line in lines[:_MOST_LINES]:
        count = "" if line.info.count is None else f"{line.info.count} x "
        unit = f" [{line.info.unit}]" if line.info.unit else ""
        facts.append((line.name, f"{count}{line.info.type_name}{unit}"))
    if len(lines) > _MOST_LINES:
        facts.append(("...", f"{len(lines) - _MOST_LINES} more; `split ingest {path} --list` shows all"))
    return FileDescription(str(path), "recording", tuple(facts))
