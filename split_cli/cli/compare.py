"""`split compare`: its options, and how its result is printed."""

import sys
from pathlib import Path

import click

from split_cli.cli import options as shared
from split_cli.cli.verbosity import StepBar, print_notes

_MOST_SHOWN = 6


def _limits(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, float]:
    """Parse STATE=NUMBER options."""
    limits = {}
    for value in values:
        name, sign, text = value.partition("=")
        try:
            limits[name] = float(text)
        except ValueError:
            sign = ""
        if not sign or name not in ("v_x", "v_y", "r") or not limits[name] > 0.0:
            raise click.BadParameter(f"{value!r} is not of the form v_y=0.2", context, parameter)
    return limits


@click.command("compare")
@click.argument("models", nargs=-1, required=True, metavar="MODEL...")
@click.option(
    "--on",
    "drives",
    type=shared.existing_file,
    multiple=True,
    required=True,
    metavar="DRIVE",
    help="Drive to run on, or a folder or address of drives; repeatable.",
)
@click.option(
    "--horizon",
    "horizons",
    default="0.05,0.5,2",
    callback=shared.list_of(float),
    metavar="LIST",
    help="Durations of the open-loop simulation [s].",
)
@click.option("--exit-code", is_flag=True, help="Exit with code 3 if the first model is worse than another one.")
@click.option(
    "--most",
    "limits",
    multiple=True,
    callback=_limits,
    metavar="STATE=ERROR",
    help="Exit with code 3 if the first model's error at the longest horizon is larger than this.",
)
@shared.output_option("Folder for report.html and compare.csv.", required=False, folder=True)
@shared.held_option
@shared.json_option
def command(models, drives, horizons, exit_code, limits, output, held, as_json) -> None:
    """Compare vehicle files, trained sets and predictors on the same drives.

    A MODEL is a vehicle file, a trained set, or a set with a predictor (car.split:full). A prefix NAME= gives it a
    name in the table. All models run open loop on the recorded inputs from the same starts.
    Intervals are 95 %, from blocks of time.

    \b
    Example:
      split compare old.yaml new.yaml car.split --on lap2.parquet -o compared
      split compare new=car.split base=car.yaml --on lap2.parquet --exit-code --most v_y=0.3
    """
    from split_cli.workflows.compare import compare_files
    from split_cli.workflows.comparison_report import write_comparison
    from split_cli.workflows.sources import local_drives

    with local_drives(drives) as paths, StepBar(len(paths)) as progress:
        compared, read, recordings = compare_files(models, paths, horizons, held, progress=progress)
    if output is not None:
        write_comparison(compared, read, recordings, output)
        click.echo(f"split: report in {Path(output) / 'report.html'}", err=True)
    print_notes(compared.notes)
    if as_json:
        shared.print_json(compared)
    else:
        _tell(compared)
    sys.exit(_code(compared, exit_code, limits))


def _code(compared, exit_code: bool, limits: dict[str, float]) -> int:
    """Return 3 where a gate is shut, and say which on stderr."""
    shut = list(compared.worse) if exit_code else []
    longest = max(score.horizon for score in compared.scores)
    first = next(s for s in compared.scores if s.name == compared.models[0] and s.horizon == longest)
    for one in first.states:
        most = limits.get(one.state)
        if most is not None and not one.rmse <= most:
            what = f"{one.state} of {first.name} after {longest:g} s"
            shut.append(f"{what} is {one.rmse:.3g} {one.unit}, over {most:g}")
    for text in shut[:_MOST_SHOWN]:
        click.echo(f"split: gate: {text}", err=True)
    if len(shut) > _MOST_SHOWN:
        click.echo(f"split: gate: and {len(shut) - _MOST_SHOWN} more, in --json and the report", err=True)
    return 3 if shut else 0


def _tell(compared) -> None:
    from split_cli.workflows.report.comparison import comparison_headline

    click.echo(comparison_headline(compared))
    click.echo(f"open-loop simulation from {compared.starts} starts on {', '.join(compared.drives)}")
    click.echo("rms errors in m/s, m/s, rad/s with 95 % intervals; * is best; --legend explains every column\n")
    rows = []
    for score in compared.scores:
        row = [score.name, f"{score.horizon:g}"]
        for one in score.states:
            low, high = one.interval
            shown = f"{one.rmse:.3g}{'*' if one.is_best else ''}"
            shown = shown if low != low else f"{shown} ({low:.3g} to {high:.3g})"
            row += [shown, f"{one.fit:.1f}", f"{one.skill:.3f}"]
        rows.append([*row, f"{score.total:.3f}{'*' if score.is_best else ''}"])
    heads = ["model", "after s"]
    for state in ("v_x", "v_y", "r"):
        heads += [state, "fit %", "skill"]
    shared.print_table([*heads, "of held"], rows)
