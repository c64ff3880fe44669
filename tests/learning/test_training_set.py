"""The set's file: bit-exact round trip, one batch a cell, and damage that is told, never learned from."""

import json
import os
from dataclasses import fields, replace

import numpy as np
import pyarrow as pa
import pytest

from split_cli.errors import SetError, SplitError
from split_cli.learning.cells import empty_set, extend
from split_cli.learning.training_set import SetFile, TrainingSet, read_set, write_set
from split_cli.vehicle.parameters import EffectSpec
from tests.factories import make_labels, make_training_set, road_car, smooth_residual, valid_features


@pytest.fixture(scope="module")
def trained() -> TrainingSet:
    car = road_car().with_effects(EffectSpec("aero_drag", {"drag": 0.08}))
    return make_training_set(0, 1500, vehicle=car)


def equal(a: TrainingSet, b: TrainingSet) -> bool:
    for field in fields(TrainingSet):
        mine, other = getattr(a, field.name), getattr(b, field.name)
        if isinstance(mine, np.ndarray):
            if mine.dtype != other.dtype or mine.shape != other.shape or mine.tobytes() != other.tobytes():
                return False
        elif field.name == "kernel":
            names = ("length_scales", "signal_variance", "noise_variance")
            if any(getattr(mine, n).tobytes() != getattr(other, n).tobytes() for n in names):
                return False
        elif mine != other:
            return False
    return True


def test_reads_back_what_was_written_bit_for_bit(trained, tmp_path):
    path = tmp_path / "car.split"
    write_set(trained, path)
    again = read_set(path)
    assert equal(trained, again)
    write_set(again, tmp_path / "again.split")
    assert path.read_bytes() == (tmp_path / "again.split").read_bytes()


def test_going_on_from_the_file_equals_never_having_stopped(trained, tmp_path):
    more = valid_features(trained.vehicle, trained.region, 800, seed=9, spread=0.1)
    labels = make_labels(more, smooth_residual(more), trained.vehicle)
    write_set(trained, tmp_path / "car.split")
    assert equal(extend(read_set(tmp_path / "car.split"), [labels]), extend(trained, [labels]))


def test_an_unbounded_grid_and_an_empty_set_survive(tmp_path):
    z1 = make_training_set(0, 100, "z1")
    write_set(z1, tmp_path / "z1.split")
    assert read_set(tmp_path / "z1.split").grid == z1.grid
    empty = empty_set(z1.vehicle, z1.features, z1.region, z1.grid, z1.kernel, horizon=0.05, forgetting=30.0)
    write_set(empty, tmp_path / "empty.split")
    again = read_set(tmp_path / "empty.split")
    assert equal(empty, again)
    assert again.forgetting == 30.0


def test_one_batch_a_cell_with_the_columns_of_the_contract(trained, tmp_path):
    path = tmp_path / "car.split"
    write_set(trained, path)
    with pa.memory_map(str(path)) as source:
        reader = pa.ipc.open_file(source)
        assert reader.schema.names == [
            "cell",
            "z_alpha_f",
            "z_alpha_r",
            "z_torque_ratio",
            "y_vx",
            "y_vy",
            "y_r",
            "gamma",
            "t",
            "source",
            "row",
        ]
        assert reader.num_record_batches == trained.cell_count
        for index in (0, 7, trained.cell_count - 1):
            cell = reader.get_batch(index)
            points = slice(trained.offsets[index], trained.offsets[index + 1])
            assert set(cell["cell"].to_pylist()) == {trained.cell_numbers[index]}
            np.testing.assert_array_equal(cell["z_torque_ratio"], trained.z[points, 2])
            np.testing.assert_array_equal(cell["row"], trained.row[points])
        stored = json.loads(reader.schema.metadata[b"split"])
    assert stored["counts"] == {"points": trained.size, "cells": trained.cell_count}
    assert str(tmp_path) not in json.dumps(stored)
    with SetFile(path) as file:
        assert file.header.kernel.origin == trained.kernel.origin


def test_every_point_lies_in_its_cell(trained):
    numbers = trained.grid.pack(trained.grid.index(trained.z)[0])
    np.testing.assert_array_equal(numbers, np.repeat(trained.cell_numbers, np.diff(trained.offsets)))


def test_a_truncated_file_is_refused_at_any_length(trained, tmp_path):
    whole = tmp_path / "whole.split"
    write_set(trained, whole)
    content = whole.read_bytes()
    cut = tmp_path / "cut.split"
    for length in [0, 1, 8, 100, *np.linspace(200, len(content) - 1, 25).astype(int)]:
        cut.write_bytes(content[:length])
        with pytest.raises(SetError, match="truncated|damaged"):
            read_set(cut)


def test_a_flipped_bit_is_an_error_or_without_effect(trained, tmp_path):
    """Padding may flip unseen; a value, a name or a number of the header never."""
    whole = tmp_path / "whole.split"
    write_set(trained, whole)
    content = bytearray(whole.read_bytes())
    rng = np.random.default_rng(3)
    flipped = tmp_path / "flipped.split"
    refused = 0
    for position in rng.integers(0, len(content), 150):
        damaged = bytearray(content)
        damaged[position] ^= 1 << int(rng.integers(8))
        flipped.write_bytes(damaged)
        try:
            assert equal(read_set(flipped), trained)
        except SetError:
            refused += 1
    assert refused > 30


def test_another_version_and_other_files_are_refused_with_advice(trained, tmp_path):
    whole, path = tmp_path / "whole.split", tmp_path / "car.split"
    write_set(trained, whole)
    with pa.memory_map(str(whole)) as source:
        reader = pa.ipc.open_file(source)
        table = reader.read_all()
        stored = json.loads(reader.schema.metadata[b"split"])

    def rewrite(change: dict) -> None:
        text = json.dumps({**stored, **change}).encode()
        changed = table.replace_schema_metadata({b"split": text})
        with pa.ipc.new_file(str(path), changed.schema) as writer:
            writer.write_table(changed)

    for change, message in (
        ({"format": "split-set/9"}, r"format 'split-set/9', this version reads 'split-set/3'.*split train"),
        ({"region": {"p": 1}}, "header is damaged"),
        ({"features": ["alpha_f"]}, "header is damaged"),
        ({"threshold": 0.5}, "a batch is not one cell|lacks its sums"),
    ):
        rewrite(change)
        with pytest.raises(SetError, match=message):
            read_set(path)
    path.write_bytes(b"PK\x03\x04 no such thing")
    with pytest.raises(SetError, match="not a whole trained set"):
        read_set(path)
    with pytest.raises(SetError, match="no such file"):
        read_set(tmp_path / "none.split")


def test_a_full_disk_at_the_last_moment_is_one_error(trained, tmp_path, monkeypatch):
    path = tmp_path / "car.split"
    write_set(trained, path)
    before = path.read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(SplitError, match="No space left on device"):
        write_set(replace(trained, horizon=0.1), path)
    assert path.read_bytes() == before
