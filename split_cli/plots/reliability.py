"""Calibration of intervals: the share of labels inside, against the promised share."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from split_cli.plots.style import PALETTE, STATES, headed, legend_below, line_styles, new_figure, quiet
from split_cli.scoring.run import EvaluationRun


def draw_reliability(run: EvaluationRun) -> Figure:
    """Draw observed against promised coverage of central intervals, a panel a state."""
    scored = {key: tally for key, tally in run.tallies.items() if tally.probability is not None}
    styles = line_styles(scored)
    first = headed(scored, run.report.settings.predictors)
    figure = new_figure(5.2)
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    for state, axis in enumerate(axes):
        quiet(axis)
        axis.plot([0, 100], [0, 100], color="0.6", linewidth=1.0, linestyle=":", label="as promised")
        for key, tally in scored.items():
            promised, observed = tally.probability.reliability_curve
            axis.plot(100 * promised, 100 * observed[:, state], marker=".", **styles[key])
        inside = 100 * scored[first].probability.coverage[1, state]
        axis.set_title(f"{STATES[state]}: {inside:.0f} % inside the 95 % interval", fontsize="medium")
        _mark_95(axis, inside)
        axis.set_xlabel("promised [%]")
        axis.set_aspect("equal")
        axis.set(xlim=(0, 100), ylim=(0, 100))
    axes[0].set_ylabel("labels inside [%]")
    legend_below(figure, axes[0])
    count = scored[first].probability.count
    figure.suptitle(f"{_verdict(run, first)} ({count} test samples)")
    return figure


def _mark_95(axis: Axes, inside: float) -> None:
    """Show in the panel itself how far the 95 % interval is from what it promises."""
    axis.plot([95, 95], [inside, 95], color=PALETTE[1], linewidth=3.0, solid_capstyle="butt")
    label = f"95 % promised,\n{inside:.0f} % inside"
    place = {"xytext": (97, 8), "ha": "right", "fontsize": "small", "color": PALETTE[1]}
    axis.annotate(label, (95, inside), arrowprops={"arrowstyle": "-", "color": PALETTE[1], "lw": 0.8}, **place)


def _verdict(run: EvaluationRun, key: tuple[str, str]) -> str:
    """Say of the first predictor whether its intervals are too narrow, too wide or as promised."""
    promised, observed = run.tallies[key].probability.reliability_curve
    deviation = 100 * (observed - promised[:, None])
    worst = float(deviation.flat[abs(deviation).argmax()])
    name = f"{key[0]} on {key[1]}"
    if abs(worst) < 5.0:
        return f"Intervals of {name} hold what they promise within {abs(worst):.0f} percentage points"
    word = "wide" if worst > 0 else "narrow"
    return f"Intervals of {name} are too {word}, by up to {abs(worst):.0f} percentage points"
