"""Result of `split verify`: the checks of a file or folder."""

from dataclasses import dataclass

from split_cli.export.verified import VerifiedItem

__all__ = ["Verification", "VerifiedItem", "item"]


@dataclass(frozen=True)
class Verification:
    """What checking a file or folder found."""

    # path, kind: kind is what it was found to be: ``trained set``, ``export``, ``drive`` ...
    path: str
    kind: str
    items: tuple[VerifiedItem, ...]

    @property
    def passed(self) -> bool:
        """Whether nothing failed."""
        return all(item.passed is not False for item in self.items)


def item(check: str, passed: bool, good: str, bad: str) -> VerifiedItem:
    """Return a check with the words for its outcome."""
    return VerifiedItem(check, bool(passed), good if passed else bad)
