"""The base of every named term: which stages exist, and that by default nothing happens at them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from split_cli.vehicle.single_track import Flow

__all__ = ["Term"]


class Term:
    """A small physical model added to the nominal single track.

    Attributes
    ----------
    id : str
        Name in the catalogue.
    units : mapping of str to str
        Parameter names and their units.
    variants : tuple of str
        Alternatives where physics allows several; the first, usually empty, is the default.

    Parameters
    ----------
    parameters : mapping of str to float
        Values in the units above: what the real car has beyond the plain vehicle.
    variant : str
    """

    id: ClassVar[str]
    units: ClassVar[Mapping[str, str]]
    variants: ClassVar[tuple[str, ...]] = ("",)

    def __init__(self, parameters: Mapping[str, float], variant: str = "") -> None:
        self.parameters = dict(parameters)
        self.variant = variant

    def actuate(self, flow: Flow) -> None:
        """Change T and delta from command to what arrives."""

    def body(self, flow: Flow) -> None:
        """Change mass, inertia or the CG's place."""

    def tire(self, flow: Flow) -> None:
        """Change B, C, D of an axle; slip angles and longitudinal forces are known."""

    def lateral(self, flow: Flow) -> None:
        """Change the axles' lateral forces once computed."""

    def external(self, flow: Flow) -> None:
        """Add forces and a moment at the CG."""
