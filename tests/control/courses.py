"""A vehicle file, a small track, and a call of the command line, for the tests of races and manoeuvres."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.logs.drive import Drive

ROOT = Path(__file__).resolve().parents[2]
CAR = str(ROOT / "sample_logs" / "road_car.yaml")


def ring(folder: Path, radius_x: float = 28.0, radius_y: float = 14.0, half_width: float = 4.0) -> Path:
    angle = np.arange(80) * 2 * np.pi / 80
    rows = [f"{radius_x * np.cos(a):.3f},{radius_y * np.sin(a):.3f},{half_width},{half_width}" for a in angle]
    file = folder / "ring.csv"
    file.write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m\n" + "\n".join(rows))
    return file


def first_rows(drive: Drive, count: int) -> Drive:
    columns = {name: column[:count] for name, column in drive.columns.items()}
    return replace(drive, columns=columns, segment=drive.segment[:count])


def invoke(*words: object):
    """Run a command; several words may stand in one text."""
    return CliRunner().invoke(group, " ".join(map(str, words)).split())
