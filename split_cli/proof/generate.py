"""Making cases: in parallel, resumable, sealed at the end."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from split_cli.errors import SplitError
from split_cli.proof.cases import build_case
from split_cli.proof.plan import MIXED, plan_case
from split_cli.proof.sets import build_nominal_set
from split_cli.proof.store import Seal, case_name, write_case, write_seal
from split_cli.proof.whole_car import build_whole_car


def generate_cases(
    root: Path,
    seed: int,
    cases: int,
    *,
    apply: Callable[[Callable[[Any], None], Sequence[Any]], Iterable[None]] = map,
    kinds: tuple[str, ...] = MIXED,
    count: Callable[[int, int], None] = lambda done, total: None,
) -> Seal:
    """Write the cases of a seed that are not there yet, and seal them all.

    Parameters
    ----------
    root : Path
        Folder; made if missing. One that holds cases of another seed is refused.
    apply : callable
        ``apply(function, items)`` does the work, as `map` does here; other processes must see the same folder.
    kinds : tuple of str
        Of `plan.KINDS`.
    count : callable
        Called with (done, total) after each case.

    Raises
    ------
    SplitError
        If a case cannot be built or the folder belongs to other settings.
    """
    plan_case(seed, 0, kinds)  # a wrong seed or kind is refused before anything is written
    root.mkdir(parents=True, exist_ok=True)
    _claim(root, seed, kinds)
    open_ = [n for n in range(cases) if not (root / "cases" / case_name(n)).is_dir()]
    tasks = [(root.absolute(), seed, number, kinds) for number in open_]
    for done, _ in enumerate(apply(_make, tasks), cases - len(open_) + 1):
        count(done, cases)
    return write_seal(root, seed)


def _make(task: tuple[Path, int, int, tuple[str, ...]]) -> None:
    root, seed, number, kinds = task
    plan = plan_case(seed, number, kinds)
    build = {"nominal-set": build_nominal_set, "whole-car": build_whole_car}.get(plan.kind, build_case)
    write_case(build(plan), root)


def _claim(root: Path, seed: int, kinds: tuple[str, ...]) -> None:
    """Note in the folder whose cases it holds; refuse a folder of others."""
    mark = root / "seed.txt"
    text = f"{seed} {','.join(kinds)}\n"
    if mark.exists() and mark.read_text() != text:
        what = f"holds cases of seed and kinds {mark.read_text().strip()!r}, not {text.strip()!r}"
        raise SplitError(what, where=str(root), advice="Take another folder.")
    mark.write_text(text)
