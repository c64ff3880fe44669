"""Figure of a calibration: force curves with what is known of them, over the samples behind them."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

from split_cli.errors import SplitError, nearest_names
from split_cli.files import atomic_path, refuse_what_cannot_be_written
from split_cli.vehicle.calibration.calibrate import Calibration

__all__ = ["check_figure_path", "plot_calibration"]

_SHOWN_SAMPLES = 4000
_FORMATS = ("png", "svg", "pdf")


def check_figure_path(path: str | Path) -> None:
    """Check where a figure goes before the fit that it shows, so that a wrong name costs nothing.

    Raises
    ------
    SplitError
        If the suffix names no format, or the place cannot be written to.
    """
    refuse_what_cannot_be_written(path)
    suffix = _format_of(path)
    if suffix not in _FORMATS:
        raise SplitError(f"no figure format {suffix!r}", where=str(path), advice=nearest_names(suffix, _FORMATS))


def _format_of(path: str | Path) -> str:
    return Path(path).suffix.lstrip(".").lower() or "png"


def plot_calibration(calibration: Calibration, path: str | Path) -> None:
    """Draw each axle's curve, its confidence band, all equally good curves and the samples; and the resistance.

    Parameters
    ----------
    calibration : Calibration
    path : path
        PNG, SVG or PDF by its suffix.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels = len(calibration.curves) + (calibration.resistance is not None)
    figure = Figure(figsize=(5.0 * panels, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = np.atleast_1d(figure.subplots(1, panels))
    points = {
        "front": (calibration.slip_front, calibration.force_front),
        "rear": (calibration.slip_rear, calibration.force_rear),
    }
    for axis, curve in zip(axes, calibration.curves, strict=False):
        slip, force = points[curve.axle]
        stride = max(1, len(slip) // _SHOWN_SAMPLES)
        axis.plot(np.abs(slip[::stride]), np.sign(slip[::stride]) * force[::stride], ".", ms=1.5, color="0.7")
        axis.fill_between(
            curve.slip_angle, curve.alike_lower, curve.alike_upper, color="C1", alpha=0.25, lw=0,
            label="equally good curves",
        )  # fmt: skip
        axis.fill_between(
            curve.slip_angle, curve.lower, curve.upper, color="C0", alpha=0.35, lw=0, label="95 % band"
        )
        axis.plot(curve.slip_angle, curve.force, color="C0", label="calibrated")
        axis.axvline(curve.covered, color="0.3", ls=":", label="covered by the drives")
        axis.set(title=f"{curve.axle} axle", xlabel="|slip angle| [rad]", ylabel="lateral force [N]")
        axis.set_ylim(0.0, 1.6 * max(float(curve.force.max()), 1e-9))
        axis.legend(fontsize="small", loc="upper left")
    if calibration.resistance is not None:
        found = calibration.resistance
        axes[-1].fill_between(
            found.speed,
            found.force - found.half_width,
            found.force + found.half_width,
            color="C0",
            alpha=0.35,
            lw=0,
        )
        axes[-1].plot(found.speed, found.force, color="C0")
        axes[-1].set(title="resistance", xlabel="speed [m/s]", ylabel="force [N]")
        axes[-1].set_ylim(bottom=0.0)
    with atomic_path(path) as temporary, matplotlib.rc_context({"svg.hashsalt": "split"}):
        figure.savefig(temporary, format=_format_of(path), dpi=130)
