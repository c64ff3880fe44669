"""Signal maps are read: which recorded signal becomes which channel, in what unit, frame and place on the car."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from split_cli.errors import MapError, nearest_names
from split_cli.logs.map_entries import CONVERSIONS, ChannelMap, Position, SignalMap, SignalSource, TimeBase
from split_cli.logs.presets import preset_names, preset_path
from split_cli.logs.raw import STAMP_PARTS, SplitStamp
from split_cli.signals import CHANNELS, UNITS, find_unit
from split_cli.yaml_file import read_yaml_mapping

_MAP_KEYS = (
    "name",
    "about",
    "preset",
    "time",
    "frame",
    "world",
    "topics",
    "extras",
    "datum",
    "rows",
    "derivations",
    "despike",
    "kinds",
    "channels",
)
_SOURCE_KEYS = ("source", "convert", "scale", "offset", "curve", "unit", "delay", "frame", "world")
_CHANNEL_KEYS = (*_SOURCE_KEYS, "sum", "position", "kind", "resample", "optional", "note")
_TIME_KEYS = ("source", "unit", *STAMP_PARTS, "period", "clock")
_AXLES = ("cg", "front_axle", "rear_axle")
_KINDS = ("command", "measured", "derived")
_RESAMPLING = ("continuous", "held", "angle")


def read_map(names: str | Path | Iterable[str | Path]) -> SignalMap:
    """Read one or several maps, each a preset's name or a YAML file; later ones override earlier ones.

    Raises
    ------
    MapError
        If a file is missing or not YAML, a key is unknown (the nearest known is named), or a value impossible.
    """
    paths = [names] if isinstance(names, str | Path) else list(names)
    merged: dict[str, Any] = {}
    for path in paths:
        merged = _merge(merged, _load(path, ()))
    return map_from_mapping(merged, where=", ".join(Path(path).name for path in paths))


def map_from_mapping(content: Mapping[str, Any], *, where: str = "signal map") -> SignalMap:
    """Build a map from what a map file holds; presets it names are merged in. See `read_map`."""
    content = _with_presets(dict(content), where, ())
    _check_keys(content, _MAP_KEYS, where)
    entries = _mapping(content.get("channels") or {}, where, "channels")
    kinds = _mapping(content.get("kinds") or {}, where, "kinds")
    for channel in kinds:
        if channel not in entries:
            advice = nearest_names(channel, entries)
            raise MapError(f"kinds names {channel!r}, which is not mapped", where=where, advice=advice)
    channels = tuple(
        _channel(str(name), entry, kinds.get(name), f"{where}, channel {name}")
        for name, entry in entries.items()
        if entry is not None
    )
    return SignalMap(
        name=str(content.get("name") or where),
        channels=channels,
        time=_time(content.get("time") or {}, where),
        frame=_one_of(content.get("frame", "flu"), ("flu", "frd"), where, "frame"),
        world=_one_of(content.get("world", "enu"), ("enu", "ned"), where, "world"),
        topics={str(k): str(v) for k, v in _mapping(content.get("topics") or {}, where, "topics").items()},
        extras=_extras(content.get("extras"), where),
        datum=_datum(content.get("datum"), where),
        rows=_rows(content.get("rows"), where),
        derivations={
            str(k).replace("-", "_"): _mapping(v or {}, where, f"derivations.{k}")
            for k, v in _mapping(content.get("derivations") or {}, where, "derivations").items()
        },
        despike=bool(content.get("despike", True)),
        content=content,
    )


def _load(path: str | Path, above: tuple[str, ...]) -> dict[str, Any]:
    file = Path(path)
    if not file.is_file():
        file = preset_path(str(path)) or file
    advice = f"{nearest_names(str(path), preset_names())} A map is a YAML file or one of the presets."
    advice += " `split init LOG` drafts one."
    content = read_yaml_mapping(file, MapError, missing="no such map", advice=advice)
    _check_keys(content, _MAP_KEYS, str(path))
    content.setdefault("name", file.stem)
    return _with_presets(content, str(path), above)


def _with_presets(content: dict[str, Any], where: str, above: tuple[str, ...]) -> dict[str, Any]:
    presets = content.pop("preset", None) or []
    presets = [presets] if isinstance(presets, str) else presets
    if not isinstance(presets, list) or not all(isinstance(preset, str) for preset in presets):
        advice = "`split ingest --list-maps` shows the names."
        what = f"preset is {presets!r}, a name or a list of names was expected"
        raise MapError(what, where=where, advice=advice)
    if len(set(presets)) < len(presets):
        raise MapError("names a preset twice", where=where, advice="Leave one; the last one overrides the others.")
    base: dict[str, Any] = {}
    for preset in presets:
        if preset in above:
            what = f"preset {preset!r} includes itself"
            raise MapError(what, where=where, advice="Leave out its `preset:` line.")
        if preset_path(preset) is None:
            raise MapError(f"no preset {preset!r}", where=where, advice=nearest_names(preset, preset_names()))
        base = _merge(base, _load(preset, (*above, preset)))
    return _merge(base, content) if base else content


def _merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Lay `over` on `base`: sections key by key; a channel whose source is given anew is replaced whole."""
    merged = dict(base)
    for key, value in over.items():
        if key in ("kinds", "topics", "derivations", "time") and isinstance(value, Mapping):
            merged[key] = value if key == "time" else {**merged.get(key, {}), **value}
        elif key == "channels" and isinstance(value, Mapping):
            channels = dict(merged.get("channels") or {})
            for name, entry in value.items():
                known = channels.get(name)
                update = isinstance(entry, Mapping) and not {"source", "sum"} & set(entry)
                channels[name] = {**known, **entry} if update and isinstance(known, Mapping) else entry
            merged["channels"] = channels
        else:
            merged[key] = value
    return merged


def _channel(name: str, entry: Any, kind: Any, where: str) -> ChannelMap:
    if isinstance(entry, str):
        entry = {"source": entry}
    entry = _mapping(entry, where, "the entry")
    _check_keys(entry, _CHANNEL_KEYS, where)
    if ("source" in entry) == ("sum" in entry):
        advice = "Write `source: NAME`, or `sum: [{source: A}, {source: B}]`."
        raise MapError("needs either source or sum", where=where, advice=advice)
    if "sum" in entry:
        if not isinstance(entry["sum"], list) or not entry["sum"]:
            what = "sum must be a list of entries"
            raise MapError(what, where=where, advice="Write `sum: [{source: A}, {source: B}]`.")
        outer = {key: entry[key] for key in ("unit", "delay", "frame", "world") if key in entry}
        misplaced = [key for key in ("convert", "scale", "offset", "curve") if key in entry]
        if misplaced:
            advice = "Write it beside each `source` of the sum."
            raise MapError(f"{misplaced[0]} belongs into the entries of the sum", where=where, advice=advice)
        parts = [{"source": part} if isinstance(part, str) else part for part in entry["sum"]]
        sources = tuple(
            _source({**outer, **_mapping(part, where, "an entry of sum")}, f"{where}, sum[{index}]")
            for index, part in enumerate(parts)
        )
    else:
        sources = (_source({key: entry[key] for key in _SOURCE_KEYS if key in entry}, where),)
    kind = entry.get("kind", kind)
    resample = entry.get("resample")
    if name in CHANNELS and CHANNELS[name].kind == "angle" and resample == "continuous":
        raise MapError(f"{name} is an angle, it must be unwrapped", where=where, advice="Leave resample out.")
    return ChannelMap(
        channel=name,
        sources=sources,
        position=_position(entry.get("position"), where),
        kind=None if kind is None else _one_of(kind, _KINDS, where, "kind"),
        resample=None if resample is None else _one_of(resample, _RESAMPLING, where, "resample"),
        optional=bool(entry.get("optional", False)),
    )


def _source(entry: Mapping[str, Any], where: str) -> SignalSource:
    _check_keys(entry, _SOURCE_KEYS, where)
    names = entry.get("source")
    names = (names,) if isinstance(names, str) else tuple(names) if isinstance(names, list) else ()
    if not names or not all(isinstance(name, str) and name for name in names):
        advice = "`split ingest LOG --list` shows the names."
        raise MapError("source must be a name, or a list of names for a conversion", where=where, advice=advice)
    convert = entry.get("convert") or ""
    if convert:
        _one_of(convert, CONVERSIONS, where, "convert")
    elif len(names) > 1:
        advice = "Write `convert:`, for example local_x, or `sum:` instead of `source:`."
        raise MapError("several sources need convert, or a sum", where=where, advice=advice)
    if _number(entry.get("scale", 1.0), where, "scale") == 0.0:
        advice = "Give the factor from the recorded value to the unit."
        raise MapError("scale is 0, the channel would be constant", where=where, advice=advice)
    unit = entry.get("unit")
    if unit is not None and find_unit(str(unit)) is None:
        advice = nearest_names(str(unit), [known.symbol for known in UNITS])
        raise MapError(f"unknown unit {unit!r}", where=where, advice=advice)
    return SignalSource(
        names=names,
        convert=convert,
        scale=_number(entry.get("scale", 1.0), where, "scale"),
        offset=_number(entry.get("offset", 0.0), where, "offset"),
        curve=_curve(entry.get("curve"), where),
        unit=None if unit is None else str(unit),
        delay=None if entry.get("delay") is None else _number(entry["delay"], where, "delay"),
        frame=None if "frame" not in entry else _one_of(entry["frame"], ("flu", "frd"), where, "frame"),
        world=None if "world" not in entry else _one_of(entry["world"], ("enu", "ned"), where, "world"),
    )


def _curve(entry: Any, where: str) -> tuple[tuple[float, float], ...]:
    if entry is None:
        return ()
    points = entry if isinstance(entry, list) else []
    if len(points) < 2 or not all(isinstance(point, list) and len(point) == 2 for point in points):
        advice = "For example `curve: [[-1, -0.5], [1, 0.5]]`."
        raise MapError("curve must be a list of two or more pairs [recorded, value]", where=where, advice=advice)
    pairs = tuple((_number(a, where, "curve"), _number(b, where, "curve")) for a, b in points)
    if any(later[0] <= earlier[0] for earlier, later in zip(pairs[:-1], pairs[1:], strict=True)):
        what = "the recorded values of a curve must ascend, each larger than the one before"
        raise MapError(what, where=where, advice="Sort the pairs by their first value.")
    return pairs


def _position(entry: Any, where: str) -> Position | None:
    if entry is None or entry == "cg":
        return None
    if isinstance(entry, str):
        return Position(axle=_one_of(entry, _AXLES, where, "position"))
    entry = _mapping(entry, where, "position")
    _check_keys(entry, ("x", "y", "from"), where)
    axle = _one_of(entry.get("from", "cg"), _AXLES, where, "position.from")
    return Position(_number(entry.get("x", 0.0), where, "x"), _number(entry.get("y", 0.0), where, "y"), axle)


def _time(entry: Any, where: str) -> TimeBase:
    where = f"{where}, time"
    if isinstance(entry, str):
        entry = {"source": entry}
    entry = _mapping(entry, where, "the entry")
    _check_keys(entry, _TIME_KEYS, where)
    if len([key for key in ("source", "period", "clock") if key in entry]) > 1:
        advice = "Leave one: a column, a fixed step, or a clock of the messages."
        raise MapError("more than one of source, period and clock is given", where=where, advice=advice)
    period = entry.get("period")
    if period is not None and not _number(period, where, "period") > 0:
        advice = "Give the time between two rows in seconds."
        raise MapError(f"period is {period}, it must be positive", where=where, advice=advice)
    for key in ("source", *STAMP_PARTS):
        if entry.get(key) is not None and not isinstance(entry[key], str):
            advice = "`split ingest LOG --list` shows the columns."
            raise MapError(f"{key} must be the name of a column", where=where, advice=advice)
    parts = [key for key in STAMP_PARTS if key in entry]
    if len(parts) > 1 or (parts and "source" not in entry):
        advice = "Write `source: stamp_sec, nanoseconds: stamp_nanosec`, or microseconds alike."
        raise MapError(f"{parts[0]} needs one column of whole seconds: source", where=where, advice=advice)
    unit = entry.get("unit")
    if unit is not None and getattr(find_unit(str(unit)), "si", "") != "s":
        raise MapError(f"{unit!r} is not a unit of time", where=where, advice="Give s, ms, us, ns or min.")
    clock = entry.get("clock")
    return TimeBase(
        source=entry.get("source"),
        unit=unit or ("s" if parts else None),
        stamp=SplitStamp(entry["source"], entry[parts[0]], parts[0]) if parts else None,
        period=None if period is None else float(period),
        clock=None if clock is None else _one_of(clock, ("header", "publish", "log"), where, "clock"),
    )


def _extras(entry: Any, where: str) -> tuple[str, ...] | None:
    if entry is None or entry == "all":
        return None
    if entry == "none":
        return ()
    if not isinstance(entry, list):
        raise MapError(f"extras is {entry!r}", where=where, advice="Give all, none or a list of columns.")
    return tuple(str(name) for name in entry)


def _datum(entry: Any, where: str) -> tuple[float, float] | None:
    if entry is None:
        return None
    if not isinstance(entry, list) or len(entry) != 2:
        advice = "For example `datum: [48.1, 11.6]`."
        raise MapError("datum must be [latitude, longitude] in degrees", where=where, advice=advice)
    return _number(entry[0], where, "datum"), _number(entry[1], where, "datum")


def _rows(entry: Any, where: str) -> dict[str, str]:
    rows = _mapping(entry or {}, where, "rows")
    if not all(isinstance(value, str | int) and not isinstance(value, bool) for value in rows.values()):
        advice = "For example `rows: {car_id: 44}`."
        raise MapError("rows must name a column and what it says of the car", where=where, advice=advice)
    return {str(column): str(value) for column, value in rows.items()}


def _mapping(entry: Any, where: str, what: str) -> dict[str, Any]:
    if not isinstance(entry, Mapping):
        advice = "Write `key: value`, one a line or in braces."
        raise MapError(f"{what} is {entry!r}, keys with values were expected", where=where, advice=advice)
    return dict(entry)


def _check_keys(entry: Mapping[str, Any], known: Iterable[str], where: str) -> None:
    for key in entry:
        if key not in known:
            raise MapError(f"unknown key {key!r}", where=where, advice=nearest_names(str(key), known))


def _one_of(value: Any, known: tuple[str, ...], where: str, what: str) -> str:
    if value not in known:
        raise MapError(f"{what} is {value!r}", where=where, advice=nearest_names(str(value), known))
    return str(value)


def _number(value: Any, where: str, what: str) -> float:
    """Return a finite number, or one written as a quotient: ``1/15.3`` of a steering ratio."""
    above, _, below = value.partition("/") if isinstance(value, str) else ("", "", "")
    with suppress(ValueError, ZeroDivisionError):
        value = float(above) / float(below) if below else value
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e300:
        advice = "Write a number such as 0.5, or a quotient such as 1/15.3, without a unit."
        raise MapError(f"{what} is {value!r}, a finite number was expected", where=where, advice=advice)
    return float(value)
