"""`split train`: its options, and how its result is printed."""

import click

from split_cli.cli import options as shared
from split_cli.cli.digits import three_digits
from split_cli.cli.verbosity import StepBar, print_notes


@click.command("train")
@click.argument("drives", nargs=-1, required=True, type=shared.existing_file, metavar="DRIVE|LABELS|FOLDER...")
@shared.vehicle_option()
@shared.output_option("Trained set to write (NAME.split).")
@click.option("--append", is_flag=True, help="Add drives to the existing set that -o names; its settings stay.")
@click.option(
    "--features",
    metavar="LIST",
    help="Inputs of the correction: z2 (default), z1, or a comma-separated list of z1 or z2, signals and terms with "
    "states. Set z2 has slip angles and T/T_max, z1 has v_x, v_y, r, T/T_max and delta. An example is z2,feature_lag.",
)
@click.option(
    "--hyperparameters",
    metavar="fit|default|FILE",
    help="Length scales and variances of the kernel; fixed once a set exists. Default: fit.",
)
@click.option("--horizon", type=float, metavar="S", help="Label interval h [s]; default 0.05.")
@shared.label_options
@click.option(
    "--capacity",
    type=int,
    metavar="M",
    help="Largest number of points in a cell (default 10); with iol in the whole set (default 300).",
)
@click.option(
    "--learner",
    type=click.Choice(["split", "iol"]),
    help="split: one small set in each cell (default). iol: one dictionary for all, for comparison.",
)
@click.option(
    "--threshold",
    type=float,
    metavar="GAIN",
    help="Smallest information gain of a point that a cell accepts while it has room; default 1e-3.",
)
@click.option(
    "--cell-edge",
    type=float,
    metavar="FACTOR",
    help="Edge length of the cells as a multiple of the standard edge; default 1.",
)
@click.option(
    "--forgetting",
    type=float,
    metavar="S",
    help="Let the gain of old points decay with this time constant [s]; default: off.",
)
@click.option(
    "--trust",
    metavar="held-out|full|VX,VY,R",
    help="Share of each correction to apply. Default: the share that held-out blocks support. full: all of it, "
    "as in the paper.",
)
@click.option(
    "--lag",
    type=click.Choice(["held-out", "none"]),
    help="Model lags of torque and steering if held-out blocks improve (held-out, the default), or never (none).",
)
@click.option("--any-vehicle", is_flag=True, help="Warn instead of stopping when a drive contradicts the vehicle file.")
@click.option(
    "--exclude",
    type=shared.TimeSpan(),
    multiple=True,
    help="Leave this stretch of time out of training [s]; repeatable.",
)
@shared.held_option
@click.option(
    "--keep-going", is_flag=True, help="Leave out drives that cannot be read or are of another vehicle; exit code 1."
)
@shared.engine_options(1)
@click.option("--per-lap", is_flag=True, help="Also print a row for each lap, as in the paper's table.")
@shared.json_option
def command(
    drives, vehicle_path, output, append, per_lap, keep_going, engine, scheduler, jobs, as_json, **settings
) -> int:
    """Learn the error of the nominal model from drives into a trained set.

    Each drive is labelled once. Drives that `split label` has labelled for this vehicle are not labelled again.
    Label files also train without their drives, but then --trust must be given, since it cannot be estimated.

    Drives are learned in the order given. With the same hyperparameters and trust, one run and several appended
    runs give the same file, bit for bit.

    The table has a row for each drive and one for all. It gives the samples used and rejected, and the updates
    and size of the set. It also gives the non-empty cells, their share of the valid region, time per sample and
    memory.

    \b
    Example:
      split train lap1.parquet lap2.parquet --vehicle car.yaml -o car.split
      split train lap3.parquet --vehicle car.yaml -o car.split --append
    """
    from split_cli.workflows.engine import open_engine
    from split_cli.workflows.training.train import TrainSettings, train_set

    with open_engine(engine, jobs=jobs, scheduler=scheduler) as where, StepBar() as progress:
        result = train_set(
            drives,
            vehicle_path,
            output,
            TrainSettings(**settings),
            append=append,
            per_lap=per_lap,
            keep_going=keep_going,
            engine=where,
            progress=progress,
        )
    print_notes(result.notes)
    shared.tell_left_out(result.failures)
    if as_json:
        shared.print_json(result)
        return 1 if result.failures else 0
    _print_rows(result)
    if result.laps:
        _print_laps(result.laps)
    from split_cli.learning.hyperparameters import FEWEST_TO_FIT

    if result.total.accepted < FEWEST_TO_FIT:
        more = ["split", "train", "ANOTHER_DRIVE", "--vehicle", vehicle_path, "-o", output, "--append"]
        shared.tell_next(more, before="too little was learned to be judged, so add a drive: ")
        return 1 if result.failures else 0
    figures = shared.named_after(output, "figures/")
    unseen = ["split", "evaluate", "ANOTHER_DRIVE", "--set", output, "--vehicle", vehicle_path, "-o", figures]
    shared.tell_next(unseen, before="on a drive that was not learned, ")
    if all(path.is_file() and ".labels" not in path.name for path in drives):
        held_out = ["split", "evaluate", *drives, "--vehicle", vehicle_path, "-o", figures]
        held_out += ["--keep-going"] if result.failures else []
        shared.tell_next(
            held_out,
            before=f"or, if there is none, on held-out parts of {'these' if len(drives) > 1 else 'this one'}, ",
        )
    if result.trust.array.any():
        exported = ["split", "export", output, "--target", "c", "-o", shared.named_after(output, "controller/")]
        shared.tell_next(exported, before="where the correction helps, ")
    return 1 if result.failures else 0


def _print_laps(laps) -> None:
    click.echo()
    header = ["drive", "lap", "time s", "mean speed m/s", "max |v_x r| m/s^2", "updates", "set size", "cells"]
    share = any(row.valid_share is not None for row in laps)
    rows = [
        [
            row.drive,
            f"{row.lap}" if row.finished else f"{row.lap} (unfinished)",
            row.time,
            three_digits(row.mean_speed),
            three_digits(row.largest_lateral_acceleration),
            row.updates,
            row.points,
            row.cells,
            *([three_digits(100.0 * row.valid_share)] if share else []),
        ]
        for row in laps
    ]
    shared.print_table([*header, *(["valid region %"] if share else [])], rows)


def _three(values) -> str:
    return ", ".join(three_digits(value).text for value in values)


def _print_rows(result) -> None:
    rows = [*result.rows, result.total]
    reasons = list(dict.fromkeys(reason for row in rows for reason, _ in row.rejected))
    share = result.total.valid_share is not None
    turned_down = ["redundant" if reason == "gain" else f"rejected: {reason}" for reason in reasons]
    header = ["drive", "samples", "in valid region", *turned_down, "updates", "set size", "cells"]
    header += [*(["valid region %"] if share else []), "us/sample", "MB"]
    table = []
    for row in rows:
        rejected = dict(row.rejected)
        cells = [row.drive, row.samples, row.accepted, *(rejected.get(reason, 0) for reason in reasons)]
        cells += [row.updates, row.points, row.cells, *([three_digits(100.0 * row.valid_share)] if share else [])]
        table.append([*cells, three_digits(row.microseconds), three_digits(row.megabytes)])
    shared.print_table(header, table)
    kernel = result.kernel
    horizons = ", ".join(f"{value:g}" for value in dict.fromkeys(result.horizons))
    click.echo(f"\nlabel interval {horizons} s; hyperparameters: {kernel.origin}")
    click.echo("length scales (in units of the features) " + _three(kernel.length_scales))
    click.echo("signal deviation of v_x, v_y, r [label units] " + _three(v**0.5 for v in kernel.signal_variance))
    click.echo("noise deviation of v_x, v_y, r [label units] " + _three(v**0.5 for v in kernel.noise_variance))
    if result.fit:
        fit = result.fit
        click.echo(f"fitted to {fit.points} points in {fit.blocks} blocks, {fit.evaluations} evaluations")
    click.echo(f"trust {result.trust.words()}")
    click.echo(f"written: {result.output}")
