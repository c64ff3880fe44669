"""Signal maps that come with the project, one YAML a source; addressed by the file's name without suffix.

May import: errors.
"""

from pathlib import Path

__all__ = ["preset_abouts", "preset_names", "preset_path"]

_FOLDER = Path(__file__).resolve().parent


def preset_names() -> tuple[str, ...]:
    """Return the names of the maps in the project, sorted."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.yaml")))


def preset_path(name: str) -> Path | None:
    """Return the file of a preset, None when there is no preset of that name."""
    return _FOLDER / f"{name}.yaml" if name in preset_names() else None


def preset_abouts() -> dict[str, str]:
    """Return for each preset what it is for, in a line."""
    import yaml

    return {
        name: " ".join(str(yaml.safe_load(preset_path(name).read_text(encoding="utf-8")).get("about", "")).split())
        for name in preset_names()
    }
