"""Faults put into recordings: the term that names each undoes it, and blocks share no sample."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import SplitError
from split_cli.logs.drive import Drive, DriveMetadata, write_drive
from split_cli.proof.altered_car import ALTERATIONS
from split_cli.proof.injection import FAULTS, faults_for, faults_of_sizes, inject, split_in_blocks, split_in_halves
from split_cli.proof.outcome import Statement
from split_cli.proof.windows import errors_of_terms
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.proving.prove_recording import prove_recording
from tests.factories import one_run, road_car

VEHICLE = road_car()


@pytest.fixture(scope="module")
def drive() -> Drive:
    t = np.arange(12_000) * 0.01
    steer = 0.03 * np.sin(0.7 * t) + 0.01 * np.sin(2.9 * t + 1.0)
    columns = {
        "t": t,
        "X": 20 * t,
        "Y": 0 * t,
        "yaw": 0.1 * np.sin(0.3 * t),
        "vx": 20 + 3 * np.sin(0.2 * t),
        "vy": 0.3 * np.sin(0.7 * t),
        "ay": 5 * np.sin(0.7 * t),
        "r": 0.25 * np.sin(0.7 * t - 0.2),
        "T": 800 * np.sin(0.9 * t),
        "delta": steer,
    }
    kinds = {"T": "command", "delta": "command"}
    return one_run(columns, 0.01, "real", metadata=DriveMetadata(kinds=kinds))


# An accelerometer's bias leaves what the velocities tell, and another car drives elsewhere: see test_altered_car.
ELSEWHERE = {name for name, kind in FAULTS.items() if kind.term in {*ALTERATIONS, "acceleration_bias"}}


@pytest.mark.parametrize("name", sorted({*FAULTS} - ELSEWHERE))
def test_the_term_that_names_a_fault_undoes_it(name, drive):
    fault = next(f for f in faults_for(drive, VEHICLE, [name]) if f.term)
    faulty = inject(drive, fault)
    changed = [c for c in drive.columns if not np.array_equal(faulty[c], drive[c])]
    assert changed

    def errors(one, terms):
        return errors_of_terms({**one.columns, "s": one["t"] * 0.0}, VEHICLE, terms)

    term = fault.built()
    clean, repaired, broken = errors(drive, ()), errors(faulty, [term]), errors(faulty, ())
    # Delays interpolate between samples; a sine of 3 rad/s is then right to (3 x 0.01)^2/8 of itself.
    inner = slice(5, -5)
    scale = np.abs(broken - clean)[inner].max(axis=0)
    left = np.abs(repaired - clean)[inner].max(axis=0)
    assert (left <= 2e-3 * scale.max() + 1e-12).all(), f"{left} is left of {scale}"


def test_a_derived_torque_is_neither_scaled_nor_shifted(drive):
    metadata = DriveMetadata(kinds={"T": "derived: from acceleration"})
    derived = Drive("d", drive.columns, drive.segment, drive.period, metadata)
    assert "drive_gain" in {f.term for f in faults_for(drive, VEHICLE)}
    assert not {"drive_gain", "sensor_delay", "mass"} & {f.term for f in faults_for(derived, VEHICLE)}


def test_blocks_share_no_sample_and_are_far_from_each_other(drive):
    even, odd = split_in_blocks(drive, 10.0)
    assert not set(even["t"]) & set(odd["t"])
    assert len(even) + len(odd) == len(drive)
    assert len(even.segments()) == 6 and len(odd.segments()) == 6


def test_sizes_are_multiples_of_what_a_fault_does(drive):
    sizes = {"steer_gain": ("gain", 0.8), "steer_offset": ("offset", 0.01), "drive_gain": ("drive_gain", 0.5)}
    promised = {(term, name): value for term, (name, value) in sizes.items()}
    found = faults_of_sizes(faults_for(drive, VEHICLE), promised, (1.0, 2.0))
    sizes = {term: [f.value for f in found if f.term == term] for term in {f.term for f in found}}
    # A command over 0.8 is a quarter more than it was; twice that is a half more.
    assert sizes["steer_gain"] == pytest.approx([0.8, 1.0 / 1.5])
    assert sizes["steer_offset"] == pytest.approx([0.01, 0.02])
    # Nothing was promised of the others; the pair without a fault stays.
    assert set(sizes) == {"", *(term for term, _ in promised)}
    assert all(dict(f.parameters)["brake_gain"] == f.value for f in found if f.term == "drive_gain")


def test_halves_share_no_sample(drive):
    first, second = split_in_halves(drive)
    assert first["t"][-1] < second["t"][0] and len(first) + len(second) == len(drive)


def test_unknown_faults_and_short_drives_are_refused(drive):
    with pytest.raises(SplitError, match="steering"):
        faults_for(drive, VEHICLE, ["steering lat"])
    with pytest.raises(SplitError, match="blocks"):
        split_in_blocks(drive, 30.0)


def test_a_sensor_that_is_not_there_has_no_fault(drive):
    silent = Drive("d", {k: x for k, x in drive.columns.items() if k != "ay"}, drive.segment, 0.01, drive.metadata)
    felt = {"lateral acceleration biased", "reference moved"}
    assert felt <= {f.name for f in faults_for(drive, VEHICLE)}
    assert not felt & {f.name for f in faults_for(silent, VEHICLE)}
    biased = next(f for f in faults_for(drive, VEHICLE, ["lateral acceleration biased"]) if f.term)
    assert np.allclose(inject(drive, biased)["ay"] - drive["ay"], biased.value)


def test_a_fault_that_cannot_be_put_in_is_told_beside_the_others(drive, tmp_path, monkeypatch):
    # Nothing is diagnosed here: every pair is said to match.
    told = (Statement("match"), "match")
    monkeypatch.setattr("split_cli.workflows.proving.prove_recording.diagnose_pair", lambda *_: told)
    # Wheels that steer to the other side: no model of the car explains the drive.
    mirrored = replace(drive, columns={**drive.columns, "delta": -drive["delta"]})
    write_drive(mirrored, tmp_path / "drive.parquet")
    write_vehicle(VEHICLE, tmp_path / "car.yaml")
    rows = prove_recording(
        [tmp_path / "drive.parquet"], tmp_path / "car.yaml", tmp_path / "out", only=["less grip", "speed scaled"]
    )
    assert {row.outcome for row in rows if row.fault == "speed scaled"} == {"missed"}
    refused = [row for row in rows if row.fault == "less grip"]
    assert {row.outcome for row in refused} == {"not put in"} and all("explains" in row.said for row in refused)
