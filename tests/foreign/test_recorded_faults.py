"""The study of known faults in recordings deals a drive as it says, and fixes lists of faults that exist."""

import numpy as np
import pytest

from split_cli.proof.injection import FAULTS
from tests.factories import make_drive
from tests.studies.changing_faults import CHANGING
from tests.studies.recorded_faults import AGAINST, DRIVES, dealt
from tests.studies.recorded_faults_lists import LISTS, drawn_list


@pytest.mark.parametrize("split", ["halves", "blocks", "blocks 6", "swapped halves"])
def test_two_parts_have_each_sample_once(split):
    drive = make_drive(segments=10)
    one, other = dealt(drive, split)
    assert sorted([*one["t"], *other["t"]]) == sorted(drive["t"])
    assert (one["t"][0] < other["t"][0]) != split.startswith("swapped")


def test_thirds_leave_the_middle_out():
    one, other = dealt(drive := make_drive(segments=12), "thirds")
    middle = ~np.isin(drive["t"], [*one["t"], *other["t"]])
    assert np.ptp(drive["t"][middle]) == pytest.approx(20.0, abs=1.1)


def named(pair):
    recording, split = pair.split(", ")
    return [recording, split] if split.startswith(AGAINST) else [recording]


def test_each_row_of_a_list_names_a_recording_and_a_fault():
    for rows in LISTS.values():
        assert {one.split("=")[0] for row in rows for one in row.fault.split(" + ")} <= {"none", *FAULTS, *CHANGING}
        assert {one.removeprefix(AGAINST) for row in rows for one in named(row.pair)} <= set(DRIVES)
        assert len(set(rows)) == len(rows)


def test_a_drawn_list_puts_faults_into_each_recording_in_turn():
    rows = drawn_list(3, len(DRIVES), [*DRIVES])
    assert rows == drawn_list(3, len(DRIVES), [*DRIVES]) != drawn_list(4, len(DRIVES), [*DRIVES])
    assert {named(row.pair)[0] for row in rows} == set(DRIVES)
    faults = [row.fault.split(" + ") for row in rows]
    assert [len(one) for one in faults] == [1, 1, 2] * len(DRIVES)
    assert {name for one in faults for name in one} <= {"none", *FAULTS}
    # A sensor reads what the car does, so its fault is put in last.
    assert not [one for one in faults if one[-1] in ("heavier", "steering scaled") and one[0].startswith("velocity")]
