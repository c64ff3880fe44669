"""`split info`: its options, and how its result is printed."""

import click

from split_cli.cli.options import existing_file, json_option, print_json


@click.command("info")
@click.argument("files", nargs=-1, required=True, type=existing_file, metavar="FILE|FOLDER...")
@json_option
def command(files, as_json) -> int:
    """Describe a drive, labels, a trained set, a vehicle file, a signal map, an export, or a recording.

    Of a folder or page that evaluate, diagnose, compare or race wrote, it prints the verdict and the main figures.
    Any other folder, a quoted glob or an address such as s3://bucket/day stands for all files in it of the kinds
    above. A file among several that cannot be read is named at the end, and the exit code is 1.

    \b
    Example:
      split info car.split lap.parquet car.yaml
      split info figures/
      split info lap.mcap            # the channels a signal map can name
      split info drives/
    """
    from split_cli.workflows.info import describe_files

    descriptions, failures = describe_files(files)
    if as_json:
        print_json(descriptions)
    for description in descriptions if not as_json else ():
        click.echo(f"{description.path}: {description.kind}")
        width = max((len(label) for label, _ in description.facts), default=0)
        for label, text in description.facts:
            click.echo(f"  {label.ljust(width)}  {text}")
    for failure in failures:
        click.echo(f"split: {failure}", err=True)
    return 1 if failures else 0
