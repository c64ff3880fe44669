"""`split init`."""

from __future__ import annotations

from pathlib import Path

import click

from split_cli.cli.options import existing_file, json_option, output_option, print_json

__all__ = ["command"]


@click.command("init")
@click.argument("logs", nargs=-1, required=True, type=existing_file, metavar="LOG...")
@output_option("Folder for the two files [default: the current one].", required=False)
@click.option("--together", is_flag=True, help="The logs are one drive: files with clocks of their own.")
@click.option("--row-rate", type=float, metavar="HZ", help="Of a table without a column of time.")
@click.option("--dbc", "databases", multiple=True, type=existing_file, metavar="FILE", help="Of a CAN log.")
@click.option(
    "--msg-path", "message_paths", multiple=True, type=existing_file, metavar="DIR", help="Folder of .msg files."
)
@json_option
def command(logs, output, together, row_rate, databases, message_paths, as_json) -> None:
    """Draft a signal map and a vehicle file for a recording, and say what to do next.

    Writes map.yaml and vehicle.yaml; neither may exist. Every line of the map says what judged it, or why it is
    left open. Every value of the vehicle file is empty, with what it is and where to find it.

    \b
    Example:
      split init lap.csv -o car/
    """
    from split_cli.workflows.ingesting.init import init_project

    made = init_project(
        logs, output or Path("."), together=together, row_rate=row_rate, message_paths=(*message_paths, *databases)
    )
    if as_json:
        print_json(made.to_mapping())
    else:
        click.echo(made.to_text())
