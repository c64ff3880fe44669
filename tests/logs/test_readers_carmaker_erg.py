"""Results of CarMaker: records written here beside their list of quantities come back; damaged ones are refused."""

import struct
import zipfile

import numpy as np
import pytest

from split_cli.errors import LogError
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.readers.opening import open_recording
from split_cli.workflows.sources import find_sources

NAMES = {"<f8": "Double", "<f4": "Float", "<i4": "Int", "<u2": "UShort", "<i1": "Char", "<u8": "ULongLong"}


def written(path, columns, big=False, info=None):
    """Write columns, name to (unit, values), with three bytes of filling behind the second, and their list."""
    lines = ["#INFOFILE1.1 - Do not remove this line!", "", "File.Format = erg", "File.DateInSeconds = 1597510788", ""]
    fields, number = [], 0
    for name, (unit, values) in columns.items():
        kind = values.dtype.str.replace(">", "<").replace("|", "<")
        number += 1
        lines += [f"File.At.{number}.Name = {name}", f"File.At.{number}.Type = {NAMES[kind]}"]
        lines += [f"Quantity.{name}.Unit = {unit}", ""] if unit else [""]
        fields.append((name, (">" if big else "<") + kind[1:]))
        if number == 2:
            number += 1
            lines += [f"File.At.{number}.Name = $none$", f"File.At.{number}.Type = 3 Bytes", ""]
            fields.append(("$none$", "V3"))
    lines += ["Anim.Msg.0.Data:", "\tSallxOCeij7BhwiyvprdHWPz3Y5JqWXQ", "Testrun = Lap", *(info or [])]
    table = np.zeros(len(values), np.dtype(fields))
    for name, (_, values) in columns.items():
        table[name] = values
    head = struct.pack("<8sBBHI", b"CM-ERG", 1, big, table.itemsize, 0)
    path.write_bytes(head + table.tobytes())
    path.with_name(path.name + ".info").write_text("\n".join(lines) + "\n")
    return head + table.tobytes()


def lap(seconds=40.0):
    t = np.arange(0.0, seconds, 0.02)
    v, r = 20.0 + 5.0 * np.sin(0.3 * t), 0.3 * np.sin(0.7 * t)
    return {
        "Time": ("s", t),
        "Car.v": ("m/s", v.astype("f4")),
        "Vhcl.YawRate": ("rad/s", r.astype("f4")),
        "Car.ay": ("m/s^2", (v * r).astype("f4")),
        "Driver.GearNo": ("", np.full(len(t), 3, "i4")),
        "Flags": ("-", np.arange(len(t)).astype("u2")),
    }


@pytest.mark.parametrize("big", [False, True])
def test_what_was_written_comes_back_with_units(big, tmp_path):
    made = lap()
    written(tmp_path / "a.erg", made, big)
    recording = open_recording(tmp_path / "a.erg")
    assert [c.name for c in recording.channels()] == list(made)
    units = {c.name: c.unit for c in recording.channels()}
    assert units["Car.v"] == "m/s" and units["Car.ay"] == "m/s^2" and units["Driver.GearNo"] is None
    for name, signal in recording.read(list(made)).items():
        np.testing.assert_array_equal(signal.values, made[name][1].astype(float))
    draft = draft_map(recording)
    assert draft.of("vx").sources == ("Car.v",) and draft.of("r").sources == ("Vhcl.YawRate",)


def test_factors_and_offsets_of_the_list_are_applied(tmp_path):
    info = ['"Quantity.Flags.Factor" = 0.5', "Quantity.Flags.Offset = -1", "Quantity.Driver.GearNo.Factor = nonsense"]
    written(tmp_path / "a.erg", lap(), info=info)
    found = open_recording(tmp_path / "a.erg").read(["Flags", "Driver.GearNo"])
    np.testing.assert_array_equal(found["Flags"].values, 0.5 * np.arange(2000) - 1.0)
    np.testing.assert_array_equal(found["Driver.GearNo"].values, 3.0)


def test_a_folder_or_an_archive_with_both_files_is_one_recording(tmp_path):
    written(tmp_path / "a.erg", lap(5.0))
    assert [source.place for source in find_sources([tmp_path])] == ["a.erg"]
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for name in ("a.erg", "a.erg.info"):
            archive.write(tmp_path / name, f"results/{name}")
    assert len(open_recording(tmp_path / "a.zip").channels()) == 6


def test_records_without_their_list_or_with_another_are_refused(tmp_path):
    whole = written(tmp_path / "a.erg", lap(2.0))
    (tmp_path / "b.erg").write_bytes(whole)
    with pytest.raises(LogError, match=r"b\.erg: lacks its list of quantities, b\.erg\.info"):
        open_recording(tmp_path / "b.erg")
    listed = (tmp_path / "a.erg.info").read_text()
    for text, said in (
        (listed.replace("Type = Int", "Type = Double"), "lists records of 33 bytes"),
        (listed.replace("Type = Int", "Type = Quaternion"), "unknown type, 'Quaternion'"),
        ("", "lists records of 0 bytes"),
        ("".join(f"File.At.{k}.Name = c{k}\nFile.At.{k}.Type = Char\n" for k in range(20_001)), "20,000 columns"),
        ("".join(f"Quantity.c{k}.Unit = m\n" for k in range(60_003)), "20,000 columns"),
    ):
        (tmp_path / "b.erg.info").write_text(text)
        with pytest.raises(LogError, match=said):
            open_recording(tmp_path / "b.erg")


def test_a_cut_result_keeps_whole_records_and_counts_the_rest(tmp_path):
    whole = written(tmp_path / "a.erg", lap(2.0))
    (tmp_path / "a.erg").write_bytes(whole[:-10])
    recording = open_recording(tmp_path / "a.erg")
    (note,) = recording.notes
    assert {c.count for c in recording.channels()} == {99} and note.count == 29 - 10
    for length in (9, 16, 30):
        (tmp_path / "a.erg").write_bytes(whole[:length])
        with pytest.raises(LogError, match="a.erg"):
            open_recording(tmp_path / "a.erg")
