"""Names of vehicles, files and topics are others' text: a terminal shows them and does nothing else."""

import io
import os
import pty
import sys
from dataclasses import replace

import pytest

from split_cli.cli.verbosity import Shown
from split_cli.errors import spreadsheet_text
from split_cli.vehicle.parameters import write_vehicle
from tests.factories import road_car

HOSTILE = "\x1b]0;owned\x07\x1b[31m\u202egnp\x9b2J \U0001f697"
SHOWN = r"\x1b]0;owned\x07\x1b[31m\u202egnp\x9b2J \U0001f697".replace(r"\U0001f697", "\U0001f697")


def test_a_stream_shows_text_and_keeps_the_line_of_progress():
    stream = io.StringIO()
    shown = Shown(stream)
    assert shown.write(f"\r\x1b[K{HOSTILE}\n\ta\r\x1b[K") == len(HOSTILE) + 11
    assert stream.getvalue() == f"\r\x1b[K{SHOWN}\n\ta\\x0d\\x1b[K"


def test_the_name_of_a_vehicle_does_nothing_to_a_terminal(tmp_path):
    write_vehicle(replace(road_car(), name=HOSTILE), tmp_path / "car.yaml")
    process, terminal = pty.fork()
    if process == 0:
        os.execv(sys.executable, [sys.executable, "-m", "split_cli", "info", str(tmp_path / "car.yaml")])
    said = b""
    while True:
        try:
            part = os.read(terminal, 1 << 16)
        except OSError:  # the other end is closed
            break
        if not part:
            break
        said += part
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 0
    text = said.decode().replace("\r\n", "\n").replace("\r\x1b[K", "")
    assert SHOWN in text and all(line.isprintable() for line in text.split("\n"))


@pytest.mark.parametrize("name", ["=cmd|' /C calc'!A0", "+1", "-1", "@SUM(1)", "\t=1"])
def test_a_name_in_a_table_is_text_to_a_spreadsheet(name):
    assert spreadsheet_text(name)[0] in "'\\"
    assert spreadsheet_text("lap 2.parquet") == "lap 2.parquet"
