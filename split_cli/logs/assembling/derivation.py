"""What a derivation is: the channels it needs and makes, and what it says of them."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from split_cli.errors import MapError
from split_cli.vehicle.parameters import Vehicle


@dataclass(frozen=True)
class Derived:
    """What a derivation made."""

    columns: Mapping[str, np.ndarray]  # channel to samples `(N,)`, SI
    how: str  # for the drive's metadata, after ``derived: ``
    warning: str = ""  # what the reader must know before using it
    keeps_noise: bool = False  # whether its noise is that of the channel it replaces


@dataclass(frozen=True)
class DerivationInputs:
    """What a derivation may use."""

    columns: Mapping[str, np.ndarray]  # of the drive so far, SI, at the CG
    period: float  # [s]
    segments: list[slice]
    vehicle: Vehicle | None
    settings: Mapping[str, Any]  # the map's `derivations` entry
    time: np.ndarray | None = None  # (N,): of every row [s]; None counts rows

    def require_vehicle(self, name: str) -> Vehicle:
        """Return the vehicle, which the derivation of that name cannot do without."""
        if self.vehicle is None:
            raise MapError(f"--derive {name} needs the vehicle", advice="Give it with --vehicle.")
        return self.vehicle


@dataclass(frozen=True)
class Derivation:
    """A way to compute channels."""

    name: str  # as ``--derive`` takes it
    # makes, needs: channels.
    makes: tuple[str, ...]
    needs: tuple[str, ...]
    settings: tuple[str, ...]  # keys that the map may give
    run: Callable[[DerivationInputs], Derived]  # DerivationInputs to Derived
    choices: tuple[tuple[str, str], ...] = ()  # settings that name a channel it needs too, each with its default

    def inputs(self, settings: Mapping[str, Any], mapped: Collection[str]) -> tuple[str, ...]:
        """Return the channels it needs under the map's settings; a default that is not mapped is left out."""
        chosen = [str(settings.get(key, default if default in mapped else "")) for key, default in self.choices]
        return tuple(dict.fromkeys([*self.needs, *filter(None, chosen)]))
