"""Errors of open-loop simulation over its duration."""

import numpy as np
from matplotlib.figure import Figure

from split_cli.plots.style import STATES, headed, legend_below, line_styles, model_name, new_figure, quiet
from split_cli.scoring.evaluation import NOMINAL
from split_cli.scoring.run import EvaluationRun

_PANELS = ("$v_x$ [m/s]", "$v_y$ [m/s]", "$r$ [rad/s]", "position [m]")


def draw_rollouts(run: EvaluationRun) -> Figure:
    """Draw the rms error of v_x, v_y, r and position over the time predicted, a line a model."""
    styles = line_styles(run.rollouts)
    step = run.held[0][0].labels.horizon
    figure = new_figure(7.0)
    axes = figure.subplots(2, 2, sharex=True).ravel()
    for panel, axis in enumerate(axes):
        quiet(axis)
        for key, sums in run.rollouts.items():
            elapsed = step * np.arange(1, len(sums.squared) + 1)
            error = sums.distance if panel == 3 else sums.rmse[:, panel]
            if np.isfinite(error).any():
                axis.plot(elapsed, error, **styles[key])
            else:
                axis.text(0.5, 0.5, "no position was recorded", ha="center", transform=axis.transAxes)
                break
        else:
            axis.set_yscale("log")
        axis.set_ylabel(f"rms error of {_PANELS[panel]}")
        axis.set_xlim(left=0.0)
    for axis in axes[2:]:
        axis.set_xlabel("time predicted [s]")
    legend_below(figure, axes[0])
    figure.suptitle(_finding(run, step))
    return figure


def _finding(run: EvaluationRun, step: float) -> str:
    nominal = run.rollouts[NOMINAL, ""]
    corrected = headed(run.rollouts, run.report.settings.predictors)
    starts = f"{nominal.count} starts" + (f", {nominal.diverged} more diverged" if nominal.diverged else "")
    if corrected is None or not nominal.count:
        return f"Rollouts with recorded inputs from {starts}"
    ratio = run.rollouts[corrected].rmse[-1] / nominal.rmse[-1]
    parts = ", ".join(f"{share:.2f} ({name})" for name, share in zip(STATES, ratio, strict=True))
    end = step * len(nominal.squared)
    return f"After {end:.3g} s errors of {model_name(corrected)} are {parts} times the nominal model's; {starts}"
