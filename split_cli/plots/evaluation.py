"""All figures of an evaluation, written into one folder."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from split_cli.files import atomic_directory, write_digests
from split_cli.learning.kernel import OUTPUTS
from split_cli.plots.chart import Chart
from split_cli.plots.draw import CHARTS, write_charts
from split_cli.plots.feature_space import draw_coverage, draw_labels
from split_cli.plots.sizes import draw_sizes
from split_cli.plots.style import save
from split_cli.scoring.run import EvaluationRun


@dataclass(frozen=True)
class FigureFiles:
    """Figures of one evaluation."""

    written: tuple[str, ...]  # names of the files
    left_out: tuple[str, ...]  # ``name: reason`` of those that this evaluation has no content for


def write_figures(
    run: EvaluationRun, folder: str | Path, charts: Sequence[Chart] = (), also: Mapping[str, str] | None = None
) -> FigureFiles:
    """Draw an evaluation into a folder: all files appear together, or none; figures of an earlier one go.

    Parameters
    ----------
    folder : path
        Files of other names that are in it stay.
    charts : sequence of Chart
        Of its report.
    also : mapping of str to str, optional
        Text files that belong to the figures, by name.
    """
    figures, left_out = draw_figures(run)
    earlier = [*(f"{name}.png" for name in CHARTS), *(entry.split(":")[0] for entry in left_out)]
    with atomic_directory(folder, without=earlier) as temporary:
        for name, text in (also or {}).items():
            (temporary / name).write_text(text, encoding="utf-8")
        for name, figure in figures.items():
            save(figure, temporary / name)
        drawn = write_charts(charts, temporary)
        write_digests(temporary)
    return FigureFiles((*drawn, *figures), left_out)


def draw_figures(run: EvaluationRun) -> tuple[dict[str, Figure], tuple[str, ...]]:
    """Return figures beside the report's charts by file name, and ``name: reason`` of those without content."""
    drawing: dict[str, tuple[bool, str, Callable[[], Figure]]] = {
        "sizes.png": (bool(run.report.sizes), "one feature set, no --sizes", lambda: draw_sizes(run))
    }
    at = next((i for i, own in enumerate(run.sets) if own.features.is_z2), None)
    other = "it is drawn for the features z2 only"
    drawing["coverage.png"] = (at is not None, other, lambda: draw_coverage(run.sets[at]))
    for output, state in enumerate(OUTPUTS):
        drawing[f"error-map-{state}.png"] = (
            at is not None,
            other,
            lambda output=output: draw_labels(run.sets[at], run.held[at], output),
        )
    figures = {name: draw() for name, (possible, _, draw) in drawing.items() if possible}
    left_out = tuple(f"{name}: {reason}" for name, (possible, reason, _) in drawing.items() if not possible)
    return figures, left_out
