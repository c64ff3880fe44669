"""A trained set that was forged, with a digest that fits, is refused before anything is computed with it."""

import json
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from split_cli.errors import SetError
from split_cli.learning.cells import extend, recompute_gains, without_points
from split_cli.learning.label_sums import SUMS, check_sums
from split_cli.learning.training_set import read_set, write_set, wrong_gains
from split_cli.workflows.verifying.verify import verify
from tests.factories import make_labels, make_training_set, write_forged_set
from tests.studies.forged import HEADERS, POINTS, at


@pytest.fixture(scope="module")
def sound():
    return make_training_set()


FORGED = {
    "horizon below zero": at("horizon", value=-1.0),
    "horizon of nothing": at("horizon", value=0.0),
    "endless horizon": at("horizon", value=1e9),
    "horizon in words": at("horizon", value="0.05"),
    "capacity of nothing": at("capacity", value=0),
    "capacity beyond use": at("capacity", value=10**9),
    "threshold beyond a gain": at("threshold", value=2.0),
    "edges of next to nothing": at("grid", "edges", value=[1e-9, 1e-9, 1e-9]),
    "too few edges": at("grid", "edges", value=[0.02]),
    "bounds the wrong way": at("grid", "lower", value=[1.0, 1.0, 2.0]),
    "no bounds": at("grid", "lower", value=[None, None, None]),
    "kernel of another length": at("kernel", "length_scales", value=[0.04]),
    "counts below zero": at("counts", "points", value=-5),
    "counts of another set": at("counts", "cells", value=1),
    "samples below zero": at("sources", 0, "samples", value=-5),
    "digest of another vehicle": at("vehicle_digest", value="0" * 64),
    "no drives": at("sources", value=[]),
    "mass of no car": at("vehicle", "mass", value=1e308),
    "region of no size": at("region", "alpha_max", value=-0.1),
    "kernel of another shape": at("kernel", "noise_variance", value=[[1.0], [1.0], [1.0]]),
    "kernel in one word": at("kernel", "length_scales", value="0.5"),
    "length scale in words": at("kernel", "length_scales", value=["0.5", 1.0, 1.0]),
    "trust in words": at("trust", "share", value=["0.5", 1.0, 1.0]),
    "blocks below zero": at("trust", "blocks", value=-5),
    "plain in words": at("plain", value="no"),
    "drive of no name": at("sources", 0, "name", value=5),
    "drive of an endless name": at("sources", 0, "name", value="x" * 100_000),
    "digest that is none": at("sources", 0, "sha256", value=None),
    "reasons below zero": at("sources", 0, "rejected", value={"speed": -5}),
    "reasons that are none": at("sources", 0, "rejected", value="many"),
    "more updates than labels": at("sources", 0, "insertions", value=10**30),
    "endless label interval": at("sources", 0, "horizon", value=1e300),
    "time in words": at("sources", 0, "start_time", value="noon"),
}


@pytest.mark.parametrize("kind", FORGED)
def test_a_header_that_no_training_leaves_is_refused(sound, tmp_path, kind):
    write_forged_set(sound, tmp_path / "forged.split", FORGED[kind])
    with pytest.raises(SetError) as refused:
        read_set(tmp_path / "forged.split")
    assert "digest in it" not in str(refused.value)


@pytest.mark.parametrize("name", ["z", "y", "gamma", "t"])
def test_points_that_are_no_numbers_are_refused(sound, tmp_path, name):
    values = getattr(sound, name).copy()
    values.flat[0] = np.nan
    write_set(replace(sound, **{name: values}), tmp_path / "a.split")
    with pytest.raises(SetError, match="not finite"):
        read_set(tmp_path / "a.split")


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("gamma 0.5", "gains of"),
        ("gamma 1e+300", "gains of"),
        ("length_scales 10", "gains of"),
        ("length_scales 1e+20", "gains of"),
        ("length_scales 1e-299", "gains of"),
        ("length_scales 1e+299", "none is possible"),
        ("doubt 1e+299", "none is possible"),
        ("noise_variance 1e+299", "none is possible"),
        ("region 1e-09", "outside their cells"),
        ("y 1e+300", "none is possible"),
        ("t 1e+300", "none is possible"),
        ("rows below zero", "rows below zero"),
        ("information nan", "not finite"),
        ("absorbed inf", "not finite"),
        ("information 1e+300", "labels beside its points"),
        ("information -1e+15", "of any labels"),
        ("information 0", "of any labels"),
        ("information times 0.5", "of any labels"),
        ("information times 2", "labels beside its points"),
        ("information not symmetric", "of any labels"),
        ("information cut", "cannot reshape"),
        ("absorbed cut", "cannot reshape"),
        ("absorbed 1e+300", "of any labels"),
        ("absorbed 0", "of any labels"),
        ("absorbed times 2", "of any labels"),
        ("absorbed moved", "of any labels"),
        ("start time 1e299", "there is no time"),
        ("duration 1e299", "duration of source 0"),
    ],
)
def test_numbers_that_no_training_leaves_are_refused(sound, tmp_path, kind, says):
    if kind in HEADERS:
        write_forged_set(sound, tmp_path / "a.split", HEADERS[kind])
    else:
        write_set(POINTS[kind](sound), tmp_path / "a.split")
    with pytest.raises(SetError, match=says):
        read_set(tmp_path / "a.split")


@pytest.mark.parametrize(("capacity", "cells", "threshold"), [(3, 2.0, 1e-3), (10, 200.0, 1e-3), (10, 8.0, 1e-9)])
def test_sums_over_labels_that_training_leaves_are_taken(sound, capacity, cells, threshold):
    # Cells that replace points and hand their labels over, and cells at the edge of singular.
    kernel = replace(sound.kernel, length_scales=cells * np.array(sound.grid.edges))
    z = np.repeat(sound.z[:100], 60, axis=0)
    z += np.random.default_rng(1).normal(0.0, 0.2, z.shape) * sound.grid.edges
    labels = make_labels(z, np.sin(20.0 * z), sound.vehicle)
    empty = replace(without_points(sound), capacity=capacity, threshold=threshold, kernel=kernel)
    learned = extend(empty, [labels])
    assert learned.sources[0].accepted > 3000 > learned.size
    assert cells > 2.0 or learned.sources[0].replacements > 100
    points = {name: getattr(learned, name) for name in ("z", "y", *SUMS)}
    check_sums(kernel, points, learned.offsets, learned.sources[0].accepted)
    with pytest.raises(ValueError, match="labels beside its points"):
        points["information"] = 1.1 * points["information"]
        check_sums(kernel, points, learned.offsets, learned.sources[0].accepted)


def test_gains_are_those_of_the_definition_also_in_near_singular_cells(sound):
    # gamma_i is what the other points leave of a point's variance, by its definition point by point.
    cell = int(np.argmax(np.diff(sound.offsets)))
    z = sound.z[slice(*sound.offsets[cell : cell + 2])]
    for factor, near in ((1.0, False), (300.0, True)):
        kernel = replace(sound.kernel, length_scales=factor * sound.kernel.length_scales)
        one = replace(sound, kernel=kernel, z=z, offsets=np.array([0, len(z)]), cell_numbers=sound.cell_numbers[[cell]])
        K = kernel.correlation(z, z)
        others = [np.delete(np.arange(len(z)), i) for i in range(len(z))]
        defined = np.array([1.0 - K[i, o] @ np.linalg.solve(K[np.ix_(o, o)], K[o, i]) for i, o in enumerate(others)])
        assert wrong_gains(replace(one, gamma=defined)) == 0
        assert wrong_gains(replace(one, gamma=recompute_gains(one))) == 0
        assert (defined.min() < 1e-9) == near
        assert wrong_gains(replace(one, gamma=defined + 1e-3)) == len(z)


def test_of_large_cells_reading_computes_some_gains_and_verify_all(sound, tmp_path):
    # Beyond a number of kernel values each k-th cell is computed. A changed length scale is in all of them.
    write_forged_set(sound, tmp_path / "kernel.split", HEADERS["length_scales 10"])
    wrong = sound.gamma.copy()
    wrong[-1] += 1e-6
    write_set(replace(sound, gamma=wrong), tmp_path / "a.split")
    with pytest.raises(SetError, match=f"gains of 1 of {sound.size}"):
        read_set(tmp_path / "a.split")
    assert read_set(tmp_path / "a.split", kernel_numbers=sound.size // 2).size == sound.size
    for name, says in (("a.split", f"gains of 1 of {sound.size}"), ("kernel.split", "gains of")):
        with pytest.raises(SetError, match=says):
            verify(tmp_path / name)
    with pytest.raises(SetError, match="gains of"):
        read_set(tmp_path / "kernel.split", kernel_numbers=sound.size // 2)


def test_counts_of_drives_that_are_not_those_of_the_set_are_told(sound, tmp_path):
    last = replace(sound.sources[-1], points=sound.size + 1)
    for sources, passed in ((sound.sources, True), ((*sound.sources[:-1], last), False)):
        write_set(replace(sound, sources=sources), tmp_path / "a.split")
        assert [i.passed for i in verify(tmp_path / "a.split").items if i.check == "sources"] == [passed]


@pytest.mark.parametrize(
    ("name", "forged", "says"),
    [
        ("z", lambda z: z + 50.0, "outside their cells"),
        ("z", lambda z: np.full_like(z, 1e299), "outside their cells"),
        ("cell_numbers", lambda numbers: numbers + 2**62, "outside their cells"),
        ("cell_numbers", lambda numbers: numbers[::-1].copy(), "out of order"),
        ("cell_numbers", lambda numbers: np.full_like(numbers, numbers[0]), "out of order"),
    ],
)
def test_points_elsewhere_than_their_cells_are_refused(sound, tmp_path, name, forged, says):
    write_set(replace(sound, **{name: forged(getattr(sound, name))}), tmp_path / "a.split")
    with pytest.raises(SetError, match=says):
        read_set(tmp_path / "a.split")


def test_edges_that_hold_no_point_of_a_cell_are_refused(sound, tmp_path):
    write_forged_set(sound, tmp_path / "a.split", at("grid", "edges", value=[1e290] * 3))
    with pytest.raises(SetError, match="outside their cells"):
        read_set(tmp_path / "a.split")


def test_a_cell_with_more_points_than_it_may_keep_is_refused(sound, tmp_path):
    write_set(replace(sound, capacity=int(np.diff(sound.offsets).max()) - 1), tmp_path / "a.split")
    with pytest.raises(SetError, match="its capacity is"):
        read_set(tmp_path / "a.split")


def test_metadata_nested_without_end_are_refused(sound, tmp_path):
    from split_cli.errors import DriveError
    from split_cli.logs.drive import read_drive, write_drive
    from tests.factories import make_drive

    deep = {b"split": b"[" * 200_000}
    write_set(sound, tmp_path / "a.split")
    table = pa.ipc.open_file(tmp_path / "a.split").read_all().replace_schema_metadata(deep)
    with pa.ipc.new_file(tmp_path / "deep.split", table.schema) as writer:
        writer.write_table(table)
    with pytest.raises(SetError, match=r"deep\.split"):
        read_set(tmp_path / "deep.split")
    write_drive(make_drive(0, segments=1, seconds=1.0), tmp_path / "a.parquet")
    table = pa.parquet.read_table(tmp_path / "a.parquet").replace_schema_metadata(deep)
    pa.parquet.write_table(table, tmp_path / "deep.parquet")
    with pytest.raises(DriveError, match="nested too deeply"):
        read_drive(tmp_path / "deep.parquet")


@pytest.mark.parametrize(
    "change",
    [
        {"between": None},
        {"between": ["held"]},
        {"kinds": {"T": 5}},
        {"kinds": []},
        {"sources": [1]},
        {"sources": [{"name": "a", "sha256": None}]},
        {"vehicle": 5},
        {"conversions": [{}]},
        {"quality": []},
        {"noise": [{"channel": "vx", "sigma": "x", "sigma_raw": None, "autocorrelation": [1.0]}]},
        {"noise": [{"channel": "vx", "sigma": 1.0, "sigma_raw": None, "autocorrelation": 1.0}]},
        {"period": 10**400},
    ],
    ids=str,
)
def test_metadata_that_no_drive_has_are_refused(tmp_path, change):
    from split_cli.errors import DriveError
    from split_cli.logs.drive import read_drive, write_drive
    from tests.factories import make_drive

    write_drive(make_drive(0, segments=1, seconds=1.0), tmp_path / "a.parquet")
    table = pa.parquet.read_table(tmp_path / "a.parquet")
    told = {**json.loads(table.schema.metadata[b"split"]), **change}
    forged = table.replace_schema_metadata({b"split": json.dumps(told).encode()})
    pa.parquet.write_table(forged, tmp_path / "forged.parquet")
    with pytest.raises(DriveError, match="its metadata is damaged"):
        read_drive(tmp_path / "forged.parquet")
