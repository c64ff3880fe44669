"""Figures of a diagnosis: where the gap is, what explains it beside what does not, and whether that helps."""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

from split_cli.diagnosis.statement.improvement import HorizonErrors, Improvement
from split_cli.diagnosis.statement.result import Diagnosis, Finding, GapSeries
from split_cli.diagnosis.statement.sentences import gap_left, unexplained_part
from split_cli.diagnosis.statement.wording import amount, number, percent, term_name
from split_cli.plots.style import EMPTY, LABEL_UNITS, PALETTE, STATES, new_figure, quiet

_FORCES = ("longitudinal", "front lateral", "rear lateral")
_BEFORE, _AFTER, _NEUTRAL, _BOTH = PALETTE[0], PALETTE[1], "0.45", PALETTE[2]
_STAGES = (
    ("before", "simulation as it is", _BEFORE),
    ("physics", "with the identified effects", _AFTER),
    ("split_only", "with SPLIT only", _NEUTRAL),
    ("after", "with effects and SPLIT", _BOTH),
)
# For each force, the axes over which its gap is shown: columns of a gap's operating point.
_AXES = (((3, "$v_x$ [m/s]"), (2, "$T/T_{max}$")),) + tuple(
    ((k, rf"$\alpha_{axle}$ [rad]"), (2, "$T/T_{max}$")) for k, axle in ((0, "f"), (1, "r"))
)
_CELLS = 22
_FEWEST = 3
_MOST_POINTS = 6000
_SHOWN_FINDINGS = 3


def diagnosis_figures(diagnosis: Diagnosis) -> Iterator[tuple[str, Figure]]:
    """Yield name and figure of everything there is to draw; nothing where no gap was found."""
    if diagnosis.verdict != "mismatch":
        return
    if diagnosis.location is not None and any(gap.compared.any() for gap in diagnosis.gaps):
        yield "where", draw_where(diagnosis)
    if diagnosis.findings or diagnosis.remainder is not None:
        yield "what", draw_what(diagnosis)
    if diagnosis.improvement is not None:
        yield "help", draw_help(diagnosis.improvement, named=bool(diagnosis.findings))


def gap_map(
    gaps: Sequence[GapSeries], force: int, columns: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return borders of cells over two columns of the operating point, and the mean gap force of each cell [N].

    Means are over compared rows of all drives, shape (A, B); NaN below three rows.
    """
    point = np.concatenate([gap.operating_point[gap.compared][:, list(columns)] for gap in gaps])
    values = np.concatenate([gap.forces[gap.compared, force] for gap in gaps])
    limits = np.quantile(point, [0.002, 0.998], axis=0)
    limits[1] = np.maximum(limits[1], limits[0] + 1e-9)
    borders = [np.linspace(*limits[:, k], _CELLS + 1) for k in range(2)]
    total, _, _ = np.histogram2d(*point.T, bins=borders, weights=values)
    count, _, _ = np.histogram2d(*point.T, bins=borders)
    with np.errstate(invalid="ignore"):
        return *borders, np.where(count >= _FEWEST, total / count, np.nan)


def draw_where(diagnosis: Diagnosis) -> Figure:
    """Draw the gap of the force that has most of it: over operating points, along the track, over time."""
    location, gaps = diagnosis.location, diagnosis.gaps
    force = int(np.argmax([location.forces[name.replace(" ", "_")] for name in _FORCES]))
    figure = new_figure(8.0)
    layout = figure.add_gridspec(2, 2, height_ratios=(1.6, 1.0))
    around, track, strip = (figure.add_subplot(layout[at]) for at in ((0, 0), (0, 1), (1, slice(None))))
    shown = np.concatenate([gap.forces[gap.compared, force] for gap in gaps])
    bound = max(float(np.quantile(np.abs(shown), 0.98)), 1e-9)
    norm = TwoSlopeNorm(0.0, -bound, bound)
    (first, x_name), (second, y_name) = _AXES[force]
    *borders, means = gap_map(gaps, force, (first, second))
    mesh = around.pcolormesh(*borders, means.T, cmap="RdBu_r", norm=norm)
    around.set(xlabel=x_name, ylabel=y_name, facecolor="0.95")
    around.locator_params(axis="x", nbins=5)
    around.set_title("mean over operating points", fontsize="medium", loc="left")
    _draw_track(track, diagnosis, force, norm)
    _draw_strip(strip, diagnosis, force)
    figure.colorbar(mesh, ax=[around, track], label=f"{_FORCES[force]} gap force [N]", extend="both", pad=0.01)
    share = location.forces[_FORCES[force].replace(" ", "_")]
    figure.suptitle(f"Reality less simulation: {percent(share)} of the gap is in {_FORCES[force]} force")
    return figure


def _draw_track(axis: Axes, diagnosis: Diagnosis, force: int, norm: TwoSlopeNorm) -> None:
    """Draw the path, or the gap over distance where no position was recorded."""
    placed = any(np.isfinite(gap.x).any() for gap in diagnosis.gaps)
    every = max(1, sum(len(gap.t) for gap in diagnosis.gaps) // _MOST_POINTS)
    for gap in diagnosis.gaps:
        good = gap.compared[::every]
        x, y = (gap.x, gap.y) if placed else (gap.s, gap.forces[:, force])
        x, y, value, s = (column[::every] for column in (x, y, gap.forces[:, force], gap.s))
        inside = _on_stretch(s, diagnosis) & good
        axis.plot(x[inside], y[inside], "o", color="#ffd84d", markersize=9.0, zorder=1)
        axis.scatter(x[~good], y[~good], s=2.0, color="0.75", zorder=2)
        order = np.argsort(np.abs(value[good]))
        points = (x[good][order], y[good][order])
        axis.scatter(*points, c=value[good][order], s=7.0, cmap="RdBu_r", norm=norm, zorder=3)
    quiet(axis)
    if placed:
        axis.set_aspect("equal", adjustable="datalim")
        axis.set(xlabel="X [m]", ylabel="Y [m]")
    else:
        axis.set(xlabel="track position s [m]", ylabel=f"{_FORCES[force]} gap force [N]")
    marked = " (yellow: where it stands out)" if diagnosis.location.place is not None else ""
    axis.set_title(f"along the track{marked}", fontsize="medium", loc="left")


def _on_stretch(s: np.ndarray, diagnosis: Diagnosis) -> np.ndarray:
    place = diagnosis.location.place
    if place is None:
        return np.zeros(len(s), dtype=bool)
    after, before = s >= place.s_start, s <= place.s_end
    return after & before if place.s_start <= place.s_end else after | before


def _draw_strip(axis: Axes, diagnosis: Diagnosis, force: int) -> None:
    quiet(axis)
    named, begin = bool(diagnosis.findings), 0.0
    if diagnosis.location.time is not None:
        axis.axvspan(*diagnosis.location.time, color="#fff0b8", linewidth=0)
    for k, gap in enumerate(diagnosis.gaps):
        # Drives stand side by side.
        t = begin + gap.t - (gap.t[0] if k else 0.0)
        begin = t[-1] + 2.0
        holes = np.flatnonzero(np.diff(gap.t) > 2.5 * np.median(np.diff(gap.t))) + 1
        for values, colour, name in (
            (gap.forces, _BEFORE, "gap"),
            (gap.remainder if named else None, _AFTER, "residual with the identified effects"),
        ):
            if values is not None:
                one = np.where(gap.compared, values[:, force], np.nan)
                label = name if k == 0 else f"_{name}"
                axis.plot(
                    np.insert(t, holes, np.nan), np.insert(one, holes, np.nan), color=colour, lw=0.8, label=label
                )
    axis.axhline(0.0, color="0.5", linewidth=0.6)
    axis.set(xlabel="time [s]", ylabel=f"{_FORCES[force]} gap [N]")
    axis.legend(loc="upper right", ncols=2, frameon=False, fontsize="small")
    axis.margins(x=0.01)


def draw_what(diagnosis: Diagnosis) -> Figure:
    """Draw, finding by finding, how much worse every other term is, and what a flexible fit finds in the rest."""
    findings = diagnosis.findings[:_SHOWN_FINDINGS]
    rest = diagnosis.remainder
    groups = () if rest is None or not diagnosis.unexplained else [pair for pair in rest.by_group if pair[1] > 0.0]
    rows = [2 + len(finding.runners_up) for finding in findings] + ([1 + len(groups)] if groups else [])
    figure = new_figure(0.5 + 0.27 * sum(rows) + 0.5 * len(rows))
    axes = np.atleast_1d(figure.subplots(len(rows), 1, height_ratios=rows))
    for axis, finding in zip(axes, findings, strict=False):
        _draw_rivals(axis, finding)
    if groups:
        names, saved = zip(*groups, strict=True)
        axes[-1].barh(range(len(names)), saved, color=_NEUTRAL, height=0.6)
        axes[-1].set_yticks(range(len(names)), names)
        axes[-1].invert_yaxis()
        axes[-1].set_xlabel("what a flexible fit of the residual depends on [χ²]")
        title = f"residual: {gap_left(findings, rest)} is unexplained"
        axes[-1].set_title(title, fontsize="medium", loc="left")
        quiet(axes[-1])
    if findings:
        said = "What the simulation lacks: " + ", ".join(term_name(one.term) for one in findings)
        said += f", and {unexplained_part(findings, rest)}" if diagnosis.unexplained else ""
    else:
        said = "No effect of the catalogue explains the gap"
    figure.suptitle(said)
    return figure


def _draw_rivals(axis: Axes, finding: Finding) -> None:
    placebo = finding.placebo
    names, sizes, errors, colours = [f"{term_name(finding.term)} (chosen)"], [0.0], [0.0], [_AFTER]
    for rival in finding.runners_up:
        same = finding.is_as_good(rival)
        note = " (as good)" if same else " (placebo)" if rival is placebo else ""
        names.append(term_name(rival.term) + note)
        sizes.append(rival.excess)
        errors.append(abs(rival.excess / rival.z) if rival.z else 0.0)
        colours.append(PALETTE[4] if same else _BEFORE)
    place = np.arange(len(names))
    axis.hlines(place, 0.0, sizes, color=colours, linewidth=4.0, alpha=0.45)
    axis.errorbar(sizes, place, xerr=1.96 * np.array(errors), fmt="none", ecolor="0.25", elinewidth=1.0)
    axis.scatter(sizes, place, color=colours, s=34, zorder=3)
    axis.set_yticks(place, names)
    axis.invert_yaxis()
    axis.set_xscale("symlog", linthresh=10.0)
    axis.set_xlim(left=min(-1.0, 1.3 * min(sizes)))
    axis.axvline(0.0, color="0.4", linewidth=0.8)
    axis.set_xlabel("cost above the chosen term [χ²], with 95 % interval over blocks of time")
    values = ", ".join(f"{name} {amount(estimate)}" for name, estimate in finding.parameters.items())
    axis.set_title(f"{term_name(finding.term)}: {values}", fontsize="medium", loc="left")
    quiet(axis)


def draw_help(improvement: Improvement, *, named: bool = True) -> Figure:
    """Draw held-out errors of one step and of rollouts, stage by stage, with the noise floor in grey.

    Where nothing was named, stages with identified effects are left out: they add nothing.
    """
    stages = [one for one in _STAGES if named or one[0] in ("before", "split_only")]
    heights = (2.4, 3.6) if improvement.rollouts else (2.4,)
    figure = new_figure(sum(heights) + 0.6)
    axes = figure.subplots(len(heights), 3, squeeze=False, height_ratios=heights)
    for state, axis in enumerate(axes[0]):
        _draw_step(axis, improvement, state, stages)
    axes[0, 0].set_yticks(range(len(stages)), [name for _, name, _ in stages])
    if improvement.rollouts:
        for state, axis in enumerate(axes[1]):
            _draw_growth(axis, improvement.rollouts, state, stages)
        handles, labels = axes[1, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False, fontsize="small")
    removed = improvement.removed.get("physics" if named else "split_only")
    said = "Held-out errors, 95 % intervals; grey: noise floor"
    if removed is not None:
        share, low, high = removed
        model = "The identified effects" if named else "SPLIT alone"
        interval = f"({100 * low:.0f} to {100 * high:.0f} %)"
        verb = "remove" if named else "removes"
        said = f"{model} {verb} {percent(max(share, 0.0))} {interval} of the one-step error above the noise floor"
    figure.suptitle(said)
    return figure


def _draw_step(axis: Axes, improvement: Improvement, state: int, stages: Sequence[tuple[str, str, str]]) -> None:
    values = [getattr(improvement, stage)[state] for stage, _, _ in stages]
    ends = list(values)
    for row, (stage, _, colour) in enumerate(stages):
        interval = (improvement.confidence.get(stage) or [None] * 3)[state]
        if interval is not None:
            axis.plot(interval, [row, row], color=colour, linewidth=2.5)
            ends += interval
        axis.plot(values[row], row, "o", color=colour)
    if improvement.noise_floor is not None:
        floor = improvement.noise_floor[state]
        axis.axvspan(0.0, floor, color=EMPTY, linewidth=0)
        ends.append(floor)
    span = max(max(ends) - min(ends), 1e-9)
    axis.set_xlim(min(ends) - 0.15 * span, max(ends) + 0.15 * span)
    axis.set_ylim(len(stages) - 0.5, -0.5)
    axis.set_yticks([])
    axis.set_xlabel(f"one-step rms error of {STATES[state]} [{LABEL_UNITS[state]}]")
    axis.set_title(
        f"persistence {number(improvement.persistence[state])}", fontsize="small", loc="right", color="0.4"
    )
    quiet(axis)


def _draw_growth(
    axis: Axes, rollouts: Sequence[HorizonErrors], state: int, stages: Sequence[tuple[str, str, str]]
) -> None:
    horizons = np.array([one.horizon for one in rollouts])
    axis.fill_between(horizons, [one.noise_floor[state] for one in rollouts], color=EMPTY, linewidth=0)
    for k, (stage, name, colour) in enumerate(stages):
        values = np.array([getattr(one, stage)[state] for one in rollouts])
        intervals = np.array(
            [(one.confidence.get(stage) or [[v, v]] * 3)[state] for one, v in zip(rollouts, values, strict=True)]
        )
        error = np.abs(intervals.T - values)
        shift = horizons * (1.0 + 0.012 * (k - 0.5 * (len(stages) - 1)))
        axis.errorbar(
            shift, values, yerr=error, fmt="o-", color=colour, ms=4.0, lw=1.3, elinewidth=1.0, label=name
        )
    still = [one.persistence[state] for one in rollouts]
    axis.plot(horizons, still, "s--", color="0.65", markersize=3.5, linewidth=1.0, label="persistence")
    axis.set_yscale("log")
    axis.set_xlabel("time predicted [s]")
    axis.set_xticks(horizons)
    axis.set_ylabel(f"rms error of {STATES[state]} [{LABEL_UNITS[state].replace('/s²', '/s')}]")
    quiet(axis)
