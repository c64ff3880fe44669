"""An MF4 whose channel groups run on four clocks: its drive beside asammdf's own resampling to one raster."""

import numpy as np
import yaml

from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.drafting.suggest import draft_map, render_draft
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from tests.logs.planted import PlantedDrive
from tests.optional import needed

#: Group: rate [Hz], time of its first sample [s], and signals with channel, unit, factor from SI and raw resolution.
GROUPS = (
    (100.0, 0.0, {"VehSpd": ("vx", "km/h", 3.6, 0.01), "WhlTqSum": ("T", "Nm", 1.0, 0.5)}),
    (200.0, 0.0013, {"YawRate": ("r", "deg/s", 180.0 / np.pi, 0.001), "LatAcc": ("ay", "m/s^2", 1.0, 1e-4)}),
    (50.0, 0.0071, {"RoadWheelAngle": ("delta", "deg", 180.0 / np.pi, 0.001)}),
    (20.0, 0.031, {"PosX": ("X", "m", 1.0, None), "PosY": ("Y", "m", 1.0, None), "LatVel": ("vy", "m/s", 1.0, 1e-5)}),
)


def written(path, car: PlantedDrive, asammdf) -> None:
    """Write integers with a linear conversion, as loggers do; each group has a clock with some jitter."""
    rng = np.random.default_rng(4)
    with asammdf.MDF(version="4.10") as file:
        for rate, first, signals in GROUPS:
            t = first + np.arange(round(60.0 * rate)) / rate
            t = t + rng.uniform(-0.05, 0.05, len(t)) / rate
            group = []
            for name, (channel, unit, factor, step) in signals.items():
                values = factor * car.at(channel, t)
                if step is None:
                    group.append(asammdf.Signal(values, t, name=name, unit=unit))
                    continue
                whole, linear = np.round(values / step).astype(np.int32), {"a": step, "b": 0.0}
                group.append(asammdf.Signal(whole, t, name=name, unit=unit, conversion=linear))
            file.append(group)
        file.save(path, overwrite=True)


def test_groups_on_four_clocks_become_what_asammdf_resamples_them_to(tmp_path):
    asammdf = needed("asammdf")
    car = PlantedDrive(seconds=61.0)
    path = tmp_path / "drive.mf4"
    written(path, car, asammdf)
    recording = open_recording(path)
    signal_map = map_from_mapping(yaml.safe_load(render_draft(draft_map(recording), path.name)))
    made = assemble_drive(recording, signal_map, car.vehicle, IngestSettings(rate=20.0))
    drive, start = made.drive, made.quality.origin
    assert set(drive.columns) >= {"vx", "vy", "r", "T", "delta", "X", "Y", "ay"}
    assert not made.quality.consistency.findings
    with asammdf.MDF(path) as file:
        # One raster for all groups: the drive's instants. By default whole numbers would keep the sample before.
        file.configure(integer_interpolation=1, float_interpolation=1)
        resampled = file.resample(raster=start + drive["t"], time_from_zero=False)
        inside = slice(10, -10)
        for _, _, signals in GROUPS:
            for name, (channel, _, factor, _) in signals.items():
                theirs = resampled.get(name).samples.astype(float)[inside] / factor
                truth = car.at(channel, start + drive["t"][inside])
                spread = float(np.std(truth))
                # asammdf draws lines between samples and rounds to whole raw numbers again; ingest low-passes or takes
                # cubics. Of 0.6 Hz in steps of 0.05 s a line is off by (2 pi 0.6 0.05)^2/8 = 0.4 % of the amplitude.
                assert np.max(np.abs(drive[channel][inside] - theirs)) < 0.004 * spread, name
                ours_off, theirs_off = (float(np.std(v - truth)) for v in (drive[channel][inside], theirs))
                assert ours_off < 0.6 * theirs_off, name


def test_texts_bytes_and_whole_arrays_beside_the_numbers_do_not_end_ingest(tmp_path):
    """A gear in letters beside the speeds made ingest fail, and no map could leave it out."""
    asammdf = needed("asammdf")
    car, path = PlantedDrive(seconds=21.0), tmp_path / "drive.mf4"
    t = np.arange(0.0, 20.0, 0.02)
    array = np.array([(row,) for row in np.arange(3.0 * len(t)).reshape(-1, 3)], dtype=[("points", "<f8", (3,))])
    channels = ("vx", "vy", "r", "delta", "T")
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(car.at(channel, t), t, name=channel) for channel in channels])
        file.append([asammdf.Signal(np.array([b"D"] * len(t)), t, name="gear", encoding="utf-8")])
        file.append([asammdf.Signal(np.zeros((len(t), 8), np.uint8), t, name="payload")])
        file.append([asammdf.Signal(array, t, name="points")])
        file.save(path, overwrite=True)
    recording = open_recording(path)
    kinds = {info.name: info.type_name for info in recording.channels()}
    assert kinds["gear"] == kinds["payload"] == "text" and "points" not in kinds
    entries = {channel: {"source": channel} for channel in channels}
    made = assemble_drive(recording, map_from_mapping({"name": "own", "channels": entries}), car.vehicle)
    t_of_drive = made.quality.origin + made.drive["t"]
    assert np.abs(made.drive["r"] - car.at("r", t_of_drive)).max() < 1e-4
    assert "points[2]" in made.drive.columns and "gear" not in made.drive.columns
