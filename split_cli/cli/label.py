"""`split label`: its options, and how its result is printed."""

import click

from split_cli.cli import options as shared
from split_cli.cli.verbosity import StepBar, print_notes


@click.command("label")
@click.argument("drives", nargs=-1, required=True, type=shared.existing_file, metavar="DRIVE|FOLDER...")
@shared.vehicle_option()
@shared.output_option("Label file to write (Parquet), or a folder if there are several drives.")
@click.option(
    "--features",
    default="z2",
    metavar="LIST",
    help="Inputs of the correction: z2, z1, or a comma-separated list of signals.",
)
@click.option("--horizon", type=float, default=0.05, metavar="S", help="Label interval h [s].")
@shared.label_options
@shared.held_option
@shared.engine_options(None)
@shared.json_option
def command(
    drives, vehicle_path, output, features, horizon, stride, plain, held, engine, scheduler, jobs, as_json
) -> None:
    """Compute the error of the nominal model, sample by sample.

    A label is the missing rate of v_x, v_y and r: the rate that the nominal model lacks over the interval h when
    it is integrated with the recorded inputs. Its size does not depend on h, except with --plain-labels.

    \b
    Example:
      split label lap.parquet --vehicle car.yaml -o labels.parquet
      split label drives/ --vehicle car.yaml -o labels/ --jobs 2
    """
    from split_cli.workflows.engine import open_engine
    from split_cli.workflows.label import label_drive, label_drives
    from split_cli.workflows.sources import find_sources

    settings = {"features": features, "horizon": horizon, "stride": stride, "plain": plain, "held": held}
    found = find_sources(drives, (".parquet",), what="drive")
    several = [source.name for source in found] != [drives[0].name]  # a folder of one drive stands for several
    if several:
        with open_engine(engine, jobs=jobs, scheduler=scheduler) as where, StepBar() as bar:
            results = label_drives(drives, vehicle_path, output, engine=where, progress=bar, **settings)
    else:
        with found[0].local() as path:
            results = (label_drive(path, vehicle_path, output, **settings),)
    print_notes(dict.fromkeys(note for result in results for note in result.notes))
    if as_json:
        shared.print_json(list(results) if several else results[0])
        return
    reasons = dict.fromkeys(name for result in results for name, _ in result.rejected)
    rows = [[r.drive, r.samples, r.accepted, *(dict(r.rejected).get(reason, 0) for reason in reasons)] for r in results]
    shared.print_table(["drive", "samples", "in valid region", *(f"rejected: {reason}" for reason in reasons)], rows)
    result = results[0]
    click.echo(f"\nhorizon {result.horizon:g} s, {result.window} samples")
    if result.rms and not several:
        values = zip(("v_x", "v_y", "r"), result.rms, ("m/s^2", "m/s^2", "rad/s^2"), strict=True)
        click.echo("label rms: " + ", ".join(f"{name} {value:.4g} {unit}" for name, value, unit in values))
