"""MATLAB files: versions 4 and 5 through SciPy, 7.3 (HDF5) through h5py."""

import math
import re
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.errors import LogError, damaged
from split_cli.logs import scratch
from split_cli.logs.budget import LONGEST_NAME, MOST_FIELDS, Unfolded, refuse_unpacked_size
from split_cli.logs.raw import RawRecording, ReadNote, note_once
from split_cli.logs.readers.hdf5_attributes import (
    clock_of_samples,
    name_of_index,
    titles_of_block,
    titles_of_matrix,
    unpacked,
)
from split_cli.logs.readers.mat5_structure import check_mat5
from split_cli.logs.readers.named_arrays import VALUE_FIELDS, recording_of_vectors
from split_cli.logs.scratch import set_aside

_DEEPEST = 8
_DEEP = f"variables within more than {_DEEPEST} others, left out"
_MANY = f"elements of cells and arrays of structures beyond the first {MOST_FIELDS:,}, left out"
_PICKLED = "columns without names: pandas pickles them. Write with to_parquet, or to_hdf(..., data_columns=True)"
_ODD = "variables that are neither real numbers nor text, left out"
_ELSEWHERE = "links to other files, or to what was read already, left out"
_UNIT_FIELDS = ("unit", "units")


def open_mat(path: Path) -> RawRecording:
    """Open a MAT file of version 4, 5 or 7.

    Vectors become channels; a struct's fields are addressed as ``struct.field``, the columns of a matrix as
    ``name[0]``. A structure with time (Simulink) becomes one channel of its name with its own clock, or one for
    each signal's label. A recording of ControlDesk (dSPACE) becomes one channel for each signal's name. Objects of
    MATLAB (timeseries, timetable, Dataset) cannot be read; they are named.

    Raises
    ------
    LogError
        If it is damaged or holds no vector that can be read.
    """
    from scipy.io.matlab import MatlabOpaque

    check_mat5(path)
    leaves: list[tuple[str, np.ndarray]] = []
    objects: list[str] = []
    left: Counter[str] = Counter()
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            for key, value in _variables(path):
                if isinstance(value, MatlabOpaque):
                    # SciPy calls each of them None; the first of its texts is the name.
                    objects.append(bytes(np.ravel(value)[0]["s0"]).decode("ascii", "replace"))
                else:
                    leaves += [(name, _aside(values)) for name, values in _leaves(key, value, 0, left)]
    except Exception as error:  # SciPy's reader raises a dozen kinds on damaged files
        raise damaged(path, error, "Save it again.") from error
    # SciPy only warns where it takes numbers for others, cannot read a variable or meets one a second time.
    lost = [str(warning.message) for warning in said if not issubclass(warning.category, DeprecationWarning)]
    if any("byte ordering" in text for text in lost):
        raise damaged(path, ValueError("numbers in an order of bytes that no PC writes"), "Save it again.")
    left["variables that cannot be read or stand twice, left out"] += len(lost)
    return _recording(path, _trajectories(dict(leaves)) or leaves, objects, left)


def _trajectories(arrays: dict[str, np.ndarray]) -> list[tuple[str, np.ndarray]]:
    """Return the variables of a result of Modelica (Dymola, OpenModelica) by their names; none of another file.

    Texts stand in columns of characters, the unit at the end of a description. A row of ``dataInfo`` gives the table
    of a variable and its column there, which counts from 1 and is negative where the sign is turned.
    """
    if not {"Aclass", "name", "description", "dataInfo", "data_2"} <= set(arrays):
        return []
    turned = any("binTrans" in text for text in _texts(arrays["Aclass"], turned=False))
    names, said = (_texts(arrays[key], turned) for key in ("name", "description"))
    info, table = (arrays[key].T if turned else arrays[key] for key in ("dataInfo", "data_2"))
    units = (re.search(r"\[([^\]|]+)", text) for text in said)
    return [
        (f"{name} [{unit[1].replace('.', ' ')}]" if unit else name, np.sign(column) * table[:, abs(column) - 1])
        for name, unit, (of, column) in zip(names, units, info[:, :2].astype(int), strict=False)
        if of != 1 and 0 < abs(column) <= table.shape[1]
    ]


def _texts(characters: np.ndarray, turned: bool) -> list[str]:
    """Return texts that MATLAB keeps as the rows of a matrix of characters, or its columns where it is turned."""
    rows = [list(text) for text in np.ravel(characters)]
    return ["".join(text).strip("\0 ") for text in (zip(*rows, strict=False) if turned else rows)]


def _variables(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield the variables, of a long recording some at a time: all at once would take its whole size in memory."""
    from scipy.io import loadmat, whosmat

    try:
        listed = [(name, math.prod(shape)) for name, shape, _ in whosmat(path)]
    except TypeError:  # SciPy reads objects of a class, but gives them no shape to list
        listed = []
    batches: list[list[str] | None] = [None]
    if sum(size for _, size in listed) >= scratch.LONG and len(dict(listed)) == len(listed):
        batches, room = [], 0
        for name, size in listed:
            if room <= 0:
                batches.append([])
                room = scratch.LONG
            batches[-1].append(name)
            room -= size
    for names in batches:
        content = loadmat(path, struct_as_record=False, squeeze_me=False, chars_as_strings=True, variable_names=names)
        yield from ((key, value) for key, value in content.items() if not key.startswith("__"))


def _aside(values: np.ndarray) -> np.ndarray:
    """Return a long array as numbers outside memory, others as they are."""
    if values.size < scratch.LONG or values.dtype.kind not in "biuf":
        return values
    with np.errstate(over="ignore"):
        return set_aside(np.asarray(values, dtype=np.float64)).reshape(values.shape)


def open_mat_hdf5(path: Path) -> RawRecording:
    """Open a MAT file of version 7.3, or an HDF5 file of vectors; see `open_mat`.

    Raises
    ------
    LogError
        If it is damaged or holds no vector.
    """
    import h5py

    leaves: list[tuple[str, np.ndarray]] = []
    objects: list[str] = []
    try:
        with h5py.File(path, "r") as file:
            found = _Hdf5(path.name, Unfolded(path.stat().st_size), leaves, objects)
            found.collect(file, "", 0)
    except LogError:
        raise
    except Exception as error:  # h5py passes on whatever the HDF5 library finds
        raise damaged(path, error, "Save it again.") from error
    return _recording(path, leaves, objects, found.left)


def _leaves(name: str, value: Any, depth: int, left: Counter[str]) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the numeric arrays of a variable, with their addresses; `left` counts what is none, by its reason."""
    if depth > _DEEPEST:
        left[_DEEP] += 1
        return
    if {"X", "Y"} <= set(getattr(value, "_fieldnames", ())) and all(_named(value.Y)) and _are_axes(value.X):
        yield from _capture(name, value)
    elif hasattr(value, "_fieldnames"):
        unit = next((_text(getattr(value, key)) for key in value._fieldnames if key.lower() in _UNIT_FIELDS), "")
        for key in value._fieldnames:
            yield from _leaves(_with_unit(f"{name}.{key}", unit), getattr(value, key), depth + 1, left)
    elif isinstance(value, np.ndarray) and value.dtype == object:
        # Structs and cells come as arrays of objects, a single struct as an array of one.
        items = value.ravel()[:MOST_FIELDS]
        left[_MANY] += value.size - len(items)
        if value.size > 1 and all(map(_text, items)):
            yield name, np.array([_text(item) for item in items])
            return
        labels = [_label(item) for item in items]
        labelled = name.endswith(".signals") and all(labels) and len(set(labels)) == len(labels)
        called = [] if name.endswith(".signals") else _names_of_structures(items)
        for index, item in enumerate(items):
            if called:
                yield from _leaves(f"{name}.{called[index]}", item, depth + 1, left)
            elif labelled:
                # Beside the structure's time, so that it is their clock.
                yield from _leaves(f"{name.removesuffix('.signals')}.{labels[index]}", item.values, depth + 1, left)
            else:
                yield from _leaves(name if value.size == 1 else f"{name}[{index}]", item, depth + 1, left)
    elif isinstance(value, np.ndarray) and (value.dtype.kind in "biuf" or (value.dtype.kind == "U" and value.size > 1)):
        yield name, value
    elif not (isinstance(value, np.ndarray) and value.dtype.kind == "U"):
        left[_ODD] += 1


def _names_of_structures(items: Sequence[Any]) -> list[str]:
    """Return the names of several channels, each a structure with its name in it; empty where they are other ones."""
    # A cell holds its structure as an array of one.
    items = [item.ravel()[0] if isinstance(item, np.ndarray) and item.size == 1 else item for item in items]
    fields = [{key.lower(): key for key in getattr(item, "_fieldnames", ())} for item in items]
    keys = [next((known[k] for k in ("name", "label", "channel") if k in known), "") for known in fields]
    if len(items) < 2 or not all(keys) or not all({"data", "values", "value"} & set(known) for known in fields):
        return []
    names = [_text(getattr(item, key)).replace(".", "_") for item, key in zip(items, keys, strict=True)]
    return names if all(names) and len(set(names)) == len(names) else []


def _with_unit(name: str, unit: str) -> str:
    """Return the address of a structure's values with the unit that stands beside them, as MoTeC exports it."""
    # A dot in brackets is no part of an address.
    return f"{name} [{unit.replace('.', ' ')}]" if unit and name.endswith(VALUE_FIELDS) else name


def _named(items: Any) -> list[str]:
    """Return the names in an array of structures with Name and Data; one empty name where it is something else."""
    fields = [set(getattr(item, "_fieldnames", ())) for item in np.ravel(items)]
    if not fields or not all({"Name", "Data"} <= each for each in fields):
        return [""]
    return [_text(item.Name) for item in np.ravel(items)]


def _are_axes(items: Any) -> bool:
    """Whether each is a structure with Data, the clock of signals; ControlDesk may leave its name empty."""
    return all("Data" in getattr(item, "_fieldnames", ()) for item in np.ravel(items))


def _text(value: Any) -> str:
    text = np.ravel(value)
    return str(text[0]).strip() if len(text) == 1 and text.dtype.kind == "U" else ""


def _capture(name: str, value: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the signals of a recording of ControlDesk (dSPACE): ``Y`` with Name, Unit and Data over ``X``.

    A name is the path of a block; its last part counts, without the port, unless two signals share it.
    """
    axes = [np.asarray(axis.Data) for axis in np.ravel(value.X)]
    parts = [re.sub(r"/(Out|In)\d+$", "", title).replace(".", "_") for title in _named(value.Y)]
    short = [part.rpartition("/")[2] for part in parts]
    for part, bare, signal in zip(parts, short, np.ravel(value.Y), strict=True):
        raster = int(np.ravel(getattr(signal, "XIndex", 1))[0]) if len(axes) > 1 else 1
        group = f"{name}.{raster}" if len(axes) > 1 else name
        unit = _text(getattr(signal, "Unit", ""))
        title = bare if short.count(bare) == 1 else part.replace("/", "_")
        if not 1 <= raster <= len(axes):
            continue
        yield f"{group}.{title}" + (f" [{unit}]" if unit else ""), np.asarray(signal.Data)
    for raster, axis in enumerate(axes, 1):
        yield f"{name}.{raster}.time" if len(axes) > 1 else f"{name}.time", axis


def _label(item: Any) -> str:
    """Return the label of a signal of a structure with time, without dots; nothing if it has none."""
    if not {"values", "label"} <= set(getattr(item, "_fieldnames", ())):
        return ""
    return _text(item.label).replace(".", "_")


class _Hdf5:
    """What is collected from an HDF5 file.

    Every group is looked into once, since groups may hold each other. All variables share one budget, since one
    may have a million names. What lies in another file is none of this one.

    Attributes
    ----------
    leaves : list of (str, ndarray)
    objects : list of str
        Names of MATLAB's objects, which cannot be read.
    left : Counter of str
        What was left out, by its reason.
    """

    def __init__(
        self, where: str, unfolded: Unfolded, leaves: list[tuple[str, np.ndarray]], objects: list[str]
    ) -> None:
        self.leaves, self.objects = leaves, objects
        self.left: Counter[str] = Counter()
        self._followed = 0
        self._where, self._unfolded = where, unfolded
        self._seen: set[Any] = set()

    def collect(self, group: Any, prefix: str, depth: int) -> None:
        """Collect what a group and those in it hold."""
        import h5py

        self._seen.add(h5py.h5o.get_info(group.id).addr)
        units = (_inside(group, key) for key in group if key.lower() in _UNIT_FIELDS)
        unit = next((_text_hdf5(item) for item in units if item is not None), "")
        for key in group:
            # PyTables keeps an index of a table beside it.
            if key.startswith(("#", "_i_")) or (unit and key.lower() in _UNIT_FIELDS):
                continue
            if depth > _DEEPEST:
                self.left[_DEEP] += 1
                continue
            name = f"{prefix}{key}"
            item = _inside(group, key)
            if item is None or h5py.h5o.get_info(item.id).addr in self._seen:
                self.left[_ELSEWHERE] += 1
            elif "MATLAB_object_decode" in item.attrs:
                self.objects.append(name)
            elif isinstance(item, h5py.Group):
                self.collect(item, name + ".", depth + 1)
            elif isinstance(item, h5py.Dataset) and item.dtype == h5py.ref_dtype:
                self._follow(item, prefix, key, depth)
            elif isinstance(item, h5py.Dataset):
                self._read(item, name, unit)

    def _follow(self, item: Any, prefix: str, key: str, depth: int) -> None:
        """Collect what references lead to: cells, or one field of all elements of an array of structures."""
        import h5py

        is_cell = item.attrs.get("MATLAB_class", b"") in (b"cell", "cell")
        references = np.ravel(item[()])
        taken = references[: max(MOST_FIELDS - self._followed, 0)]
        self._followed += len(taken)
        self.left[_MANY] += len(references) - len(taken)
        found = [item.file[ref] for ref in taken if ref]
        texts = [_text_hdf5(one) for one in found]
        if is_cell and len(found) > 1 and all(texts):
            self.leaves.append((f"{prefix}{key}", np.array(texts)))
            return
        for index, one in enumerate(found):
            name = f"{prefix}{key}[{index}]" if is_cell or not prefix else f"{prefix[:-1]}[{index}].{key}"
            if isinstance(one, h5py.Group) and h5py.h5o.get_info(one.id).addr not in self._seen:
                self.collect(one, name + ".", depth + 1)
            elif isinstance(one, h5py.Dataset) and one.dtype != h5py.ref_dtype:
                self._read(one, name, "")

    def _read(self, item: Any, name: str, unit: str) -> None:
        if item.attrs.get("MATLAB_empty", 0) or item.attrs.get("MATLAB_class", b"") in (b"char", "char"):
            return
        columns = [field for field in item.dtype.names or () if item.dtype[field].base.kind in "biuf"]
        if item.dtype.kind in "OS" and item.ndim == 1:
            self.leaves += _list_of_texts(item, name)
            return
        if (item.dtype.kind not in "biuf" and not columns) or item.ndim > 2 - bool(columns):
            # HDF5 of other programs keeps text in kinds of its own.
            self.left[_ODD] += item.dtype.kind not in "OSU"
            return
        if item.external or item.is_virtual:
            self.left[_ELSEWHERE] += 1
            return
        # A fill value stands for any number of values that are stored nowhere.
        stored = item.id.get_storage_size()
        place = len(self.leaves)
        most = self._unfolded.most(place, stored)
        refuse_unpacked_size(item.nbytes, stored, f"variable {name}", self._where, most)
        self._unfolded.add(place, item.nbytes)
        own = next((_attribute(item.attrs[key]) for key in item.attrs if key.lower() in _UNIT_FIELDS), "")
        titled = f"{name} [{own.replace('.', ' ')}]" if own else _with_unit(name, unit)
        if columns:
            rows = item[()]  # a table of PyTables or h5py: a field a column
            for field in columns:
                self._add_field(item, name, field, np.atleast_2d(rows[field].T).T)
            return
        values = np.atleast_2d(np.asarray(item[()]))
        titles = titles_of_matrix(item.attrs, values.shape[1])
        if titles:
            self.leaves += [(f"{name}.{t}", _aside(values[:, k])) for k, t in enumerate(titles)]
            return
        scaled = unpacked(values, item.attrs)
        # HDF5 keeps the order of dimensions of the writer, MATLAB's is the reverse.
        self.leaves.append((titled, _aside((values if scaled is None else scaled).T)))
        clock = clock_of_samples(item.attrs, values.size) if min(values.shape) == 1 < values.size else None
        if clock is not None:
            self.leaves.append((f"{name}_time", clock[:, None]))

    def _add_field(self, item: Any, name: str, field: str, values: np.ndarray) -> None:
        """Add a field of a table; those of a block of pandas by their titles, under the name of the frame."""
        is_block = field.startswith("values_block_")
        titles = titles_of_block(item.attrs, field, values.shape[1]) if is_block and values.ndim == 2 else []
        frame = name.removesuffix(".table")
        if titles:
            self.leaves += [(f"{frame}.{t}", _aside(np.atleast_2d(values[:, k]))) for k, t in enumerate(titles)]
            return
        index = name_of_index(item.parent.attrs) if field == "index" else ""
        self.left[_PICKLED] += math.prod(item.dtype[field].shape) if is_block else 0
        self.leaves.append((f"{frame}.{index}" if index else f"{name}.{field}", _aside(values)))


def _list_of_texts(item: Any, name: str) -> list[tuple[str, np.ndarray]]:
    """Return a list of texts of HDF5, the titles of a matrix perhaps; nothing where there are none or too many."""
    import h5py

    if not 1 < item.size <= MOST_FIELDS or h5py.check_string_dtype(item.dtype) is None:
        return []
    texts = []
    for row in range(item.size):  # one by one: each may lead to the same long text elsewhere in the file
        raw = item[row]
        if len(raw) > LONGEST_NAME:
            return []
        texts.append(raw.decode(errors="replace").strip())
    return [(name, np.array(texts))]


def _attribute(value: Any) -> str:
    """Return a text that HDF5 stores beside a dataset, in any of its ways; nothing where it is something else."""
    text = np.ravel(value)[0] if np.size(value) == 1 else ""
    text = text.decode(errors="replace") if isinstance(text, bytes) else text
    return text.strip() if isinstance(text, str) else ""


def _inside(group: Any, key: str) -> Any:
    """Return what a name of a group leads to; None where that is nothing, or in another file."""
    import h5py

    link = group.get(key, getlink=True)
    if isinstance(link, h5py.ExternalLink):
        return None
    try:
        return group[key]
    except KeyError:
        if isinstance(link, h5py.SoftLink):
            return None
        raise


def _text_hdf5(item: Any) -> str:
    """Return a text of MATLAB, stored as numbers of characters; nothing where it is something else."""
    if item.attrs.get("MATLAB_class", b"") not in (b"char", "char") or getattr(item, "size", 0) > 40:
        return ""
    return "".join(map(chr, np.ravel(item[()]))).strip()


def _recording(
    path: Path, leaves: list[tuple[str, np.ndarray]], objects: Sequence[str], left: Counter[str]
) -> RawRecording:
    notes = [ReadNote(what, path.name, count) for what, count in left.items() if count]
    if objects:
        shown = ", ".join(objects[:6]) + (" ..." if len(objects) > 6 else "")
        what = f"objects of MATLAB (timeseries, timetable, Dataset), which cannot be read outside it: {shown}"
        if not any(values.size > 1 and values.ndim <= 2 for _, values in leaves):
            advice = "In MATLAB, store their numbers: S.t = x.Time; S.vx = x.Data; save('log.mat', '-struct', 'S')."
            raise LogError(f"holds only {what}", where=path.name, advice=advice)
        note_once(notes, what, path.name, len(objects))
    return recording_of_vectors(
        path, leaves, notes, "Save the signals as vectors: save('log.mat', 't', 'vx', 'vy').", "vector"
    )
