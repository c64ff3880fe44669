"""`split info`: its options, and how its result is printed."""

import click

from split_cli.cli.options import existing_file, json_option, print_json


@click.command("info")
@click.argument("files", nargs=-1, required=True, type=existing_file, metavar="FILE...")
@json_option
def command(files, as_json) -> None:
    """Describe a drive, labels, a trained set, a vehicle file, a signal map, an export, or a recording.

    Of a folder or page that evaluate, diagnose, compare or race wrote, it prints the verdict and the main figures.

    \b
    Example:
      split info car.split lap.parquet car.yaml
      split info figures/
      split info lap.mcap            # the channels a signal map can name
    """
    from split_cli.workflows.info import describe_file

    descriptions = [describe_file(path) for path in files]
    if as_json:
        print_json(descriptions)
        return
    for description in descriptions:
        click.echo(f"{description.path}: {description.kind}")
        width = max((len(label) for label, _ in description.facts), default=0)
        for label, text in description.facts:
            click.echo(f"  {label.ljust(width)}  {text}")
