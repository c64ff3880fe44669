"""What a diagnosis says of each pair, kept in a file, and what becomes of names, values and intervals."""

import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from split_cli.diagnosis.engine import diagnose
from split_cli.diagnosis.statement.document import diagnosis_to_mapping
from split_cli.errors import SplitError
from split_cli.logs.drive import read_drive
from split_cli.proof.outcome import Named, Statement, judge, share_of_true
from split_cli.proof.scoring import statement_of
from split_cli.vehicle.parameters import read_vehicle
from tests.studies.other_cars.generate import PairTruth, case_folder, pair_name
from tests.studies.recorded_faults import in_words


@dataclass(frozen=True)
class PairAnswer:
    """What a diagnosis said of one pair, as it is kept: rows are judged when they are printed.

    Attributes
    ----------
    name : str
        Of the pair.
    words : str
        Verdict, names with values, alternatives and leads.
    seconds : float
        Processor time [s].
    """

    name: str
    said: Statement
    words: str
    seconds: float


@dataclass(frozen=True)
class JudgedPair:
    """How what was said of one pair fares.

    Attributes
    ----------
    outcome : str
        Of `proof.outcome.OUTCOMES`.
    named, by_alternative, lost : tuple of str
        Terms that were put in, by what became of them.
    wrong : tuple of str
        Findings that are none of the terms that were put in, nor have one among their alternatives.
    intervals : dict of str to bool
        For ``term.parameter`` of each named term with a true value, whether the 95 % interval holds it.
    """

    outcome: str
    verdict: str
    unexplained: bool
    named: tuple[str, ...]
    by_alternative: tuple[str, ...]
    lost: tuple[str, ...]
    wrong: tuple[str, ...]
    intervals: dict[str, bool]


def judged_pair(truth: PairTruth, said: Statement) -> JudgedPair:
    """Return how a statement about a pair fares.

    The rules are those of `split_cli.proof`: an alternative ``a+b`` stands for both terms, and for neither alone. The
    grip of either axle is a variant of `friction_scale`, so that two findings of one term count as one name.
    """
    terms = [effect.term for effect in truth.effects if effect.term]
    once = tuple({finding.term: finding for finding in reversed(said.findings)}.values())
    asked = ["strange"] if truth.is_strange else terms
    reached = {one for finding in once for one in _reached(finding, terms)}
    names = {finding.term for finding in once}
    return JudgedPair(
        outcome=judge(asked, replace(said, findings=once), in_catalogue=not truth.is_strange),
        verdict=said.verdict,
        unexplained=said.unexplained,
        named=tuple(term for term in terms if term in names),
        by_alternative=tuple(term for term in terms if term not in names and term in reached),
        lost=tuple(term for term in terms if term not in names | reached),
        wrong=tuple(finding.term for finding in once if not _reached(finding, terms)),
        intervals=_intervals(truth, said),
    )


def _reached(finding: Named, terms: Sequence[str]) -> set[str]:
    """Return the terms that a finding or one of its alternatives stands for, where it needs no other beside them."""
    options = [{finding.term}, *({*option.split("+")} for option in finding.alternatives)]
    return {one for option in options if option <= set(terms) for one in option}


def _intervals(truth: PairTruth, said: Statement) -> dict[str, bool]:
    """Return for each parameter with a true value whether any finding of its term holds it."""
    held: dict[str, bool] = {}
    for effect in truth.effects:
        for finding in said.findings:
            for parameter, value in effect.values.items():
                if finding.term == effect.term and parameter in finding.parameters:
                    _, low, high = finding.parameters[parameter]
                    key = f"{effect.term}.{parameter}"
                    held[key] = held.get(key, False) or bool(low <= value <= high)
    return held


class PairAnswers:
    """Answers of one folder, each diagnosed once and kept in ``rows.jsonl``, without held-out time in another file."""

    def __init__(self, root: Path, improved: bool) -> None:
        self.root, self.improved, self.path = root, improved, root / ("rows.jsonl" if improved else "rows_fast.jsonl")
        lines = self.path.read_text(encoding="utf-8").splitlines() if self.path.exists() else []
        self.answers = {answer.name: answer for answer in (answer_from(json.loads(line)) for line in lines)}

    def answer(self, truth: PairTruth) -> PairAnswer:
        """Return the answer of a pair, from the file or computed now."""
        if not self.has(truth):
            self.keep(diagnosed(self.root, truth, self.improved))
        return self.answers[pair_name(truth.number)]

    def has(self, truth: PairTruth) -> bool:
        """Tell whether a pair has its answer."""
        return pair_name(truth.number) in self.answers

    def keep(self, answer: PairAnswer) -> None:
        """Add an answer to those that are kept."""
        with self.path.open("a", encoding="utf-8") as out:
            out.write(json.dumps(asdict(answer)) + "\n")
        self.answers[answer.name] = answer


def answer_from(entry: dict[str, Any]) -> PairAnswer:
    """Return an answer from its JSON."""
    findings = tuple(
        Named(
            one["term"],
            {name: tuple(values) for name, values in one["parameters"].items()},
            tuple(one["alternatives"]),
            one["variant"],
        )
        for one in entry["said"]["findings"]
    )
    return PairAnswer(**{**entry, "said": Statement(**{**entry["said"], "findings": findings})})


def diagnosed(root: Path, truth: PairTruth, improved: bool) -> PairAnswer:
    """Diagnose one pair; `improved` takes held-out time, as the command does."""
    folder, begun = case_folder(root, truth.number), time.process_time()
    try:
        real, simulated = read_drive(folder / "real.parquet"), read_drive(folder / "sim.parquet")
        found = diagnose([real], read_vehicle(folder / "vehicle.yaml"), [simulated], improved=improved)
        mapping = diagnosis_to_mapping(found)
        said, words = statement_of(mapping), in_words(mapping)
        words += f"; {found.summary}" if said.verdict == "undecided" else ""
    except SplitError as error:
        said, words = Statement("undecided"), f"refused: {error}"
    return PairAnswer(pair_name(truth.number), said, words, time.process_time() - begun)


def row_line(truth: PairTruth, answer: PairAnswer) -> str:
    """Return a line of the table: pair, what was put in, outcome, answer."""
    put_in = "; ".join(
        f"{effect.name} {', '.join(f'{value:.4g}' for value in effect.values.values())} ({size:.2f})"
        for effect, size in zip(truth.effects, truth.sizes, strict=True)
    )
    outcome = judged_pair(truth, answer.said).outcome
    return (
        f"| {answer.name} | {truth.car} | {put_in or 'nothing'} | {outcome} | {answer.words} | {answer.seconds:.0f} s |"
    )


def summary_lines(answered: Sequence[tuple[PairTruth, Statement]]) -> list[str]:
    """Return the counts of all pairs, each share with its 95 % Wilson interval."""
    pairs = [(truth, judged_pair(truth, said)) for truth, said in answered]
    known = [(truth, row) for truth, row in pairs if truth.effects and not truth.is_strange]
    effects = [term for truth, _ in known for term in (effect.term for effect in truth.effects)]
    named, others = sum(len(row.named) for _, row in known), sum(len(row.by_alternative) for _, row in known)
    lost = [(row.unexplained, term) for _, row in known for term in row.lost]
    names = named + others + sum(len(row.wrong) for _, row in known)
    wrong = sum(len(row.wrong) for _, row in known)
    intervals = [held for _, row in known for held in row.intervals.values()]
    equal = [row.verdict == "mismatch" for truth, row in pairs if not truth.effects]
    strange = [row.outcome == "exact" for truth, row in pairs if truth.is_strange]
    return [
        f"effects named: {named} of {len(effects)}; by an alternative: {others}; lost: {len(lost)}, "
        f"of these {sum(unexplained for unexplained, _ in lost)} called unexplained",
        f"effects named, or by an alternative: {share_of_true([True] * (named + others) + [False] * len(lost))}",
        f"wrong names: {wrong} of {names} in {sum(bool(row.wrong) for _, row in known)} of {len(known)} pairs",
        f"pairs complete: {share_of_true([row.outcome in ('exact', 'class') for _, row in known])}",
        f"intervals that hold the truth: {share_of_true(intervals)}",
        f"equal pairs called different: {share_of_true(equal)}",
        f"strange effects called unexplained: {share_of_true(strange)}",
        f"wrong names of strange effects: {sum(len(row.wrong) for truth, row in pairs if truth.is_strange)}",
    ]
