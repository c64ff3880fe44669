"""`split experiments`: its options, and how its result is printed."""

import click

from split_cli.cli.options import OutputPath, existing_file, output_option, vehicle_option


@click.command("experiments")
@vehicle_option()
@click.option(
    "--limit-vehicle",
    type=existing_file,
    metavar="FILE",
    help="Vehicle file calibrated from tests near the limit.",
)
@click.option(
    "--physics-vehicle", type=existing_file, metavar="FILE", help="Vehicle file corrected by split diagnose."
)
@click.option("--formula-vehicle", type=existing_file, metavar="FILE", help="Vehicle file of the formula car.")
@click.option(
    "--only", multiple=True, metavar="NAME", help="Run only experiments whose names begin with NAME; repeatable."
)
@click.option("--page", type=OutputPath("file"), metavar="FILE", help="Page whose tables are updated.")
@output_option("Folder for the results.", folder=True)
def command(vehicle_path, limit_vehicle, physics_vehicle, formula_vehicle, only, page, output) -> None:
    """Run the closed-loop experiments of docs/experiments.md, and update its tables.

    The output folder keeps the result of every race and manoeuvre; those that are there are not run again. The
    whole plan takes about an hour on one core.

    \b
    Example:
      split experiments --vehicle road_car.yaml --only small -o results/
      split experiments --vehicle road_car.yaml -o results/ --page docs/experiments.md
    """
    from split_cli.vehicle.parameters import read_vehicle
    from split_cli.workflows.racing.experiments import run_experiments, stored
    from split_cli.workflows.racing.experiments_page import fill_page, read_page

    given = {
        "gentle": vehicle_path,
        "limit": limit_vehicle,
        "physics": physics_vehicle,
        "formula": formula_vehicle,
    }
    if page is not None:
        read_page(page)  # whatever is wrong with it is told before the work
    vehicles = {name: path for name, path in given.items() if path is not None}
    ran = run_experiments(
        output, vehicles, only=only, progress=lambda text: click.echo(f"experiments: {text}", err=True)
    )
    click.echo(f"run: {', '.join(ran) or 'nothing new'}")
    if page is not None:
        figures, left_out = fill_page(page, stored(output), read_vehicle(vehicle_path))
        click.echo(f"written: {', '.join([str(page), *figures])}")
        if left_out:
            click.echo(f"not on the page, which has no marks for them: {', '.join(left_out)}")
