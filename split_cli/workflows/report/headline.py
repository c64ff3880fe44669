"""A finding as a headline: the part of the car first, then by how much; never what is as it should be."""

import math
from collections.abc import Sequence

from split_cli.diagnosis.statement.result import Finding, ParameterEstimate
from split_cli.diagnosis.statement.wording import amount, number
from split_cli.vehicle.effects import CATALOGUE
from split_cli.workflows.report.words import term_title

_THOUSANDTHS = {"s": ("ms", 1.0), "m": ("mm", 0.1), "rad": ("mrad", 0.1)}
_SHOWN = 3


def findings_headline(findings: Sequence[Finding], unexplained: str = "") -> str:
    """Return what was found as a headline, strongest first: ``Brakes 14.5 % weak.``

    Parameters
    ----------
    unexplained : str
        How much has no name; empty where nothing is left.
    """
    parts = [finding_headline(finding) for finding in findings[:_SHOWN]]
    more = len(findings) - len(parts)
    if more > 0:
        parts.append(f"{more} more")
    if unexplained:
        parts.append(unexplained)
    return f"{'; '.join(parts)}." if parts else ""


def finding_headline(finding: Finding) -> str:
    """Return one finding: the parameters that differ from what they should be, the others left out."""
    kind = CATALOGUE[finding.term]
    factors, sizes = [], []
    for name, estimate in finding.parameters.items():
        neutral = kind.neutral.get(name)
        if neutral is None or not _differs(estimate, neutral):
            continue
        words = kind.factors.get(f"{finding.variant}/{name}", kind.factors.get(name))
        if words:
            part, above, below = words
            # With the digits of the sentence below, which its interval supports.
            size, _, _ = amount(estimate, neutral=1.0, share=True, more=above, less=below).partition(" (95 %")
            factors.append(f"{part} {size}")
        else:
            sizes.append(_size(estimate))
    if factors:
        return ", ".join(factors)
    title = kind.titles.get(finding.variant) or kind.titles.get("") or term_title(finding.term)
    return f"{title}: {', '.join(sizes)}" if sizes else title


def _differs(estimate: ParameterEstimate, neutral: float) -> bool:
    low, high = estimate.interval_95
    return not low <= neutral <= high


def _size(estimate: ParameterEstimate) -> str:
    unit, below = _THOUSANDTHS.get(estimate.unit, ("", 0.0))
    value, unit = (1e3 * estimate.value, unit) if abs(estimate.value) < below else (estimate.value, estimate.unit)
    return f"{_significant(value)} {'' if unit == '1' else unit}".strip().replace("-", "−").replace("^2", "²")


def _significant(value: float) -> str:
    """Return three digits at most, no more than one behind the point from 10 on."""
    if not math.isfinite(value):
        return "unknown"
    return number(value, 3 if abs(value) >= 10.0 else 2)
