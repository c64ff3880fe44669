"""`split prove`: conceal known effects, identify them blind, unseal the answers and score.

The diagnosis sees a case's folder and nothing else; the answers' seal is checked and printed before it begins.
"""

import contextlib
import json
import multiprocessing
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from split_cli.diagnosis.parallel import use_threads
from split_cli.errors import SplitError
from split_cli.files import atomic_write_text
from split_cli.proof.generate import generate_cases
from split_cli.proof.outcome import Statement
from split_cli.proof.scoring import CaseScore, CaseSetScore, score_case, score_of_cases, statement_of
from split_cli.proof.store import Seal, ShownCase, check_seal, read_answer, read_heldout, shown_cases
from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.engine import Engine

__all__ = ["ProofScore", "generate_cases", "identify_cases", "read_statement", "score_cases"]

_CASES_OF_A_PROCESS = 10
"""A worker is replaced after so many cases, so that memory stays bounded whatever a case leaves behind."""


@dataclass(frozen=True)
class ProofScore:
    """The score of a diagnosis."""

    seal: Seal
    identified: int
    cases: int
    diagnosis: CaseSetScore
    scores: tuple[CaseScore, ...]
    failed: tuple[tuple[str, str], ...]  # cases the diagnosis gave an error for; they count as undecided


def identify_cases(
    root: Path,
    *,
    jobs: int = 1,
    limit: int | None = None,
    count: Callable[[int, int], None] = lambda done, total: None,
    cluster: Engine | None = None,
) -> Seal:
    """Diagnose every case that has no result yet, each in a worker process.

    Parameters
    ----------
    root : Path
        A folder that `generate_cases` wrote.
    jobs : int
        Worker processes.
    limit : int, optional
        Only the first so many cases.
    count : callable
        Called with (done, total) after each case.
    cluster : Engine, optional
        Does the work instead; its workers must see the same folder.

    Returns
    -------
    Seal
        Of the answers, checked before the first case.
    """
    root = root.absolute()
    seal = check_seal(root)
    cases = shown_cases(root)[:limit]
    results = root / "results"
    results.mkdir(exist_ok=True)
    open_ = [case for case in cases if not (results / f"{case.name}.json").exists()]
    tasks = [(case, results) for case in open_]
    with contextlib.ExitStack() as stack:
        if cluster is not None:
            identified = cluster.map(_identify, tasks)
        else:
            context, threads = multiprocessing.get_context("spawn"), (1,) if jobs > 1 else (0,)
            # concurrent.futures can hang when it replaces workers (Python 3.11), this pool does not.
            pool = context.Pool(jobs, use_threads, threads, maxtasksperchild=_CASES_OF_A_PROCESS)
            identified = stack.enter_context(pool).imap_unordered(_identify, tasks)
        for done, _ in enumerate(identified, len(cases) - len(open_) + 1):
            count(done, len(cases))
    return seal


def _identify(task: tuple[ShownCase, Path]) -> None:
    """Diagnose one case and note time and memory; the note is written last and says that the case is done."""
    case, results = task
    import resource

    from split_cli.diagnosis.statement.document import diagnosis_to_text
    from split_cli.workflows.diagnose import read_and_diagnose

    began, failure = time.perf_counter(), ""
    try:
        diagnosis, *_ = read_and_diagnose([case.real], case.vehicle, simulated=[case.sim] if case.sim else [])
        (results / case.name).mkdir(exist_ok=True)
        atomic_write_text(results / case.name / "diagnosis.json", diagnosis_to_text(diagnosis))
    except SplitError as error:
        failure = str(error)
    except Exception as error:
        # A fault of the diagnosis is a result too: it is reported with the score, and the other cases go on.
        failure = f"{type(error).__name__}: {error}"
    note = {
        "seconds": round(time.perf_counter() - began, 3),
        "peak_memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0, 1),
        "error": failure,
    }
    atomic_write_text(results / f"{case.name}.json", json.dumps(note) + "\n")


def read_statement(root: Path, name: str) -> Statement:
    """Return what was said of a case; an error of the diagnosis counts as undecided."""
    path = root / "results" / name / "diagnosis.json"
    if not path.exists():
        return Statement("undecided")
    return statement_of(json.loads(path.read_text()))


def score_cases(root: Path, *, count: Callable[[int, int], None] = lambda done, total: None) -> ProofScore:
    """Unseal the answers of the identified cases and score them.

    Raises
    ------
    SplitError
        If an answer was changed after sealing, or nothing was identified yet.
    """
    seal = check_seal(root)
    shown = shown_cases(root)
    cases = [case for case in shown if (root / "results" / f"{case.name}.json").exists()]
    if not cases:
        raise SplitError("nothing was identified yet", where=str(root), advice="Run `split prove identify`.")
    notes = [json.loads((root / "results" / f"{case.name}.json").read_text()) for case in cases]
    scores: list[CaseScore] = []
    for number, case in enumerate(cases):
        answer = read_answer(root, case.name)
        heldout, noise = read_heldout(root, case.name)
        vehicle = read_vehicle(case.vehicle)
        scores.append(score_case(case.name, answer, read_statement(root, case.name), heldout, noise, vehicle))
        count(number + 1, len(cases))
    seconds = [note["seconds"] for note in notes]
    summary = replace(
        score_of_cases(scores),
        seconds_median=float(np.median(seconds)),
        seconds_most=max(seconds),
        memory_most=max(note["peak_memory_mb"] for note in notes),
    )
    return ProofScore(
        seal=seal,
        identified=len(cases),
        cases=len(shown),
        diagnosis=summary,
        scores=tuple(scores),
        failed=tuple((c.name, n["error"]) for c, n in zip(cases, notes, strict=True) if n["error"]),
    )
