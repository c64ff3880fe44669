"""What a derivation is: the channels it needs and makes, and what it says of them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from split_cli.errors import MapError
from split_cli.vehicle.parameters import Vehicle

__all__ = ["Derivation", "DerivationInputs", "Derived"]


@dataclass(frozen=True)
class Derived:
    """What a derivation made.

    Attributes
    ----------
    columns : mapping of str to ndarray
        Channel to samples `(N,)`, SI.
    how : str
        For the drive's metadata, after ``derived: ``.
    warning : str
        What the reader must know before using it.
    keeps_noise : bool
        Whether its noise is that of the channel it replaces.
    """

    columns: Mapping[str, np.ndarray]
    how: str
    warning: str = ""
    keeps_noise: bool = False


@dataclass(frozen=True)
class DerivationInputs:
    """What a derivation may use.

    Attributes
    ----------
    columns : mapping of str to ndarray
        Of the drive so far, SI, at the CG.
    period : float
        [s].
    segments : list of slice
    vehicle : Vehicle or None
    settings : mapping
        The map's `derivations` entry.
    time : ndarray, shape (N,), or None
        Of every row [s]; None counts rows.
    """

    columns: Mapping[str, np.ndarray]
    period: float
    segments: list[slice]
    vehicle: Vehicle | None
    settings: Mapping[str, Any]
    time: np.ndarray | None = None

    def require_vehicle(self, name: str) -> Vehicle:
        """Return the vehicle, which the derivation of that name cannot do without."""
        if self.vehicle is None:
            raise MapError(f"--derive {name} needs the vehicle", advice="Give it with --vehicle.")
        return self.vehicle


@dataclass(frozen=True)
class Derivation:
    """A way to compute channels.

    Attributes
    ----------
    name : str
        As ``--derive`` takes it.
    makes, needs : tuple of str
        Channels.
    settings : tuple of str
        Keys that the map may give.
    run : callable
        DerivationInputs to Derived.
    choices : tuple of (str, str)
        Settings that name a channel it needs too, each with its default.
    """

    name: str
    makes: tuple[str, ...]
    needs: tuple[str, ...]
    settings: tuple[str, ...]
    run: Callable[[DerivationInputs], Derived]
    choices: tuple[tuple[str, str], ...] = ()

    def inputs(self, settings: Mapping[str, Any], mapped: Collection[str]) -> tuple[str, ...]:
        """Return the channels it needs under the map's settings; a default that is not mapped is left out."""
        chosen = [str(settings.get(key, default if default in mapped else "")) for key, default in self.choices]
        return tuple(dict.fromkeys([*self.needs, *filter(None, chosen)]))
