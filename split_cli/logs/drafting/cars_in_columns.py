"""Columns of several cars side by side (``#1 Speed``, ``#2 Speed``; ``/car_1/odom``): a draft takes those of one."""

import re
from collections.abc import Sequence

from split_cli.logs.raw import RawChannelInfo

_OF_A_CAR = re.compile(
    r"(?i)/?(?P<car>#?\d+(?=[ :])|#\d+"
    r"|(?:(?:race)?car|vehicle|veh|actor|agent|entity|npc|robot|player|kart|truck|target|traffic|opponent|opp|ego|hero)"
    r"(?:[ _-]?(?:car|racecar|vehicle|actor|agent))?[ _-]?\d*)[ ._:/]+(?P<rest>.+)"
)
"""A name that begins with a car's number, or with what a car is called."""
_OWN = re.compile(r"(?i)ego|hero|own")
_FEWEST_ALIKE = 3
"""Names that are alike behind two cars, from which on they are columns of two [1]; judgement: a car and its player
may both have a speed."""


def columns_of_one_car(infos: Sequence[RawChannelInfo]) -> tuple[list[RawChannelInfo], str]:
    """Return the columns of one car and those of none, and what to say of the others; all where there is one car.

    The car is the one that is called the own, else the first.
    """
    cars: dict[str, dict[str, RawChannelInfo]] = {}
    for info in infos:
        if found := _OF_A_CAR.fullmatch(info.name):
            cars.setdefault(found["car"], {})[found["rest"]] = info
    alike = [
        car
        for car, columns in cars.items()
        if any(other != car and len(columns.keys() & rest.keys()) >= _FEWEST_ALIKE for other, rest in cars.items())
    ]
    if len(alike) < 2:
        return list(infos), ""
    chosen = next((car for car in alike if _OWN.search(car)), alike[0])
    left_out = {info.name for car in alike if car != chosen for info in cars[car].values()}
    kept = [info for info in infos if info.name not in left_out]
    first = next(iter(cars[chosen].values())).name
    words = (
        f"holds columns of {len(alike)} cars ({', '.join(alike[:6])}): those of {chosen}, such as {first!r}, are taken"
    )
    return kept, words
