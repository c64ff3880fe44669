"""Figure of a calibration: force curves with what is known of them, over the samples behind them."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes

from split_cli.errors import SplitError, nearest_names
from split_cli.files import atomic_path, refuse_what_cannot_be_written
from split_cli.vehicle.calibration.calibrate import Calibration
from split_cli.vehicle.calibration.curve import ForceCurve

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


def _draw_side(axis: Axes, curve: ForceCurve, side: float) -> None:
    """Draw a curve with its bands for one sign of the slip angle; the model is the same for both."""
    angle, named = side * curve.slip_angle, side > 0.0
    bands = (
        ("equally good curves", curve.alike_lower, curve.alike_upper, "C1", 0.25),
        ("95 % band", curve.lower, curve.upper, "C0", 0.35),
    )
    for name, low, high, colour, alpha in bands:
        label = name if named else None
        axis.fill_between(angle, side * low, side * high, color=colour, alpha=alpha, lw=0, label=label)
    axis.plot(angle, side * curve.force, color="C0", label="calibrated" if named else None)
    axis.axvline(side * curve.covered, color="0.3", ls=":", label="covered by the drives" if named else None)


def plot_calibration(calibration: Calibration, path: str | Path) -> None:
    """Draw each axle's curve, its confidence band, all equally good curves and the samples; and the resistance.

    Parameters
    ----------
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
        axis.plot(slip[::stride], force[::stride], ".", ms=1.5, color="0.7")
        # Left and right turns apart: a difference between them is seen, not folded away.
        for side in (1.0, -1.0):
            _draw_side(axis, curve, side)
        axis.set(title=f"{curve.axle} axle", xlabel="slip angle, left positive [rad]", ylabel="lateral force [N]")
        most = 1.3 * max(float(curve.force.max()), 1e-9)
        axis.set_ylim(-most, most)
        axis.axhline(0.0, color="0.8", lw=0.6)
        axis.legend(fontsize="small", loc="lower right")
    if calibration.resistance is not None:
        found = calibration.resistance
        axes[-1].fill_between(
            found.speed, found.force - found.half_width, found.force + found.half_width, color="C0", alpha=0.35, lw=0
        )
        axes[-1].plot(found.speed, found.force, color="C0")
        axes[-1].set(title="resistance", xlabel="speed [m/s]", ylabel="force [N]")
        axes[-1].set_ylim(bottom=0.0)
    with atomic_path(path) as temporary, matplotlib.rc_context({"svg.hashsalt": "split"}):
        figure.savefig(temporary, format=_format_of(path), dpi=130)
