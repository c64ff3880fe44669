"""How much each number of the diagnosis policy matters: halved and doubled, one at a time, on development cases.

    split prove generate FOLDER --seed 5 --cases 16
    python -m tests.studies.policy FOLDER --cases 3 9 10 --groups selection abstention -o rows.csv
    python -m tests.studies.policy FOLDER -o rows.csv --table docs/decisions/0031-sensitivity-of-the-policy.md

Rows that are in the file already are not computed again. What counts as a change: another verdict, other names or
another word about what has no name (a decision); values that move by more than a tenth of their standard error; or
anything else that `diagnosis.json` tells. "Never turned": no comparison came out otherwise (`probing.py`).
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from split_cli.diagnosis.engine import diagnose
from split_cli.diagnosis.policy import STANDARD, Policy, deciding_numbers
from split_cli.diagnosis.statement.document import diagnosis_to_text
from split_cli.diagnosis.together import use_threads
from split_cli.errors import SplitError
from split_cli.logs.drive import read_drive
from split_cli.vehicle.parameters import read_vehicle
from tests.studies.probing import outcomes

FACTORS = (0.5, 2.0)
MOVED = 0.1  # standard errors


@dataclass(frozen=True)
class Outcome:
    """What a diagnosis said.

    Attributes
    ----------
    decision : str
        Verdict, names, and the word about what has no name.
    values : dict of str to (float, float)
        Value and standard error of every parameter, by name.
    document : str
        Digest of all of `diagnosis.json` but its settings: places, intervals, alternatives, shares, leads.
    """

    decision: str
    values: dict[str, tuple[float, float]]
    document: str


def outcome_of(folder: Path, policy: Policy) -> Outcome:
    """Diagnose a shown case under a policy."""
    vehicle = read_vehicle(folder / "vehicle.yaml")
    simulated = [read_drive(folder / "sim.parquet")] if (folder / "sim.parquet").exists() else []
    try:
        told = diagnose([read_drive(folder / "real.parquet")], vehicle, simulated, policy=policy)
    except (SplitError, ArithmeticError, ValueError, IndexError) as error:
        return Outcome(f"error: {type(error).__name__}", {}, "")
    names = sorted(finding.term for finding in told.findings)
    values = {
        f"{finding.term}.{name}": (float(one.value), float(one.std_error or 0.0))
        for finding in told.findings
        for name, one in finding.parameters.items()
    }
    rest = " and something without a name" if told.unexplained else ""
    text = diagnosis_to_text(replace(told, settings={}))
    digest = hashlib.sha256(text.encode()).hexdigest()
    return Outcome(f"{told.verdict}: {', '.join(names) or 'nothing'}{rest}", values, digest)


def altered(value: float, factor: float) -> float:
    """Return a number times a factor; counts stay whole and at least 1."""
    return max(1, round(factor * value)) if isinstance(value, int) else factor * value


def with_numbers(numbers: dict[str, Any]) -> Policy:
    """Return the standard policy with other numbers, each by the name `group.number`."""
    policy = STANDARD
    for name, value in numbers.items():
        group, _, one = name.partition(".")
        policy = policy.altered(group, **{one: value})
    return policy


def study(folder: Path, groups: Sequence[str], cases: Sequence[int], rows: Path) -> None:
    """Run what is not in the file of rows yet, and add to it row by row, each as soon as it is known."""
    done = {tuple(row[:4]) for row in read_rows(rows)}
    with rows.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)

        def add(group: str, number: str, factor: float, case: int, outcome: Outcome, how: str) -> None:
            values = json.dumps(outcome.values)
            writer.writerow([group, number, factor, case, outcome.decision, values, outcome.document, how])
            file.flush()

        for case in cases:
            numbers = {
                f"{group}.{one.name}": {1.0: value, **{factor: altered(value, factor) for factor in left}}
                for group, one, value in deciding_numbers()
                if group in groups
                and (left := [f for f in FACTORS if (group, one.name, str(f), str(case)) not in done])
            }
            if not numbers:
                continue
            standard, turned = outcomes(
                lambda numbers, case=case: outcome_of(folder / "cases" / f"{case:04d}", with_numbers(numbers)),
                numbers,
                lambda name, factor, outcome, case=case: add(*name.split("."), factor, case, outcome, "run"),
            )
            for name, values in numbers.items():
                for factor in values:
                    if factor != 1.0 and (name, factor) not in turned:
                        add(*name.split("."), factor, case, standard, "never turned")
            if ("standard", "", "1.0", str(case)) not in done:
                add("standard", "", 1.0, case, standard, "run")


def read_rows(path: Path) -> list[list[str]]:
    """Return the rows of a file, none where it is not there."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


def largest_move(old: dict[str, list[float]], new: dict[str, list[float]]) -> float:
    """Return by how many of the old standard errors the values that both name moved, at most."""
    moves = [abs(new[name][0] - old[name][0]) / max(old[name][1], 1e-300) for name in old.keys() & new.keys()]
    return max(moves, default=0.0)


def table(rows: list[list[str]]) -> str:
    """Return what changes as a Markdown table, one line a number."""
    standard = {row[3]: row for row in rows if row[0] == "standard"}
    lines = ["| number | value | origin | halved | doubled |", "|---|---|---|---|---|"]
    still = run = 0
    for group, one, value in deciding_numbers():
        cells, moved, unit = [], False, one.metadata["unit"].removesuffix("1")
        if not any(row[:2] == [group, one.name] for row in rows):
            continue
        run += 1
        for factor in FACTORS:
            mine = [row for row in rows if row[:3] == [group, one.name, str(factor)] and row[3] in standard]
            if not mine:
                cells.append("not run")
                continue
            other = [row for row in mine if row[4] != standard[row[3]][4]]
            most = max(largest_move(json.loads(standard[row[3]][5]), json.loads(row[5])) for row in mine)
            words = [f"{len(other)} of {len(mine)} decisions"] if other else []
            words += [f"values by {most:.1f} s.e."] if most > MOVED else []
            told = sum(row[6] != standard[row[3]][6] for row in mine) - len(other)
            words += [f"something else told in {told}"] if told > 0 and not words else []
            turned = any(row[7] == "run" for row in mine)
            cells.append(", ".join(words) or f"{'nothing' if turned else 'never turned'} in {len(mine)}")
            moved = moved or bool(words)
        still += "not run" not in cells and not moved
        origin = one.metadata["origin"].partition(":")[0]
        lines.append(f"| `{group}.{one.name}` | {value:g} {unit} | {origin} | {' | '.join(cells)} |")
    said = [f"- case {case}: {row[4]}" for case, row in sorted(standard.items(), key=lambda pair: int(pair[0]))]
    total = sum(1 for _ in deciding_numbers())
    return "\n".join(
        [
            "\n".join(said),
            "",
            f"Of {total} numbers {run} were run; {still} of these change nothing here.",
            "",
            *lines,
            "",
        ]
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    names = [group.name for group in fields(STANDARD)]
    parser = argparse.ArgumentParser(prog="python -m tests.studies.policy", description=__doc__.split("\n\n")[0])
    parser.add_argument("folder", type=Path, help="what `split prove generate` wrote")
    parser.add_argument("--cases", type=int, nargs="*", default=[])
    parser.add_argument("--groups", nargs="+", choices=names, default=names)
    parser.add_argument("-o", "--rows", type=Path, required=True, help="file the rows are kept in")
    parser.add_argument("--table", type=Path, help="page whose part after its line of dashes is written anew")
    asked = parser.parse_args(arguments)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    use_threads(1)
    study(asked.folder, asked.groups, asked.cases, asked.rows)
    text = table(read_rows(asked.rows))
    if asked.table:
        before = asked.table.read_text(encoding="utf-8").partition("\n---\n")[0]
        asked.table.write_text(f"{before}\n---\n\n{text}", encoding="utf-8")
    else:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
