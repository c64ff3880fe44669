"""Sections of charts that all HTML pages share, in the order in which an engineer looks at them."""

from collections.abc import Sequence

from split_cli.plots.chart import Chart
from split_cli.workflows.report.markup import charts_block, section

#: Names of sections: id, title, how the names of their charts begin, and whether three stand side by side.
_SECTIONS = (
    ("motion", "Measured and simulated", ("strip-",), False),
    ("tires", "Axle forces and tyres", ("tire-", "force-"), True),
    ("handling", "Handling: understeer and steering response", ("understeer", "response-"), True),
    ("grip", "Accelerations and track", ("gg", "path"), False),
    ("labels", "Error of the nominal model, and its prediction", ("label-",), False),
    ("white", "Is the remaining error noise?", ("white-",), True),
    ("coverage", "Do the intervals hold?", ("coverage-",), True),
    ("growth", "How the set grew", ("growth",), False),
)


def chart_sections(charts: Sequence[Chart]) -> list[str]:
    """Return a section for each kind of chart there is."""
    found = []
    for name, title, begins, thirds in _SECTIONS:
        mine = [chart for chart in charts if chart.name.startswith(begins)]
        if mine:
            found.append(section(name, title, charts_block(mine, thirds=thirds)))
    return found
