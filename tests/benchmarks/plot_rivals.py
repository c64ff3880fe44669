"""Cost and error over the number of samples, drawn from rows of `bench_rivals`.

python -m tests.benchmarks.bench_rivals --streaming --sizes 100,1000,4151,20000,50000 --json rows.json
python -m tests.benchmarks.plot_rivals rows.json docs/figures/rivals-over-size.png
"""

import json
from pathlib import Path

import click
import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402

PANELS = (
    ("Update, median (line) and 99th percentile [us]", "update_p50", "update_p99"),
    ("Query, median (line) and 99th percentile [us]", "query_p50", "query_p99"),
    ("Error against the truth, RMSE [signal deviations]", "rmse", None),
)


@click.command()
@click.argument("rows", type=click.Path(exists=True, path_type=Path))
@click.argument("picture", type=click.Path(path_type=Path))
def main(rows: Path, picture: Path) -> None:
    """Draw PICTURE from the ROWS of a run of several sizes."""
    found = json.loads(rows.read_text())["rows"]
    names = list(dict.fromkeys(row["name"] for row in found))
    figure, axes = plt.subplots(1, len(PANELS), figsize=(13, 4.2), layout="constrained")
    for axis, (title, typical, tail) in zip(axes, PANELS, strict=True):
        for number, name in enumerate(names):
            shown = [row for row in found if row["name"] == name and row[typical] is not None]
            sizes = [row["size"] for row in shown]
            if not shown:
                continue
            axis.plot(sizes, [row[typical] for row in shown], "o-", color=f"C{number}", label=name)
            if tail is not None:
                axis.plot(sizes, [row[tail] for row in shown], "^", color=f"C{number}", alpha=0.5)
        axis.set(xscale="log", yscale="log", xlabel="samples", title=title)
        axis.title.set_fontsize(9)
        axis.grid(True, which="both", alpha=0.2)
    handles = {t: h for axis in axes for h, t in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncol=3, fontsize=8)
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    main()
