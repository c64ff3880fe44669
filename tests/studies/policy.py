"""How much each number of the diagnosis policy matters: halved and doubled, one at a time, on development cases.

    split prove generate FOLDER --seed 5 --cases 16
    python -m tests.studies.policy FOLDER --cases 3 9 10 --groups selection abstention -o rows.csv

Rows that are in the file already are not computed again; each is one diagnosis. What counts as a change: another
verdict, other names or another word about what has no name (a decision); values that move by more than a tenth of
their standard error; or anything else that `diagnosis.json` tells.
"""

import argparse
import csv
import hashlib
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

from split_cli.diagnosis.engine import diagnose
from split_cli.diagnosis.parallel import use_threads
from split_cli.diagnosis.policy import STANDARD, Policy, deciding_numbers
from split_cli.diagnosis.statement.document import diagnosis_to_text
from split_cli.errors import SplitError
from split_cli.logs.drive import read_drive
from split_cli.vehicle.parameters import read_vehicle

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


def study(folder: Path, groups: Sequence[str], cases: Sequence[int], rows: Path) -> None:
    """Diagnose what is not in the file of rows yet, and add to it row by row."""
    done = {tuple(row[:4]) for row in read_rows(rows)}
    wanted = [("standard", "", 1.0, STANDARD)]
    for group, one, value in deciding_numbers():
        for factor in FACTORS if group in groups else ():
            other = STANDARD.altered(group, **{one.name: altered(value, factor)})
            wanted.append((group, one.name, factor, other))
    with rows.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        for case in cases:
            for group, number, factor, policy in wanted:
                if (group, number, str(factor), str(case)) in done:
                    continue
                outcome = outcome_of(folder / "cases" / f"{case:04d}", policy)
                values = json.dumps(outcome.values)
                writer.writerow([group, number, factor, case, outcome.decision, values, outcome.document])
                file.flush()


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


def told_of(rows: list[list[str]], standard: dict[str, list[str]]) -> str:
    """Return what an altered number changes, in words."""
    other = [row for row in rows if row[4] != standard[row[3]][4]]
    most = max((largest_move(json.loads(standard[row[3]][5]), json.loads(row[5])) for row in rows), default=0.0)
    elsewhere = sum(row[6] != standard[row[3]][6] for row in rows) - len(other)
    words = [f"{len(other)} of {len(rows)} decisions"] if other else []
    words += [f"values by {most:.1f} s.e."] if most > MOVED else []
    words += [f"something else told in {elsewhere}"] if elsewhere > 0 and not words else []
    return ", ".join(words) or (f"nothing in {len(rows)}" if rows else "not run")


def table(rows: list[list[str]]) -> str:
    """Return what changes as Markdown, a row for each number that was asked about."""
    standard = {row[3]: row for row in rows if row[0] == "standard"}
    lines = ["| number | value | halved | doubled |", "|---|---|---|---|"]
    for group, one, value in deciding_numbers():
        mine = [row for row in rows if row[:2] == [group, one.name]]
        if mine:
            told = f"{value:g} {one.metadata['unit'].removesuffix('1')}".strip()
            cells = [told_of([row for row in mine if row[2] == str(factor)], standard) for factor in FACTORS]
            lines.append(f"| `{group}.{one.name}` | {told} | {' | '.join(cells)} |")
    cases = "; ".join(f"{case} {row[4]}" for case, row in sorted(standard.items(), key=lambda pair: int(pair[0])))
    return f"Cases: {cases}.\n\n" + "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    names = [group.name for group in fields(STANDARD)]
    parser = argparse.ArgumentParser(prog="python -m tests.studies.policy", description=__doc__.split("\n\n")[0])
    parser.add_argument("folder", type=Path, help="what `split prove generate` wrote")
    parser.add_argument("--cases", type=int, nargs="*", default=[], help="none: the table of the rows alone")
    parser.add_argument("--groups", nargs="+", choices=names, default=names)
    parser.add_argument("-o", "--rows", type=Path, required=True, help="file the rows are kept in")
    asked = parser.parse_args(arguments)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    use_threads(1)
    study(asked.folder, asked.groups, asked.cases, asked.rows)
    print(table(read_rows(asked.rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
