"""The score as tables."""

from collections.abc import Sequence

from split_cli.proof.outcome import OUTCOMES, Rate
from split_cli.proof.scoring import CaseSetScore, in_short


def target_rows(score: CaseSetScore) -> list[list[str]]:
    """Return what is asked for, the goal, what was reached and whether it is met."""
    met_words = {True: "yes", False: "no", None: "-"}
    return [[what, goal, _value(reached), met_words[met]] for what, goal, reached, met in score.targets]


def _value(reached: Rate | float | None) -> str:
    if reached is None:
        return "-"
    return f"{reached:.3f}" if isinstance(reached, float) else str(reached)


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows), ""]


def markdown_of(result) -> str:
    """Return all tables of a `workflows.proving.prove.CaseSetScore` as Markdown."""
    score: CaseSetScore = result.diagnosis
    lines = [
        f"Seal of the answers: `{result.seal.sha256}` (seed {result.seal.seed}, {result.seal.cases} cases, "
        f"version {result.seal.version}); identified: {result.identified}.",
        f"One identification took {score.seconds_median:.1f} s in the median, {score.seconds_most:.1f} s at most, "
        f"and {score.memory_most:.0f} MB at most.",
        "",
    ]
    lines += _table(["what", "goal", "diagnosis", "met"], target_rows(score))
    lines += ["Outcomes, with 95 % Wilson intervals:", ""]
    lines += _table(["cases", *OUTCOMES], [[name, *(str(rates[o]) for o in OUTCOMES)] for name, rates in score.groups])
    lines += ["Every case that was not answered exactly:", ""]
    lines += _table(["concealed", "said", "times"], [[t, s, str(n)] for t, s, n in score.confusion])
    lines += ["Exactly named, by term:", ""]
    lines += _table(["term", "easy", "realistic", "hard"], _by_term(result))
    lines += ["Coverage of 95 % intervals:", ""]
    lines += _table(["parameter", "holds the truth"], [[n, str(r)] for n, r in score.coverage_by_parameter])
    strange = [s for s in result.scores if s.answer.kind == "strange"]
    if strange:
        lines += ["Outside the catalogue:", ""]
        lines += _table(
            ["effect", "effect-to-noise ratio", "of what two terms leave", "those terms", "said", "outcome"],
            [
                [
                    s.answer.effects[0].term,
                    f"{s.answer.total_effect_to_noise:.2f}",
                    f"{s.answer.effects[0].beyond:.2f}",
                    " + ".join(s.answer.effects[0].absorbed_by),
                    in_short(s.said),
                    s.outcome,
                ]
                for s in sorted(strange, key=lambda s: s.answer.effects[0].term)
            ],
        )
    return "\n".join(lines)


def _by_term(result) -> list[list[str]]:
    singles = [s for s in result.scores if s.answer.kind == "single"]
    rows = []
    for term in sorted({s.answer.effects[0].term for s in singles}):
        row = [term]
        for tier in ("easy", "realistic", "hard"):
            cases = [s for s in singles if s.answer.effects[0].term == term and s.answer.tier == tier]
            row.append(f"{sum(s.outcome == 'exact' for s in cases)}/{len(cases)}" if cases else "-")
        rows.append(row)
    return rows
