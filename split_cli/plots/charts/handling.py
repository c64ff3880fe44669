"""Understeer gradient and steering frequency response of real and simulated car."""

from collections.abc import Sequence

import numpy as np

from split_cli.plots.chart import Chart, ChartLine, thinned
from split_cli.plots.charts.drive import Subject
from split_cli.scoring.handling.steering_response import steering_response
from split_cli.scoring.handling.understeer import DEG_PER_G, Understeer, understeer_of
from split_cli.vehicle.parameters import Vehicle

_MOST_DOTS = 700


def handling_charts(subjects: Sequence[Subject], vehicle: Vehicle) -> tuple[Chart, ...]:
    """Return charts of understeer and of the steering response; none where no recording shows them."""
    charts = []
    moving = [(one, one.drive if one.vehicle is None else one.motion) for one in subjects]
    found = [(one, motion and understeer_of(motion, vehicle)) for one, motion in moving]
    shown = [(one, gradient) for one, gradient in found if gradient]
    known = any(one.vehicle is None for one, _ in shown)
    if known:
        charts.append(_understeer(shown, [one.name for one, gradient in found if not gradient]))
    responses = [
        (one, one.lateral_motion and steering_response(one.lateral_motion, vehicle.minimum_speed)) for one in subjects
    ]
    coherent = [(one, response) for one, response in responses if response]
    if any(one.vehicle is None for one, _ in coherent):
        gain = tuple(
            ChartLine(one.name, r.frequency, r.gain, one.role, low=r.gain_low, high=r.gain_high, shown=one.shown)
            for one, r in coherent
        )
        phase = tuple(ChartLine(one.name, r.frequency, r.phase, one.role, shown=one.shown) for one, r in coherent)
        count = coherent[0][1].windows
        note = f"{count} stretches of 8 s; only where steering and yaw rate are coherent; bands are 95 %."
        note += " A lower gain is less yaw rate for the same steering."
        note += "" if known else " Too little gentle, steady cornering was measured for an understeer gradient."
        charts.append(
            Chart(
                "response-gain",
                "Steering response: gain",
                "frequency [Hz]",
                "r/delta [1/s]",
                gain,
                note,
                group="response",
            )
        )
        charts.append(
            Chart(
                "response-phase",
                "Steering response: phase",
                "frequency [Hz]",
                "phase [deg]",
                phase,
                "The further below 0, the later the car answers its steering.",
                group="response",
            )
        )
    return tuple(charts)


def understeer_words(name: str, found: Understeer) -> str:
    """Return a gradient as handling engineers quote it."""
    low, high = (DEG_PER_G * value for value in found.interval)
    return f"{name} {DEG_PER_G * found.gradient:.2f} deg/g (95 %: {low:.2f} to {high:.2f})"


def _understeer(shown: Sequence[tuple[Subject, Understeer]], missing: Sequence[str]) -> Chart:
    series = []
    for one, found in shown:
        if one.vehicle is None:
            part = thinned(len(found.lateral), _MOST_DOTS)
            x, y = found.lateral[part], found.slip_difference[part]
            series.append(ChartLine(f"{one.name}, moments", x, y, one.role, "points", shown=one.shown))
        reach = np.clip([np.min(found.lateral), np.max(found.lateral)], -_reach(found), _reach(found))
        line = found.offset + found.gradient * reach
        series.append(ChartLine(one.name, reach, line, one.role, shown=one.shown))
    ranges = [f"{_reach(found):.1f}" for _, found in shown]
    words = "; ".join(
        f"{understeer_words(one.name, found)} over |a_y| up to {reach} m/s²"
        for (one, found), reach in zip(shown, ranges, strict=True)
    )
    note = f"The slope is the understeer gradient (steeper is more understeer): {words}."
    if len(set(ranges)) > 1:
        note += (
            " These ranges differ, since each recording holds gentle cornering of its own "
            f"(|a_y| up to {shown[0][1].limit:.1f} m/s² counts). Over different ranges one and the same car may have "
            "different slopes, so these do not show a difference of the cars."
        )
    if missing:
        note += f" There is too little gentle cornering for a slope of {', '.join(missing)}."
    return Chart("understeer", "Understeer gradient", "a_y [m/s²]", "alpha_f − alpha_r [rad]", tuple(series), note)


def _reach(found: Understeer) -> float:
    """Return the |a_y| [m/s^2] up to which moments were used, the farthest 0.5 % left out."""
    return float(np.quantile(np.abs(found.lateral), 0.995))
