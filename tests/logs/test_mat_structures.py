"""MAT files of either kind whose structures have clocks of their own become one drive."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.drafting.suggest import draft_map, render_draft
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from tests.logs.planted import PlantedDrive

SHARES = {
    "gps": ("t", 1.0, 20.0, {"x": "X", "y": "Y"}),
    "imu": ("time_ms", 1e3, 100.0, {"yaw_rate": "r", "ax": "ax", "ay": "ay"}),
    "est": ("timestamp", 1.0, 50.0, {"vx": "vx", "vy": "vy", "yaw": "yaw"}),
    "can": ("Time", 1.0, 80.0, {"road_wheel_angle": "delta", "wheel_torque": "T"}),
}


@pytest.mark.parametrize("kind", ["5", "7.3"])
def test_structures_with_clocks_of_their_own_are_one_drive(tmp_path, kind):
    planted = PlantedDrive(seconds=60.0)
    content = {}
    for number, (name, (clock, scale, rate, fields)) in enumerate(SHARES.items()):
        # Each begins at another instant: rows of two structures never share a time.
        time = np.arange(0.003 * number, 60.0, 1.0 / rate)
        content[name] = {clock: scale * time, **{field: planted.at(c, time) for field, c in fields.items()}}
    path = tmp_path / "log.mat"
    if kind == "5":
        savemat(path, {"data": content})
    else:
        with h5py.File(path, "w", userblock_size=512) as file:
            for name, fields in content.items():
                for field, values in fields.items():
                    file.create_dataset(f"data/{name}/{field}", data=values[None, :])
        with open(path, "r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file".ljust(512, b" "))
    recording = open_recording(path)
    draft = draft_map(recording)
    assert {s.channel for s in draft.suggestions if s.status != "open"} == {
        "X", "Y", "r", "ax", "ay", "vx", "vy", "yaw", "delta", "T",
    }  # fmt: skip
    import yaml

    signal_map = map_from_mapping(yaml.safe_load(render_draft(draft, "log.mat")))
    made = assemble_drive(recording, signal_map, planted.vehicle, IngestSettings())
    assert made.drive.rate == pytest.approx(50.0)
    t = made.drive["t"] + made.quality.origin
    for channel, most in (("vx", 0.02), ("r", 2e-3), ("delta", 2e-3), ("ay", 0.05), ("yaw", 2e-3)):
        np.testing.assert_allclose(made.drive[channel][50:-50], planted.at(channel, t[50:-50]), atol=most)
