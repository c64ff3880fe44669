"""The charts of reports, from drives, vehicles and residuals: motion, tyres, handling, whiteness.

May import: what `plots` may.
"""

from split_cli.plots.charts.drive import Subject, drive_charts, track_chart
from split_cli.plots.charts.handling import handling_charts
from split_cli.plots.charts.learned import growth_chart, label_charts
from split_cli.plots.charts.residual import coverage_charts, whiteness_chart
from split_cli.plots.charts.tires import tire_charts, tire_charts_of_files

__all__ = [
    "Subject",
    "coverage_charts",
    "drive_charts",
    "growth_chart",
    "handling_charts",
    "label_charts",
    "tire_charts",
    "tire_charts_of_files",
    "track_chart",
    "whiteness_chart",
]
