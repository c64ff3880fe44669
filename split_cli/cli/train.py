"""`split train`."""

from __future__ import annotations

import click

from split_cli.cli.options import (
    existing_file,
    held_option,
    json_option,
    output_option,
    print_json,
    print_table,
    vehicle_option,
)
from split_cli.cli.voice import StepBar

__all__ = ["command"]


class TimeSpan(click.ParamType):
    """START:STOP in seconds."""

    name = "START:STOP"

    def convert(self, value, param, ctx) -> tuple[float, float]:
        """Return (start, stop)."""
        if isinstance(value, tuple):
            return value
        try:
            start, stop = (float(part) for part in value.split(":"))
        except ValueError:
            self.fail(f"{value!r} is not START:STOP in seconds, for example 60:90", param, ctx)
        if not start < stop:
            self.fail(f"{value!r} does not end after it starts", param, ctx)
        return start, stop


@click.command("train")
@click.argument("drives", nargs=-1, required=True, type=existing_file, metavar="DRIVE|LABELS|FOLDER...")
@vehicle_option()
@output_option("Trained set to write (NAME.split).")
@click.option("--append", is_flag=True, help="Continue the set that -o names, with its own settings.")
@click.option("--features", help="z2 (default), z1, or a comma-separated list of names.")
@click.option(
    "--hyperparameters",
    metavar="fit|default|FILE",
    help="Length scales and variances, fixed once a set is made; default: fit.",
)
@click.option("--horizon", type=float, metavar="S", help="Label interval h; default 0.05.")
@click.option("--stride", type=int, metavar="N", help="Samples between labels; default: the horizon.")
@click.option("--capacity", type=int, metavar="M", help="Points a cell keeps, 10; points iol keeps in all, 300.")
@click.option(
    "--learner",
    type=click.Choice(["split", "iol"]),
    help="split: cell by cell (default). iol: the rival, one dictionary, every point judged again.",
)
@click.option("--threshold", type=float, help="Gain a point needs to enter a cell with room; default 1e-3.")
@click.option("--cell-edge", type=float, metavar="FACTOR", help="Edge of the cells, in usual edges; default 1.")
@click.option(
    "--forgetting", type=float, metavar="S", help="Weigh gains down with age, time constant S; default off."
)
@click.option(
    "--plain-labels", "plain", is_flag=True, help="The paper's plain difference, damped; for reproduction."
)
@click.option(
    "--trust",
    metavar="held-out|full|VX,VY,R",
    help="Share of each correction to apply; default: what held-out blocks show. full: the paper's way.",
)
@click.option(
    "--lag",
    type=click.Choice(["held-out", "none"]),
    help="A torque that arrives late: put into the set where held-out blocks gain by it (default), or not.",
)
@click.option("--any-vehicle", is_flag=True, help="Warn, do not refuse, where a drive contradicts the vehicle.")
@click.option(
    "--exclude",
    type=TimeSpan(),
    multiple=True,
    help="Do not learn this stretch of time of the drives [s]; repeatable.",
)
@held_option
@click.option("--per-lap", is_flag=True, help="Also print what each lap added: the paper's table.")
@json_option
def command(drives, vehicle_path, output, append, per_lap, as_json, **settings) -> None:
    """Learn what the nominal model gets wrong, cell by cell, into a trained set.

    Each drive is labelled once. Files that `split label` wrote for this vehicle spare the labelling of their
    drives; labels alone train without the recording, with a --trust that is given, since none can be found.

    Drives are learned in the order given; with the same hyperparameters and trust one run and several appended
    ones give the same file, bit for bit. Printed are, a drive and in total, samples by what became of them,
    updates of the set, its size, non-empty cells, their share of the valid region, time a sample and memory.

    \b
    Example:
      split train lap1.parquet lap2.parquet --vehicle car.yaml -o car.split
      split train lap3.parquet --vehicle car.yaml -o car.split --append
    """
    from split_cli.workflows.training.train import TrainSettings, train_set

    progress = StepBar()
    try:
        result = train_set(
            drives,
            vehicle_path,
            output,
            TrainSettings(**settings),
            append=append,
            per_lap=per_lap,
            progress=progress,
        )
    finally:
        progress.close()
    for note in result.notes:
        click.echo(f"note: {note}", err=True)
    if as_json:
        print_json(result)
        return
    _print_rows(result)
    if result.laps:
        _print_laps(result.laps)


def _print_laps(laps) -> None:
    click.echo()
    header = ["drive", "lap", "time s", "mean speed m/s", "max |v_x r| m/s^2", "updates", "set size", "cells"]
    share = any(row.valid_share is not None for row in laps)
    rows = [
        [row.drive, f"{row.lap}" if row.finished else f"{row.lap} (unfinished)", row.time, row.mean_speed,
         row.largest_lateral_acceleration, row.updates, row.points, row.cells,
         *([100.0 * row.valid_share] if share else [])]
        for row in laps
    ]  # fmt: skip
    print_table([*header, *(["valid region %"] if share else [])], rows)


def _print_rows(result) -> None:
    rows = [*result.rows, result.total]
    reasons = list(dict.fromkeys(reason for row in rows for reason, _ in row.rejected))
    share = result.total.valid_share is not None
    header = ["drive", "samples", "accepted", *reasons, "updates", "set size", "cells"]
    header += [*(["valid region %"] if share else []), "us/sample", "MB"]
    table = []
    for row in rows:
        rejected = dict(row.rejected)
        cells = [row.drive, row.samples, row.accepted, *(rejected.get(reason, 0) for reason in reasons)]
        cells += [row.updates, row.points, row.cells, *([100.0 * row.valid_share] if share else [])]
        table.append([*cells, row.microseconds, row.megabytes])
    print_table(header, table)
    kernel = result.kernel
    horizons = ", ".join(f"{value:g}" for value in dict.fromkeys(result.horizons))
    click.echo(f"\nlabel interval {horizons} s; hyperparameters: {kernel.origin}")
    click.echo("length scales " + ", ".join(f"{value:.4g}" for value in kernel.length_scales))
    click.echo("signal variance " + ", ".join(f"{value:.4g}" for value in kernel.signal_variance))
    click.echo("noise variance " + ", ".join(f"{value:.4g}" for value in kernel.noise_variance))
    if result.fit:
        fit = result.fit
        click.echo(f"fitted to {fit.points} points in {fit.blocks} blocks, {fit.evaluations} evaluations")
    click.echo(f"trust {result.trust.words()}")
    click.echo(f"written: {result.output}")
