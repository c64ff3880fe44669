"""Finding the reader for a recording: by its first bytes, then by its suffix."""

import itertools
import os
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from split_cli.errors import LogError, NoRecordingError, NoTableError, SplitError
from split_cli.files import ScratchFolder, refuse_no_regular_file
from split_cli.logs.raw import RawRecording
from split_cli.logs.readers.aim import is_aim, open_aim
from split_cli.logs.readers.can import DATABASE_SUFFIXES, is_can_log, open_can
from split_cli.logs.readers.carmaker_erg import ERG_MAGIC, INFO_SUFFIX, open_erg
from split_cli.logs.readers.code_pages import utf_16_without_mark
from split_cli.logs.readers.definitions import Definitions
from split_cli.logs.readers.dialect import KNOWN_FORMATS, sniff
from split_cli.logs.readers.guard import GuardedRecording, guarded
from split_cli.logs.readers.ibt import is_ibt, open_ibt
from split_cli.logs.readers.json_rows import is_json, open_json
from split_cli.logs.readers.labelled_lines import is_labelled, open_labelled
from split_cli.logs.readers.line_protocol import is_line_protocol, open_line_protocol
from split_cli.logs.readers.lines_of_objects import form_of_objects, open_objects
from split_cli.logs.readers.messages import Container, MessageRecording
from split_cli.logs.readers.motec_ld import is_motec_ld, open_motec_ld
from split_cli.logs.readers.named_values import open_named_table, table_of_named_values
from split_cli.logs.readers.novatel import is_novatel, open_novatel
from split_cli.logs.readers.pi_toolbox import is_pi_toolbox, open_pi_toolbox
from split_cli.logs.readers.px4 import ULOG_MAGIC, open_ulog
from split_cli.logs.readers.rewritten_tables import is_rewritten, open_rewritten
from split_cli.logs.readers.rows_of_kinds import open_rows_of_kinds, titles_of_kinds
from split_cli.logs.readers.tdms import TDMS_MAGIC, open_tdms
from split_cli.logs.readers.unpacking import (
    PACKED_SUFFIXES,
    ZIP_MAGIC,
    UnpackedRecording,
    by_its_own_name,
    is_packed,
    plain_name,
    refuse_long_list,
    several_recordings,
    shown_members,
    unpacked_file,
    unzipped,
)
from split_cli.logs.readers.yaml_documents import is_yaml_documents, open_yaml_documents

_HEAD_BYTES = 4096
NETCDF_MAGIC = (b"CDF\x01", b"CDF\x02")
"""How a file of NetCDF begins in its classic forms."""
_MOST_LISTED = 2000
"""Files of a folder that are looked at to say what it holds [1]."""
LOG_SUFFIXES = tuple(
    """
    .mcap .bag .db3 .csv .txt .vbo .parquet .feather .mat .mf4 .mdf .blf .asc .trc .jsonl .ascii .lvm .tsv .arrow
    .npz .ibt .ld .erg .xrk .xrz .ulg .tdms .zip
    """.split()
    + list(PACKED_SUFFIXES)
)
"""How names of recordings end; of compressed files the ending before counts, too."""
_FOREIGN_MAGIC = (
    (b"#ROSBAG V1", "a ROS 1 bag of version 1", "Convert it with `rosbag fix` or `rosbag reindex`."),
    (b"\xa3\x95\x80\x80", "an ArduPilot log", "Convert it to a CSV for each message with mavlogdump, for --together."),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive", "Unpack it, or pack it as .zip."),
    (b"Rar!\x1a\x07", "a RAR archive", "Unpack it, or pack it as .zip."),
    (b"\x04\x22\x4d\x18", "compressed with lz4", "Unpack it with `lz4 -d`."),
    (b"|CF,", "an imc FAMOS file", "Export it as CSV or MAT."),
    *((begins, "XML", "Export it as CSV.") for begins in (b"<?xml", b"<kml", b"<gpx", b"<osm", b"<!DOCTYPE")),
    *(
        (talker, "a list of NMEA sentences", "They hold position and speed alone. Record a table, with a yaw rate.")
        for talker in (b"$GP", b"$GN")
    ),
)
_OTHERS = {
    ".drk": ("an AiM recording of the old kind", "Export it from RaceStudio as CSV."),
    ".rcz": ("a RaceChrono session", "Export it from the app as CSV v3."),
    ".fit": ("a FIT file", "Export it as CSV."),
    **dict.fromkeys((".pkl", ".pickle"), ("a pickle of Python", "Save it as Parquet or CSV.")),
    **dict.fromkeys((".xls", ".xlsb", ".ods"), ("a spreadsheet", "Save it as .xlsx, or export it as CSV.")),
}
"""Files that other programs write and that are not read, by suffix: what they are and the way out."""
_TABLE_SUFFIXES = (".csv", ".mat", ".vbo", ".mf4", ".parquet", ".bag", ".json", ".ibt")
_BINARY_SUFFIXES = {
    ".mcap": "an MCAP file",
    ".bag": "a ROS 1 bag",
    ".db3": "a rosbag2 database",
    ".parquet": "a Parquet file",
    ".feather": "a Feather file",
    ".arrow": "an Arrow file",
    ".mf4": "an MDF file",
    ".dat": "an MDF file",
    ".mdf": "an MDF file",
    ".mat": "a MAT file",
    ".ibt": "telemetry of iRacing",
    ".ld": "a MoTeC log",
    ".erg": "a result of CarMaker",
    ".ulg": "a log of PX4",
    ".tdms": "a TDMS file",
    **dict.fromkeys((".xrk", ".xrz"), "a recording of AiM"),
}


def open_recording(path: str | Path, *, message_paths: Sequence[str | Path] = ()) -> RawRecording:
    """Open a recording of any supported format.

    Parameters
    ----------
    path : path-like
        MCAP, rosbag2 folder or ``.db3``, ROS 1 ``.bag``, CSV, Racelogic .vbo, Parquet, Feather, MAT (v4, v5,
        v7.3), NumPy (.npz, .npy, a folder of arrays), iRacing .ibt, MoTeC .ld, CarMaker .erg, AiM .xrk, TDMS,
        ULog, MF4, and logs of CAN frames (BLF, ASC, candump, TRC, MF4 bus logging); any of them compressed, or
        in a zip archive.
    message_paths : sequence of path-like
        Folders of ``.msg`` files, for message types that the recording does not define, and CAN databases.

    Returns
    -------
    RawRecording
        Channels are listed without decoding; see `split_cli.logs.raw.RawRecording`.

    Raises
    ------
    LogError
        If it does not exist, is empty, is of no known format, or nothing in it can be read.
    """
    path = Path(path)
    refuse_no_regular_file(path, LogError)
    for definitions in message_paths:
        if not os.path.exists(definitions):
            advice = "Name a folder of .msg files, or a DBC file."
            raise LogError("is not there, or closed to you", where=str(definitions), advice=advice)
    return GuardedRecording(guarded(path, lambda: _open(path, message_paths)))


def open_parts(path: str | Path, *, message_paths: Sequence[str | Path] = ()) -> list[RawRecording]:
    """Open the recordings that are parts of one drive: those of an archive, or the one that a file is.

    Raises
    ------
    LogError
        As `open_recording`.
    """
    path = Path(path)
    if not guarded(path, lambda: _is_archive(path)):
        return [open_recording(path, message_paths=message_paths)]

    def opened() -> list[RawRecording]:
        scratch = ScratchFolder()
        found = _recordings_in(path, scratch.path)
        return [_from_copy(path, copy, scratch, message_paths, alone=len(found) == 1) for copy in found]

    return [GuardedRecording(part) for part in guarded(path, opened)]


def is_log(path: Path, suffixes: Sequence[str] = LOG_SUFFIXES) -> bool:
    """Tell whether a file is of one of the kinds; a text must hold rows of numbers, and JSON a list of objects.

    Settings are written as one object. Phones write a table about the device beside those of their sensors. An
    archive must hold such a file.
    """
    kind = path.suffix.lower()
    if kind == ".json":
        # Of another file system the content is not looked at, and none is taken there.
        return ".jsonl" in suffixes and path.is_file() and _is_list_of_rows(path)
    if not has_ending(path.name, suffixes):
        return False
    if kind == ".zip":
        return path.is_file() and any(has_ending(name, LOG_SUFFIXES) for name in shown_members(path))
    return not (kind in (".txt", ".csv") and path.is_file() and is_prose(path))


def has_ending(name: str, suffixes: Sequence[str]) -> bool:
    """Tell whether a name ends in one of `suffixes`; that of a compressed file, whether the one before does, too."""
    name = name.lower()
    plain = plain_name(name)
    if plain != name:
        return name.removeprefix(plain) in suffixes and plain.endswith(tuple({*suffixes} - {*PACKED_SUFFIXES, ".zip"}))
    return name.endswith(tuple(suffixes))


def is_prose(path: Path) -> bool:
    """Tell a text that is no recording, such as a README.txt beside logs: it holds no rows of numbers.

    A table of titles alone is a recording that ended before it began.
    """
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
        known = (
            is_can_log(path, head)
            or bool(form_of_objects(head))
            or is_novatel(head)
            or is_pi_toolbox(head)
            or is_json(head)
            or is_labelled(head)
        )
        known = known or titles_of_kinds(head) is not None or is_line_protocol(head) or is_yaml_documents(head)
        if not (known or table_of_named_values(head) or is_rewritten(path)):
            sniff(path)
    except NoTableError:
        return bool(head) and not holds_titles_alone(path)
    except (LogError, OSError):
        pass
    return False


def _is_list_of_rows(path: Path) -> bool:
    """Tell a JSON file that is a list of objects by its beginning; one object may be settings."""
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except OSError:
        return False
    return is_json(head) and head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"[")


def holds_titles_alone(path: Path) -> bool:
    """Tell a table of one line, such as that of a sensor that recorded nothing."""
    with path.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
    return path.suffix.lower() == ".csv" and bool(head) and b"\n" not in head.strip()


def _open(path: Path, message_paths: Sequence[str | Path]) -> RawRecording:
    if path.is_dir() or path.name == "metadata.yaml":
        return _open_folder(path if path.is_dir() else path.parent, message_paths)
    if not path.exists():
        raise LogError("does not exist", where=str(path), advice=_neighbours(path))
    return _open_file(path, message_paths)


def _open_file(path: Path, message_paths: Sequence[str | Path]) -> RawRecording:
    with path.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
    if not head:
        raise LogError("is empty", where=path.name, advice="Record it again.")
    opened = _open_by_content(path, head, message_paths)
    if opened is not None:
        return opened
    what, advice = _OTHERS.get(path.suffix.lower(), ("", ""))
    if what and (b"\0" in head or head.startswith((b"PK", b"\x80", b"<h"))):
        raise LogError(f"is {what}, which is not read", where=path.name, advice=advice)
    for magic, what, advice in _FOREIGN_MAGIC:
        if head.startswith(magic):
            raise LogError(f"is {what}, which is not read", where=path.name, advice=advice)
    if head[257:262] == b"ustar":
        raise LogError("is a tar archive, which is not read", where=path.name, advice="Unpack it with `tar -xf`.")
    called = _BINARY_SUFFIXES.get(path.suffix.lower())
    if called and path.suffix.lower() != ".dat":
        raise LogError(
            f"is named like {called} but does not begin like one", where=path.name, advice="Copy or record it again."
        )
    if b"\0" in head and not head.startswith((b"\xff\xfe", b"\xfe\xff")) and not utf_16_without_mark(head):
        raise LogError("is of no known format", where=path.name, advice=KNOWN_FORMATS)
    from split_cli.logs.readers.delimited import open_delimited

    return open_rewritten(path) or open_delimited(path)


def _open_by_content(path: Path, head: bytes, message_paths: Sequence[str | Path]) -> RawRecording | None:
    if head.startswith(b"\x89MCAP0\r\n"):
        from split_cli.logs.readers.mcap import McapContainer

        return _messages(path, McapContainer(path), message_paths)
    if head.startswith(b"SQLite format 3\0"):
        from split_cli.logs.readers.rosbag2 import SqliteContainer
        from split_cli.logs.readers.sqlite_tables import is_rosbag2, open_sqlite

        if path.suffix.lower() != ".db3" and not is_rosbag2(path):
            return open_sqlite(path)

        return _messages(path, SqliteContainer(path), message_paths)
    if head.startswith(b"#ROSBAG V2.0\n"):
        from split_cli.logs.readers.bag1 import Bag1Container

        return _messages(path, Bag1Container(path), message_paths)
    if is_packed(head):
        return _open_packed(path, message_paths)
    databases = [Path(p) for p in message_paths if Path(p).suffix.lower() in DATABASE_SUFFIXES]
    if head.startswith((b"MDF     ", b"UnFinMF ")):
        from split_cli.logs.readers.mf4 import open_mf4

        return open_mf4(path, databases)
    if is_can_log(path, head):
        return open_can(path, databases)
    from split_cli.logs.readers.parquet import STREAM, open_arrow, open_parquet

    if head.startswith((b"PAR1", b"ARROW1\0\0", STREAM)):
        return open_parquet(path) if head.startswith(b"PAR1") else open_arrow(path)
    lowered = head.lower()
    if b"[column names]" in lowered or (path.suffix.lower() == ".vbo" and b"[header]" in lowered):
        from split_cli.logs.readers.vbo import open_vbo

        return open_vbo(path)
    if head.startswith(b"\x93NUMPY"):
        from split_cli.logs.readers.numpy_arrays import open_npy

        return open_npy(path)
    if head.startswith(ZIP_MAGIC):
        refuse_long_list(path)
        from split_cli.logs.readers.numpy_arrays import is_npz, open_npz

        if is_npz(path, head):
            return open_npz(path)
        from split_cli.logs.readers.spreadsheet import is_spreadsheet, open_spreadsheet

        return open_spreadsheet(path) if is_spreadsheet(path, head) else _open_archive(path, message_paths)
    if head.startswith(NETCDF_MAGIC):
        from split_cli.logs.readers.netcdf_classic import open_netcdf_classic

        return open_netcdf_classic(path)
    if path.suffix.lower() == ".ibt" and is_ibt(path, head):
        return open_ibt(path)
    if is_motec_ld(path, head):
        return open_motec_ld(path)
    if head.startswith(ERG_MAGIC):
        return open_erg(path)
    if is_aim(path, head):
        return open_aim(path)
    if head.startswith((ULOG_MAGIC, TDMS_MAGIC)):
        return open_ulog(path) if head.startswith(ULOG_MAGIC) else open_tdms(path)
    if is_pi_toolbox(head):
        return open_pi_toolbox(path)
    if is_json(head):
        return open_json(path)
    if (places := table_of_named_values(head)) is not None:
        return open_named_table(path, places)
    if is_novatel(head):
        return open_novatel(path)
    if form := form_of_objects(head):
        return open_objects(path, form)
    if is_line_protocol(head):
        return open_line_protocol(path)
    if is_labelled(head):
        return open_labelled(path)
    if is_yaml_documents(head):
        return open_yaml_documents(path)
    if (kinds := titles_of_kinds(head)) is not None:
        return open_rows_of_kinds(path, *kinds)
    # Version 4 has no magic number; its reader tells whether it is one.
    if head.startswith(b"MATLAB 5.0 MAT-file") or (path.suffix.lower() == ".mat" and not _is_hdf5(head)):
        from split_cli.logs.readers.mat import open_mat

        return open_mat(path)
    if _is_hdf5(head):
        from split_cli.logs.readers.mat import open_mat_hdf5

        return open_mat_hdf5(path)
    return None


def _open_packed(path: Path, message_paths: Sequence[str | Path]) -> RawRecording:
    scratch = ScratchFolder()
    return _from_copy(path, unpacked_file(path, scratch.path), scratch, message_paths)


def _open_archive(path: Path, message_paths: Sequence[str | Path]) -> RawRecording:
    scratch = ScratchFolder()
    found = _recordings_in(path, scratch.path)
    if len(found) > 1:
        raise several_recordings(path, [copy.relative_to(scratch.path).as_posix() for copy in found])
    return _from_copy(path, found[0], scratch, message_paths)


def _from_copy(
    path: Path, copy: Path, scratch: ScratchFolder, message_paths: Sequence[str | Path], *, alone: bool = True
) -> UnpackedRecording:
    """Open what was unpacked; it may not be packed again. If it was there `alone`, its name is that of the file."""
    place = copy.relative_to(scratch.path).as_posix()
    called = path.name if alone else place
    name = f"{path.name}/{place}" if _is_archive(path) else path.name
    try:
        if copy.is_dir():
            return UnpackedRecording(_open_folder(copy, message_paths), path, called, scratch)
        with copy.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
        if is_packed(head) or _is_archive(copy):
            raise LogError("is packed twice", where=name, advice="Unpack it once.")
        return UnpackedRecording(_open_file(copy, message_paths), path, called, scratch)
    except SplitError as error:
        raise by_its_own_name(error, copy, name) from error


def _recordings_in(path: Path, folder: Path) -> list[Path]:
    """Unpack the recordings of an archive into a folder; return them: files, and folders of rosbag2.

    Raises
    ------
    LogError
        If there is none.
    """
    files = unzipped(path, folder, lambda name: _may_be_read(PurePosixPath(name)))
    bags = {file.parent for file in files if file.name == "metadata.yaml"}
    alone = [file for file in files if not bags & {*file.parents}]
    logs = alone if len(files) == 1 else [file for file in alone if is_log(file)]
    if not (bags or logs):
        advice = "Unpack it, and name the recording."
        raise LogError("is an archive without a recording in it", where=path.name, advice=advice)
    return sorted([*bags, *logs])


def _may_be_read(place: PurePosixPath) -> bool:
    beside = place.name == "metadata.yaml" or place.suffix.lower() in (".json", INFO_SUFFIX)
    return beside or has_ending(place.name, LOG_SUFFIXES)


def _is_archive(path: Path) -> bool:
    """Tell a zip archive that is no file of NumPy or Excel."""
    from split_cli.logs.readers.numpy_arrays import is_npz
    from split_cli.logs.readers.spreadsheet import is_spreadsheet

    if not path.is_file():
        return False
    with path.open("rb") as stream:
        head = stream.read(len(ZIP_MAGIC))
    if head == ZIP_MAGIC:
        refuse_long_list(path)
    return head == ZIP_MAGIC and not is_npz(path, head) and not is_spreadsheet(path, head)


def _is_hdf5(head: bytes) -> bool:
    # MATLAB puts 512 bytes of its own before the HDF5 file.
    return any(head[start : start + 8] == b"\x89HDF\r\n\x1a\n" for start in (0, 512))


def _open_folder(path: Path, message_paths: Sequence[str | Path]) -> RawRecording:
    from split_cli.logs.readers.rosbag2 import open_rosbag2_folder

    try:
        return _messages(path, open_rosbag2_folder(path), message_paths)
    except NoRecordingError as error:
        from split_cli.logs.readers.numpy_arrays import is_array_folder, open_array_folder

        advice = _advice_on_pieces(path)
        if not advice and is_array_folder(path):
            return open_array_folder(path)
        advice = advice or _advice_on_tables(path)
        if not advice:
            raise
        raise LogError("is a folder of pieces, not one recording", where=str(path), advice=advice) from error


def _advice_on_pieces(folder: Path) -> str:
    """Say how the pieces of a data set in a folder become one table; empty where it holds none."""
    files = [file for file in itertools.islice(folder.rglob("*"), _MOST_LISTED) if file.is_file()]
    texts = [file for file in files if file.suffix == ".txt" and file.stem.isdigit()]
    if len(texts) > 1:
        return (
            f"It holds {len(texts)} or more numbered texts such as {texts[0].name}. Join them in their order into "
            "one table: a first line of titles with units, a column of time, and a line for each text."
        )
    return ""


def _advice_on_tables(folder: Path) -> str:
    """Name what may be recordings of their own in a folder; empty where it holds none."""
    files = [file for file in itertools.islice(folder.rglob("*"), _MOST_LISTED) if file.is_file()]
    tables = sorted(str(file.relative_to(folder)) for file in files if file.suffix.lower() in _TABLE_SUFFIXES)
    if not tables:
        return ""
    named = f"{', '.join(tables[:2])}{' and others' * (len(tables) > 2)}"
    return f"It holds {named}: name one of them, or the parts of one drive with --together."


def _messages(path: Path, container: Container, message_paths: Sequence[str | Path]) -> RawRecording:
    folders = [p for p in message_paths if Path(p).suffix.lower() not in DATABASE_SUFFIXES]
    return MessageRecording(path, container, Definitions(folders))


def _neighbours(path: Path) -> str:
    from split_cli.errors import nearest_names

    folder = path.parent
    if not folder.is_dir():
        return f"The folder {folder} does not exist either."
    names = [entry.name for entry in folder.iterdir()][:500]
    same = [name for name in names if name.lower().endswith(path.suffix.lower())]
    return nearest_names(path.name, same) if same else f"No file in {folder} ends in {path.suffix}."
