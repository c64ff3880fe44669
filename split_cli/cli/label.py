"""`split label`."""

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

__all__ = ["command"]


@click.command("label")
@click.argument("drive", type=existing_file, metavar="DRIVE")
@vehicle_option()
@output_option("Label file to write (Parquet).")
@click.option("--features", default="z2", show_default=True, help="z2, z1, or a comma-separated list of names.")
@click.option("--horizon", type=float, default=0.05, show_default=True, metavar="S", help="Label interval h.")
@click.option("--stride", type=int, metavar="N", help="Samples between labels; default: the horizon.")
@click.option(
    "--plain-labels", "plain", is_flag=True, help="The paper's plain difference, damped; for reproduction."
)
@held_option
@json_option
def command(drive, vehicle_path, output, features, horizon, stride, plain, held, as_json) -> None:
    """Compute what the nominal model gets wrong, sample by sample.

    A label is the rate of v_x, v_y and r that the nominal model leaves out over h, integrated over the recorded
    inputs. It does not depend on h unless --plain-labels is given.

    \b
    Example:
      split label lap.parquet --vehicle car.yaml -o labels.parquet
    """
    from split_cli.workflows.label import label_drive

    result = label_drive(
        drive, vehicle_path, output, features=features, horizon=horizon, stride=stride, plain=plain, held=held
    )
    for note in result.notes:
        click.echo(f"note: {note}", err=True)
    if as_json:
        print_json(result)
        return
    rejected = dict(result.rejected)
    print_table(
        ["drive", "samples", "accepted", *rejected],
        [[result.drive, result.samples, result.accepted, *rejected.values()]],
    )
    click.echo(f"\nhorizon {result.horizon:g} s, {result.window} samples")
    if result.rms:
        values = zip(("v_x", "v_y", "r"), result.rms, ("m/s^2", "m/s^2", "rad/s^2"), strict=True)
        click.echo("label rms: " + ", ".join(f"{name} {value:.4g} {unit}" for name, value, unit in values))
