"""Vehicle files that come with the project, one YAML a car; addressed by the file's name without suffix.

May import: nothing of the project.
"""

from pathlib import Path

__all__ = ["library_names", "library_path"]

_FOLDER = Path(__file__).resolve().parent


def library_names() -> tuple[str, ...]:
    """Return the names of the vehicles in the project, sorted."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.yaml")))


def library_path(name: str) -> Path | None:
    """Return the file of a vehicle of the library, None when there is none of that name."""
    return _FOLDER / f"{name}.yaml" if name in library_names() else None
