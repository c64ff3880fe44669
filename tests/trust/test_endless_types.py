"""Types that hold each other, and packed recordings that never end, are refused soon and leave nothing behind."""

import os
import subprocess
import sys
import time
from pathlib import Path

import zstandard
from google.protobuf import descriptor_pb2

import tests.logs.readers_support as support
from split_cli.logs.readers import open_recording
from tests.trust.test_bombs import zeros_packed


def protobuf_schema(messages: dict[str, list[tuple[str, int, str]]]) -> bytes:
    """Return a set of files with one file of messages, each of fields with name, type and type name."""
    files = descriptor_pb2.FileDescriptorSet()
    file = files.file.add(name="evil.proto", package="evil", syntax="proto3")
    for message, fields in messages.items():
        described = file.message_type.add(name=message)
        for number, (name, kind, type_name) in enumerate(fields, 1):
            field = described.field.add(name=name, number=number, type=kind, label=1)
            if type_name:
                field.type_name = type_name
    return files.SerializeToString()


DOUBLE, MESSAGE = descriptor_pb2.FieldDescriptorProto.TYPE_DOUBLE, descriptor_pb2.FieldDescriptorProto.TYPE_MESSAGE


def opened(path: Path, messages: dict[str, list[tuple[str, int, str]]]) -> list[str]:
    """Return the channels of a recording of one message of the type Top."""
    schema = ("evil.Top", "protobuf", protobuf_schema(messages))
    support.write_mcap(path, schema, "protobuf", [("/top", 1, 1, b"")])
    begin = time.process_time()
    found = [info.name for info in open_recording(path).channels()]
    assert time.process_time() - begin < 5.0
    return found


def test_messages_of_protobuf_that_hold_each_other_end(tmp_path):
    endless = {
        "Top": [("x", DOUBLE, ""), ("a", MESSAGE, ".evil.Other"), ("b", MESSAGE, ".evil.Other")],
        "Other": [("y", DOUBLE, ""), ("c", MESSAGE, ".evil.Top"), ("d", MESSAGE, ".evil.Top")],
    }
    assert opened(tmp_path / "mutual.mcap", endless) == ["/top/x", "/top/a.y", "/top/b.y"]


def test_messages_of_protobuf_with_two_fields_a_level_are_refused_before_they_are_listed(tmp_path):
    wide = {
        f"Level{level}": [(name, MESSAGE, f".evil.Level{level + 1}") for name in ("a", "b")] for level in range(1, 24)
    }
    wide |= {"Top": [("a", MESSAGE, ".evil.Level1")], "Level24": [("x", DOUBLE, "")]}
    assert opened(tmp_path / "wide.mcap", wide) == ["/top"]  # the topic, and no number of it


def test_a_packed_recording_that_unpacks_beyond_its_bound_leaves_nothing_in_the_temporary_folder(tmp_path):
    path, temporary = tmp_path / "bomb.mcap.zstd", tmp_path / "temporary"
    temporary.mkdir()
    packed = zeros_packed(zstandard.ZstdCompressor().compressobj(), 80)
    assert len(packed) < 100_000
    path.write_bytes(packed)
    code = "import sys; from split_cli.cli.main import main; main(['info', sys.argv[1]])"
    environment = {**os.environ, "TMPDIR": str(temporary)}
    done = subprocess.run([sys.executable, "-c", code, path], env=environment, capture_output=True, text=True)
    assert done.returncode == 1 and done.stderr.startswith("split: ") and done.stderr.count("\n") == 1
    assert "unpacks into over 60 times its size" in done.stderr
    assert not [file for file in temporary.rglob("*") if file.is_file() and "compiled" not in str(file)]
