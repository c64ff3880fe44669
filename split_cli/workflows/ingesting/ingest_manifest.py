"""What a folder of drives was made of, so that a grown archive costs only what is new."""

from __future__ import annotations

import contextlib
import hashlib
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from split_cli import __version__
from split_cli.errors import SplitError
from split_cli.files import atomic_write_text, parse_json, sha256_of_file
from split_cli.logs.assembling.assemble import IngestSettings
from split_cli.logs.map_entries import SignalMap
from split_cli.vehicle.parameters import Vehicle

MANIFEST_NAME = "ingest-manifest.json"
MANIFEST_FORMAT = "split-ingest/1"
_SECONDS_BETWEEN_WRITES = 5.0
"""Of a long run, so that a killed one loses little [s]; judgement."""


@dataclass
class IngestManifest:
    """Which source and settings each drive of a folder was made with."""

    path: Path
    # By the source's place: ``source`` (fingerprint), ``settings`` (digest), ``drive`` (file), ``sha256`` of it.
    entries: dict[str, dict[str, str]] = field(default_factory=dict)
    _written: float = field(default=0.0, repr=False)

    @classmethod
    def of(cls, folder: Path) -> IngestManifest:
        """Read the manifest of a folder; an empty one where there is none.

        Raises
        ------
        SplitError
            If there is one that is damaged or of another version.
        """
        path = folder / MANIFEST_NAME
        if not path.is_file():
            return cls(path)
        try:
            stored = parse_json(path.read_text(encoding="utf-8"))
            if stored["format"] != MANIFEST_FORMAT:
                raise ValueError(f"format {stored['format']!r}")
            entries = {
                str(place): {name: str(entry[name]) for name in ("source", "settings", "drive", "sha256")}
                for place, entry in stored["drives"].items()
            }
            if any(not _is_below(entry["drive"]) for entry in entries.values()):
                raise ValueError("it names a drive elsewhere")
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            what = f"is no manifest of this version ({error})"
            raise SplitError(what, where=str(path), advice="Remove it to ingest all again.") from error
        return cls(path, entries)

    def is_done(self, place: str, source: Callable[[], str], settings: str) -> bool:
        """Tell whether the drive of a source is there, made of the same content with the same settings.

        The fingerprint `source` is asked for only where the rest says so. What cannot be read is not done.
        """
        entry = self.entries.get(place)
        if entry is None or entry["settings"] != settings:
            return False
        drive = self.path.parent / entry["drive"]
        with contextlib.suppress(SplitError):
            return drive.is_file() and entry["source"] == source() and sha256_of_file(drive) == entry["sha256"]
        return False

    def add(self, place: str, source: str, settings: str, drive: str, written: Path) -> None:
        """Enter a drive that was written."""
        self.entries[place] = {
            "source": source,
            "settings": settings,
            "drive": drive,
            "sha256": sha256_of_file(written),
        }

    def write(self, folder: Path | None = None, *, now_and_then: bool = False) -> None:
        """Write the manifest; with `now_and_then` only when some seconds have passed since the last time."""
        if now_and_then and time.monotonic() - self._written < _SECONDS_BETWEEN_WRITES:
            return
        self._written = time.monotonic()
        content = {"format": MANIFEST_FORMAT, "drives": dict(sorted(self.entries.items()))}
        atomic_write_text((folder or self.path.parent) / MANIFEST_NAME, json.dumps(content, indent=1) + "\n")


def _is_below(drive: str) -> bool:
    """Tell whether a drive's place, as a manifest has it, is one that a folder can hold."""
    parts = PurePosixPath(drive).parts
    return bool(parts) and all(part not in ("/", "..") and len(part.encode()) <= 255 for part in parts)


def settings_digest(
    signal_map: SignalMap | None, vehicle: Vehicle | None, settings: IngestSettings | None, topics: Mapping[str, str]
) -> str:
    """Return what a drive depends on beside its source, in 64 digits."""
    described: dict[str, Any] = {
        "version": __version__,
        "map": None if signal_map is None else asdict(signal_map),
        "vehicle": None if vehicle is None else [vehicle.name, vehicle.digest()],
        "settings": asdict(settings or IngestSettings()),
        "topics": dict(topics),
    }
    return hashlib.sha256(json.dumps(described, sort_keys=True, default=str).encode()).hexdigest()
