"""Feature sets compared at equal size: error of a dense process on the most informative samples of each."""

from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, ScalarFormatter

from split_cli.plots.style import LABEL_UNITS, PALETTE, STATES, legend_below, new_figure, quiet
from split_cli.scoring.evaluation import NOMINAL
from split_cli.scoring.report import SizeScore
from split_cli.scoring.run import EvaluationRun

_MARKERS = "osD^vP"


def draw_sizes(run: EvaluationRun) -> Figure:
    """Draw error against set size, a line a feature set, with the nominal model and the noise floor."""
    report = run.report
    by_features: dict[str, list[SizeScore]] = {}
    for entry in report.sizes:
        by_features.setdefault(entry.score.features, []).append(entry)
    nominal = next(score for score in report.scores if score.name == NOMINAL and not score.drive)
    floor = report.noise_floor
    figure = new_figure(6.6)
    axes = figure.subplots(2, 2, sharex=True).ravel()
    for panel, axis in enumerate(axes):
        which = (panel - 1) % 4
        quiet(axis)
        axis.axhline(nominal.rmse[which], color="black", label="nominal")
        for position, (features, entries) in enumerate(by_features.items()):
            entries = sorted(entries, key=lambda entry: entry.score.points)
            axis.plot(
                [entry.score.points for entry in entries],
                [entry.score.rmse[which] for entry in entries],
                color=PALETTE[position % len(PALETTE)],
                marker=_MARKERS[position % len(_MARKERS)],
                label=features,
            )
        if floor.rms is not None:
            level = floor.norm if which == 3 else floor.rms[which]
            axis.axhline(level, color="0.5", linestyle="--", label="noise floor")
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(FixedLocator((10, 20, 50, 100, 200, 500, 1000, 2000)))
        axis.xaxis.set_major_formatter(ScalarFormatter())
        axis.xaxis.set_minor_locator(NullLocator())
        axis.set_ylim(bottom=0.0)
        axis.set_ylabel("rms norm of the error" if which == 3 else f"{STATES[which]}: rms [{LABEL_UNITS[which]}]")
    for axis in axes[2:]:
        axis.set_xlabel("samples in the set")
    legend_below(figure, axes[0])
    sample = " (IN SAMPLE)" if report.settings.protocol == "paper" else " on held-out time"
    figure.suptitle(_finding(by_features) + sample)
    return figure


def _finding(by_features: dict[str, list[SizeScore]]) -> str:
    """Say which features have the smaller error at the smallest and at the largest size they share."""
    common = [{entry.size for entry in entries} for entries in by_features.values()]
    sizes = sorted(set.intersection(*common), key=lambda size: size or 10**9)
    parts = []
    for size in dict.fromkeys((sizes[0], sizes[-1])):
        errors = {
            features: next(entry.score.rmse[3] for entry in entries if entry.size == size)
            for features, entries in by_features.items()
        }
        best = min(errors, key=errors.get)
        listed = ", ".join(f"{features} {error:.3g}" for features, error in errors.items())
        ahead = f"{best} ahead" if len(errors) > 1 else "one set"
        parts.append(f"{'all' if size == 0 else size} samples: {ahead} ({listed})")
    return "; ".join(parts)
