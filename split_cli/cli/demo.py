"""`split demo`: its options, and how its result is printed."""

import time
from pathlib import Path

import click

from split_cli.cli.options import OutputPath, existing_file

_LISTED = 6
"""Files of a folder that are named [1]: so many fit a line or two."""


@click.command("demo")
@click.option("--samples", type=existing_file, metavar="FOLDER", help="Folder with the sample logs.")
@click.option(
    "-o",
    "--output",
    type=OutputPath("folder"),
    default=Path("demo-output"),
    metavar="FOLDER",
    help="Folder for the results.",
)
def command(samples, output) -> None:
    """Run all steps on the bundled samples: ingest, train, evaluate, export, diagnose.

    Each command is printed before it runs, so that you can repeat it.

    \b
    Example:
      split demo -o demo-output
    """
    from split_cli.cli.main import group
    from split_cli.workflows.demo import closing_words, demo_steps, find_samples

    steps = demo_steps(find_samples(samples), output)
    output.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    for number, step in enumerate(steps, 1):
        click.echo(f"\n[{number}/{len(steps)}] {step.title}\n$ {step.command}\n")
        group.main(args=list(step.arguments), prog_name="split", standalone_mode=False)
    click.echo(f"\nDone in {time.perf_counter() - begin:.0f} s. It wrote:")
    for folder in [output, *sorted(path for path in output.rglob("*") if path.is_dir())]:
        files = sorted(path for path in folder.iterdir() if path.is_file())
        shown = ", ".join(path.name for path in files[:_LISTED]) + (", ..." if len(files) > _LISTED else "")
        if files:
            click.echo(f"  {folder}/  {len(files)} file{'s' if len(files) > 1 else ''}: {shown}")
    click.echo(f"\n{closing_words(output)}")
