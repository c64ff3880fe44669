"""How many digits of a number a table shows: those that its standard error supports."""

from __future__ import annotations

import math

__all__ = ["Told", "known_to", "pair_known", "plausible", "three_digits", "two_digits"]


def plausible(value: float) -> str:
    """Return a number to four digits at most, without a power of ten where it can be read: ``12300``, ``0.0123``.

    More digits than the fourth are never known of what is measured here.
    """
    text = f"{value:.4g}"
    return f"{value:.0f}" if "e+" in text and abs(value) < 1e9 else text


class Told(float):
    """A number for a table that is printed with the digits known of it."""

    text: str


def known_to(value: float, error: float) -> Told:
    """Return a number printed to the digits that its standard error supports.

    The last digit stands where the error's second one does if the error begins with 1 or 2, else where its first
    does. An error of zero, or one that is not finite, leaves the digits of `plausible`.
    """
    told = Told(value)
    told.text = plausible(value)
    if math.isfinite(error) and error > 0.0 and math.isfinite(value):
        # Of the error as it is printed: 0.0996 is 0.10, which begins with 1.
        leading, _, exponent = f"{error:.1e}".partition("e")
        place = int(exponent) - (leading[0] in "12")
        rounded = round(value, -place) + 0.0  # no minus before a zero
        told.text = f"{rounded:.{max(-place, 0)}f}"
    return told


def pair_known(value: float, error: float) -> tuple[Told, Told]:
    """Return a number and its standard error, both printed to the digits that the error supports."""
    return known_to(value, error), known_to(error, error)


def three_digits(value: float) -> Told:
    """Return an rms error printed to three digits, zeros included: models are told apart to about one per cent."""
    told = Told(value)
    rounded = float(f"{value:.3g}")
    told.text = plausible(rounded)
    if rounded and 1e-4 <= abs(rounded) < 1e3:
        told.text = f"{rounded:.{2 - math.floor(math.log10(abs(rounded)))}f}"
    return told


def two_digits(value: float) -> Told:
    """Return a numerical error printed to two digits: only its size matters."""
    told = Told(value)
    told.text = f"{value:.1e}"
    return told
