"""Rows of any result as a DataFrame, checked against the rows themselves."""

import numpy as np

import split_cli
from split_cli.scoring.selection import SetCandidate
from split_cli.workflows.racing.result import Lap
from tests.optional import needed

needed("pandas")


def test_candidates_of_a_selection_become_rows_with_a_column_for_each_state():
    rng = np.random.default_rng(3)
    found = [
        SetCandidate("z2", capacity, 0.01, 1.0, 0.4, 0.0, 0.0, rng.uniform(0.1, 1.0, 3), 80.0, 20.0, 5.0, chosen=best)
        for capacity, best in ((5, False), (10, True))
    ]
    frame = split_cli.rows_table(found)
    assert list(frame["capacity"]) == [5, 10] and list(frame["chosen"]) == [False, True]
    states = frame[["rmse_0", "rmse_1", "rmse_2"]].to_numpy()
    np.testing.assert_array_equal(states, [one.rmse for one in found])


def test_laps_of_a_race_keep_their_names_and_what_is_missing():
    laps = [
        Lap(
            k,
            time,
            12.0,
            1.1,
            5,
            40,
            9,
            (0.3, 0.4, 0.5),
            (0.1, 0.2, 0.3),
            100,
            90,
            (1.0, 2.0, 3.0),
            (2.0,) * 3,
            (3.0,) * 3,
            0,
            0.0,
        )
        for k, time in enumerate((21.5, None))
    ]
    frame = split_cli.rows_table(laps)
    assert frame["time"].isna().tolist() == [False, True] and frame["solver_ms_1"].tolist() == [2.0, 2.0]
    assert len(split_cli.rows_table(())) == 0
