"""The study of the policy's numbers: one diagnosis for each altered number, and what it changes in words."""

from tests.studies import policy
from tests.studies.policy import Outcome, altered, read_rows, study, table


def test_numbers_are_altered_and_counts_stay_whole():
    assert [altered(3, 0.5), altered(1, 0.5), altered(3, 2.0), altered(0.3, 0.5)] == [2, 1, 6, 0.15]


def test_every_number_of_a_group_is_diagnosed_once_and_told(tmp_path, monkeypatch):
    level = policy.STANDARD.selection.level
    asked = []

    def diagnosed(folder, numbers):
        asked.append((folder.name, numbers.selection.level))
        names = "mass" if numbers.selection.level <= level else "nothing"
        return Outcome(
            f"mismatch: {names}", {"mass.scale": (1.0 if numbers.selection.level >= level else 1.02, 0.1)}, ""
        )

    monkeypatch.setattr(policy, "outcome_of", diagnosed)
    monkeypatch.setattr(
        policy, "deciding_numbers", lambda: [one for one in deciding if (one[0], one[1].name) == ("selection", "level")]
    )
    for _ in range(2):  # the second time all is there
        study(tmp_path, ["selection"], [3], tmp_path / "rows.csv")
    assert asked == [("0003", level), ("0003", level / 2.0), ("0003", 2.0 * level)]
    last = table(read_rows(tmp_path / "rows.csv")).splitlines()[-1]
    assert last == f"| `selection.level` | {level:g} | values by 0.2 s.e. | 1 of 1 decisions |"


deciding = list(policy.deciding_numbers())
