"""How many digits of a number a table shows: those that its standard error supports."""

import math


def plausible(value: float) -> str:
    """Return a number to four digits at most, without a power of ten where it can be read: ``12300``, ``0.0123``.

    More digits than the fourth are never known of what is measured here.
    """
    text = f"{value:.4g}"
    return f"{value:.0f}" if "e+" in text and abs(value) < 1e9 else text


class Printed(float):
    """A number for a table that is printed with the digits known of it."""

    text: str


def known_to(value: float, error: float) -> Printed:
    """Return a number printed to the digits that its standard error supports.

    The last digit stands where the error's second one does if the error begins with 1 or 2, else where its first
    does. An error of zero, or one that is not finite, leaves the digits of `plausible`.
    """
    printed = Printed(value)
    printed.text = plausible(value)
    if math.isfinite(error) and error > 0.0 and math.isfinite(value):
        # Of the error as it is printed: 0.0996 is 0.10, which begins with 1.
        leading, _, exponent = f"{error:.1e}".partition("e")
        place = int(exponent) - (leading[0] in "12")
        rounded = round(value, -place) + 0.0  # no minus before a zero
        printed.text = f"{rounded:.{max(-place, 0)}f}"
    return printed


def pair_known(value: float, error: float) -> tuple[Printed, Printed]:
    """Return a number and its standard error, both printed to the digits that the error supports."""
    return known_to(value, error), known_to(error, error)


def three_digits(value: float) -> Printed:
    """Return an rms error printed to three digits, zeros included: models differ from about one per cent on."""
    printed = Printed(value)
    rounded = float(f"{value:.3g}")
    printed.text = plausible(rounded)
    if rounded and 1e-4 <= abs(rounded) < 1e3:
        printed.text = f"{rounded:.{2 - math.floor(math.log10(abs(rounded)))}f}"
    return printed


def two_digits(value: float) -> Printed:
    """Return a numerical error printed to two digits: only its size matters."""
    printed = Printed(value)
    printed.text = f"{value:.1e}"
    return printed
