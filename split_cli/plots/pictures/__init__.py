"""Charts that a vehicle engineer looks at first, from drives, vehicles and residuals.

May import: what `plots` may.
"""

from split_cli.plots.pictures.drive import Subject, drive_charts, track_chart
from split_cli.plots.pictures.handling import handling_charts
from split_cli.plots.pictures.residual import coverage_charts, whiteness_chart
from split_cli.plots.pictures.tires import tire_charts

__all__ = [
    "Subject", "coverage_charts", "drive_charts", "handling_charts", "tire_charts", "track_chart",
    "whiteness_chart",
]  # fmt: skip
