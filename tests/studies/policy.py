"""How much each number of the diagnosis policy matters: halved and doubled, one at a time, on development cases.

    split prove generate FOLDER --seed 5 --cases 16
    python -m tests.studies.policy FOLDER --cases 3 9 10 --groups selection abstention -o rows.csv
    python -m tests.studies.policy FOLDER -o rows.csv --table docs/decisions/0031-sensitivity-of-the-policy.md

Rows that are in the file already are not computed again. What counts as a change: another verdict, other names or
another word about what has no name (a decision); values that move by more than a tenth of their standard error; or
anything else that `diagnosis.json` tells. "Never turned": no comparison came out otherwise (`probing.py`).
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
from typing import Any

from split_cli.diagnosis.engine import diagnose
from split_cli.diagnosis.parallel import use_threads
from split_cli.diagnosis.policy import STANDARD, Policy, deciding_numbers
from split_cli.diagnosis.statement.document import diagnosis_to_text
from split_cli.errors import SplitError
from split_cli.logs.drive import read_drive
from split_cli.vehicle.parameters import read_vehicle
from tests.studies.probing import outcomes, turned

FACTORS = (0.5, 2.0)
RUN, NEVER_TURNED, TURNED = "run", "never turned", "turned"  # how a row is known; the last has no outcome yet
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


def study(folder: Path, groups: Sequence[str], cases: Sequence[int], rows: Path, follow: bool = True) -> None:
    """Run what is not in the file of rows yet, and add to it row by row, each as soon as it is known.

    Without `follow` a case is diagnosed once: what turns nothing is known then, and all else is left open.
    """
    done = {tuple(row[:4]) for row in read_rows(rows) if row[7] != TURNED or not follow}
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

            def diagnosed(numbers: dict[str, Any], case: int = case) -> Outcome:
                return outcome_of(folder / "cases" / f"{case:04d}", with_numbers(numbers))

            def told(name: str, factor: float, outcome: Outcome, case: int = case) -> None:
                add(*name.split("."), factor, case, outcome, RUN)

            if follow:
                standard, differ = outcomes(diagnosed, numbers, told)
            else:
                standard, differ = turned(diagnosed, numbers)
            for name, values in numbers.items():
                for factor in values:
                    if factor != 1.0 and (name, factor) not in differ:
                        add(*name.split("."), factor, case, standard, NEVER_TURNED)
                    elif factor != 1.0 and not follow:
                        add(*name.split("."), factor, case, Outcome("", {}, ""), TURNED)
            if ("standard", "", "1.0", str(case)) not in done:
                add("standard", "", 1.0, case, standard, RUN)


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


def told_of(rows: list[list[str]], standard: dict[str, list[str]]) -> tuple[str, bool]:
    """Return what an altered number changes in words, and whether it changes something."""
    known = [row for row in rows if row[7] != TURNED and row[3] in standard]
    run = [row for row in known if row[7] == RUN]
    other = [row for row in run if row[4] != standard[row[3]][4]]
    most = max((largest_move(json.loads(standard[row[3]][5]), json.loads(row[5])) for row in run), default=0.0)
    elsewhere = sum(row[6] != standard[row[3]][6] for row in run) - len(other)
    words = [f"{len(other)} of {len(run)} decisions"] if other else []
    words += [f"values by {most:.1f} s.e."] if most > MOVED else []
    words += [f"something else told in {elsewhere}"] if elsewhere > 0 and not words else []
    open_cases = len({row[3] for row in rows} - {row[3] for row in known})
    said = ", ".join(words) or (f"nothing in {len(run)}" if run else "")
    still = len(known) - len(run)
    parts = [said, f"not turned in {still}" if still else "", f"open in {open_cases}" if open_cases else ""]
    return "; ".join(filter(None, parts)) or "not run", bool(words)


def table(rows: list[list[str]]) -> str:
    """Return what changes as Markdown: a row for each number that was followed, and the others group by group."""
    standard = {row[3]: row for row in rows if row[0] == "standard"}
    lines, others, change = [], {}, 0
    for group, one, value in deciding_numbers():
        mine = [row for row in rows if row[:2] == [group, one.name]]
        told = f"{value:g} {one.metadata['unit'].removesuffix('1')}".strip()
        if any(row[7] == RUN for row in mine):
            cells = [told_of([row for row in mine if row[2] == str(factor)], standard) for factor in FACTORS]
            change += any(changes for _, changes in cells)
            words = " | ".join(words for words, _ in cells)
            lines.append(f"| `{group}.{one.name}` | {told} | {words} |")
        elif mine:
            turned_some = any(row[7] != NEVER_TURNED for row in mine)
            others.setdefault(group, ([], []))[turned_some].append(f"`{one.name}` {told}")
    cases = "; ".join(f"{case} {row[4]}" for case, row in sorted(standard.items(), key=lambda pair: int(pair[0])))
    never = sum(len(names) for names, _ in others.values())
    total, asked = (
        sum(1 for _ in deciding_numbers()),
        len(lines) + sum(len(a) + len(b) for a, b in others.values()),
    )
    groups = [f"| `{group}` | {', '.join(a)} | {', '.join(b)} |" for group, (a, b) in others.items()]
    parts = [
        f"Cases: {cases}.",
        f"Of {total} numbers {asked} were asked about. {never} never turned a comparison in these "
        f"cases and change nothing there. {len(lines)} were followed to the end in some case; {change} of these "
        "changed something.",
        "\n".join(["| number | value | halved | doubled |", "|---|---|---|---|", *lines]),
        "\n".join(
            ["| group | never turned a comparison | turned one, and was not run on |", "|---|---|---|", *groups]
        ),
    ]
    return "\n\n".join(parts) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    names = [group.name for group in fields(STANDARD)]
    parser = argparse.ArgumentParser(prog="python -m tests.studies.policy", description=__doc__.split("\n\n")[0])
    parser.add_argument("folder", type=Path, help="what `split prove generate` wrote")
    parser.add_argument(
        "--cases", type=int, nargs="*", default=[], help="default: none; with --survey all of FOLDER"
    )
    parser.add_argument("--groups", nargs="+", choices=names, default=names)
    parser.add_argument("--survey", action="store_true", help="one diagnosis a case: which numbers turn anything")
    parser.add_argument("-o", "--rows", type=Path, required=True, help="file the rows are kept in")
    parser.add_argument("--table", type=Path, help="page whose part after its line of dashes is written anew")
    asked = parser.parse_args(arguments)
    if asked.survey and not asked.cases:
        asked.cases = sorted(int(one.name) for one in (asked.folder / "cases").glob("[0-9]*"))
        if not asked.cases:
            parser.error(f"{asked.folder} has no cases to survey: `split prove generate` writes them")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    use_threads(1)
    study(asked.folder, asked.groups, asked.cases, asked.rows, not asked.survey)
    text = table(read_rows(asked.rows))
    if asked.table:
        before = asked.table.read_text(encoding="utf-8").partition("\n---\n")[0]
        asked.table.write_text(f"{before}\n---\n\n{text}", encoding="utf-8")
    else:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
