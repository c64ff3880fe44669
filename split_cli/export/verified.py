"""Result of one check of a file, without the slow imports of the checks themselves."""

from dataclasses import dataclass


@dataclass(frozen=True)
class VerifiedItem:
    """One thing that was checked."""

    check: str  # what
    passed: bool | None  # None when it could not be checked here
    detail: str
