"""The study's command: generate pairs, and with ``--run`` diagnose them and print the table."""

import argparse
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from tests.studies.other_cars import __doc__ as about
from tests.studies.other_cars.generate import PairTruth, generate_pairs
from tests.studies.other_cars.judging import PairAnswers, diagnosed, row_line, summary_lines


def main() -> None:
    """Run what is not there yet, and print it."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.other_cars", description=about.split("\n")[0])
    parser.add_argument("folder", type=Path, help="where pairs, truth and rows are kept")
    parser.add_argument("--seed", type=int, required=True, help="of the list of pairs")
    parser.add_argument("--pairs", type=int, default=12, help="how many pairs the list has (default: 12)")
    parser.add_argument("--only", type=int, nargs="*", help="numbers of pairs, from 0 on")
    parser.add_argument("--run", action="store_true", help="diagnose the pairs, and print the table")
    parser.add_argument("--fast", action="store_true", help="diagnose without held-out time; rows_fast.jsonl is kept")
    parser.add_argument("--jobs", type=int, default=1, help="processes that diagnose (default: 1)")
    given = parser.parse_args()
    numbers = given.only if given.only else range(given.pairs)
    truths = generate_pairs(given.folder, given.seed, numbers)
    print(f"{len(truths)} pairs of seed {given.seed} in {given.folder}", flush=True)
    if given.run:
        _report(given.folder, truths, not given.fast, given.jobs)


def _report(root: Path, truths: list[PairTruth], improved: bool, jobs: int) -> None:
    kept = PairAnswers(root, improved)
    if jobs > 1:
        missing = [truth for truth in truths if not kept.has(truth)]
        with ProcessPoolExecutor(jobs) as pool:
            for answer in pool.map(diagnosed, [root] * len(missing), missing, [improved] * len(missing)):
                kept.keep(answer)
    for truth in truths:
        print(row_line(truth, kept.answer(truth)), flush=True)
    for line in summary_lines([(truth, kept.answer(truth).said) for truth in truths]):
        print(line)


if __name__ == "__main__":
    main()
