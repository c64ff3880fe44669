"""`split init`: its options, and how its result is printed."""

from pathlib import Path

import click

from split_cli.cli.options import existing_file, json_option, log_options, output_option, print_json


@click.command("init")
@click.argument("logs", nargs=-1, required=True, type=existing_file, metavar="LOG|FOLDER...")
@output_option("Folder for the two files [default: the current one].", required=False)
@log_options
@json_option
def command(logs, output, together, row_rate, databases, message_paths, as_json) -> None:
    """Draft a signal map and a vehicle file for a recording, and print the next steps.

    The command writes map.yaml and vehicle.yaml; neither may exist. Each line of the map states the check that
    supports it, or why it is left open. All values of the vehicle file are empty; comments explain each value and
    where to find it. Several logs of one car get one map, and the next steps say where they differ. A folder, a
    quoted glob or an address such as s3://bucket/day stands for all its logs, which are read one after the other.

    \b
    Example:
      split init lap.csv -o car/
      split init monday.csv tuesday.csv -o car/
      split init monday/ -o car/
    """
    from split_cli.workflows.ingesting.init import init_project

    made = init_project(
        logs, output or Path("."), together=together, row_rate=row_rate, message_paths=(*message_paths, *databases)
    )
    if as_json:
        print_json(made.to_mapping())
    else:
        click.echo(made.to_text())
