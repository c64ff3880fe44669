"""Races and manoeuvres in closed loop: lap times, best laps, learning over laps, trajectories between cones."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from split_cli.plots.style import PALETTE, STATES, new_figure, quiet
from split_cli.signals import STANDARD_GRAVITY


@dataclass(frozen=True)
class RacePicture:
    """What figures show of one race."""

    number: np.ndarray  # (L,): of laps
    # time, mean_speed: (L,): [s], NaN where unfinished or off the track; [m/s].
    time: np.ndarray
    mean_speed: np.ndarray
    # updates, size, cells: (L,)
    updates: np.ndarray
    size: np.ndarray
    cells: np.ndarray
    # before, after: (L, 3): errors of the exact motion, of the nominal model and with the residual.
    before: np.ndarray
    after: np.ndarray
    # Of the best lap, a row an interval: s [m], X, Y [m], v_x [m/s], a_x, a_y [m/s^2], front and rear slip angle
    # [rad].
    best: np.ndarray


@dataclass(frozen=True)
class ManeuverPicture:
    """What figures show of one run."""

    title: str
    # line, cones: (N, 2): [m]
    line: np.ndarray
    cones: np.ndarray
    runs: Mapping[str, tuple[np.ndarray, np.ndarray]]  # by model: places (N, 2) of the CG and cones hit (H, 2) [m]


def _colour(position: int) -> str:
    return "black" if position == 0 else PALETTE[(position - 1) % len(PALETTE)]


def draw_lap_times(races: Mapping[str, Sequence[RacePicture]]) -> Figure:
    """Draw lap time, mean speed and improvement over laps; a thin line a seed."""
    figure = new_figure(3.6)
    axes = figure.subplots(1, 3)
    base = np.nanmean([np.nanmin(race.time) for race in next(iter(races.values()))])
    for position, (name, group) in enumerate(races.items()):
        for k, race in enumerate(group):
            style = {"color": _colour(position), "marker": "o", "markersize": 3, "linewidth": 1.0}
            label = name if k == 0 else None
            axes[0].plot(race.number, race.time, label=label, **style)
            axes[1].plot(race.number, race.mean_speed, **style)
            axes[2].plot(race.number, 100.0 * (1.0 - race.time / base), **style)
    for axis, title in zip(axes, ("lap time [s]", "mean speed [m/s]", "gain on the best nominal lap [%]"), strict=True):
        axis.set(xlabel="lap", title=title)
        quiet(axis)
    figure.legend(frameon=False, ncols=len(races), loc="outside upper center")
    return figure


def draw_best_laps(races: Mapping[str, RacePicture]) -> Figure:
    """Draw the best lap of each model: speed profile, trajectory, GG diagram, slip angles."""
    figure = new_figure(9.0)
    speed, track, gg, front, rear = _best_axes(figure)
    for position, (name, race) in enumerate(races.items()):
        s, x, y, vx, ax, ay, alpha_f, alpha_r = race.best.T
        style = {"color": _colour(position), "linewidth": 0.9}
        speed.plot(s, vx, label=name, **style)
        track.plot(x, y, **style)
        sideways, forward = ay / STANDARD_GRAVITY, ax / STANDARD_GRAVITY
        gg.plot(sideways, forward, linestyle="none", marker=".", markersize=2, color=_colour(position))
        front.plot(s, alpha_f, **style)
        rear.plot(s, alpha_r, **style)
    speed.set(xlabel="progress [m]", ylabel="$v_x$ [m/s]")
    speed.legend(frameon=False, ncols=len(races))
    track.set(xlabel="X [m]", ylabel="Y [m]", aspect="equal")
    gg.set(xlabel="$a_y$ [g]", ylabel="$a_x$ [g]", aspect="equal")
    front.set(xlabel="progress [m]", ylabel="front slip angle [rad]")
    rear.set(xlabel="progress [m]", ylabel="rear slip angle [rad]")
    for axis in (speed, track, gg, front, rear):
        quiet(axis)
    return figure


def _best_axes(figure: Figure) -> tuple:
    grid = figure.add_gridspec(4, 2, height_ratios=(1.0, 1.4, 0.8, 0.8))
    places = (grid[0, :], grid[1, 0], grid[1, 1], grid[2, :], grid[3, :])
    return tuple(figure.add_subplot(place) for place in places)


def draw_learning(races: Mapping[str, RacePicture]) -> Figure:
    """Draw set size, updates and cells over laps, and errors beside the nominal model's."""
    figure = new_figure(6.0)
    axes = figure.subplots(2, 3)
    for position, (name, race) in enumerate(races.items(), 1):
        style = {"color": _colour(position), "marker": "o", "markersize": 3, "label": name}
        # A dictionary has no cells.
        for axis, values in zip(axes[0], (race.size, race.updates, race.cells), strict=True):
            if values.any():
                axis.plot(race.number, values, **style)
        for output, axis in enumerate(axes[1]):
            axis.plot(race.number, race.after[:, output], **style)
            axis.plot(race.number, race.before[:, output], color=_colour(position), linestyle=":", linewidth=1.0)
    for axis, title in zip(axes[0], ("points", "updates a lap", "non-empty cells"), strict=True):
        axis.set(title=title)
    for axis, state, unit in zip(axes[1], STATES, ("m/s²", "m/s²", "rad/s²"), strict=True):
        axis.set(title=f"error of {state} [{unit}], dotted: nominal", xlabel="lap")
        axis.set_ylim(bottom=0.0)
    for axis in axes.ravel():
        quiet(axis)
    axes[0, 0].legend(frameon=False)
    return figure


def draw_maneuvers(pictures: Sequence[ManeuverPicture]) -> Figure:
    """Draw trajectories between cones, one axes a manoeuvre; a cross in a model's colour is a cone it hit."""
    figure = new_figure(2.3 * len(pictures) + 0.3)
    for axis, picture in zip(figure.subplots(len(pictures), 1, squeeze=False)[:, 0], pictures, strict=True):
        axis.plot(*picture.line.T, color="0.75", linewidth=1.0, label="line")
        for centre in picture.cones:
            axis.add_patch(Circle(centre, 0.15, fill=False, color="0.4", linewidth=0.7))
        for position, (name, (places, hit)) in enumerate(picture.runs.items()):
            axis.plot(*places.T, color=_colour(position), linewidth=1.0, label=name)
            axis.plot(*hit.T, linestyle="none", marker="x", color=_colour(position), markersize=8 - 2 * position)
        axis.set(title=picture.title, ylabel="Y [m]")
        axis.set_xlim(picture.cones[:, 0].min() - 10.0, picture.cones[:, 0].max() + 10.0)
        quiet(axis)
        axis.legend(frameon=False, ncols=4, fontsize="small")
    axis.set_xlabel("X [m]")
    return figure
