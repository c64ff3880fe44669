"""`split maneuver`: its options, and how its result is printed."""

import click

from split_cli.cli import options as shared
from split_cli.cli.digits import three_digits
from split_cli.cli.verbosity import StepBar
from split_cli.control.policy import MODEL_CAR, P_LONG, SHARE_LEARNED, SHARE_NOMINAL, SIZE


@click.command("maneuver")
@click.argument("scenario")
@shared.vehicle_option()
@click.option(
    "--start-set",
    type=shared.existing_file,
    metavar="PATH",
    help="Trained set to drive with, or a folder of `split export --target casadi`, whose function the "
    "controller evaluates; without one, the nominal model.",
)
@click.option(
    "--predictor",
    default="auto",
    metavar="NAME",
    help="Predictor that evaluates the set: auto is bcm for three features and projected for more.",
)
@shared.car_option
@click.option(
    "--speed",
    "speeds",
    type=float,
    multiple=True,
    metavar="M/S",
    help="Entry speed [m/s]; repeatable  [default: 14 for iso3888-1, 10 for iso3888-2, 14 for brake-avoid, on a scaled "
    "course times the root of its scale].",
)
@click.option(
    "--scale",
    type=float,
    metavar="SCALE",
    help="Scale of the course's lengths: 1 for full-size cars  "
    f"[default: 1; for a wheelbase below {MODEL_CAR:g} m its share of {SIZE} m].",
)
@shared.grip_option
@click.option(
    "--p-ellipse",
    type=float,
    metavar="SHARE",
    help="Share of the axles' peak force that the "
    f"controller may use  [default: {SHARE_LEARNED} with a set, or if the vehicle file knows the "
    f"tyres' peaks from data; else {SHARE_NOMINAL}].",
)
@click.option(
    "--p-long",
    type=float,
    default=P_LONG,
    metavar="WEIGHT",
    help="Weight of the longitudinal force in the friction ellipse.",
)
@click.option(
    "--guarded/--unguarded",
    default=True,
    help="Use force limits that follow "
    "load transfer, a torque limit and, with a set, the tyre peaks that its labels show.",
)
@click.option(
    "--max-torque",
    type=float,
    metavar="NM",
    help="Largest driving torque, total at the wheels [N m]  [default: the vehicle's].",
)
@shared.sensor_options
@click.option(
    "--set",
    "set_output",
    type=shared.OutputPath("file"),
    metavar="FILE",
    help="Train a new set on the first run, until a slip angle leaves the valid region, and write it.",
)
@click.option(
    "--features", default="z2", metavar="LIST", help="Inputs of the correction that --set trains; see `split race`."
)
@shared.output_option("Drive of the first run to write (Parquet, or MCAP with ROS 2 messages).", required=False)
@shared.json_option
def command(scenario, vehicle_path, output, set_output, no_delay, as_json, **options) -> None:
    """Drive SCENARIO between cones: iso3888-1, iso3888-2 or brake-avoid.

    A tracking MPC drives with the vehicle's nominal model, or with a trained set added. The lane widths follow
    from the car's width as in ISO 3888. A cone counts as hit when the body touches it. The course is one of
    full-size cars. For a model car it is scaled to the wheelbase, so that it asks for the same accelerations.

    \b
    Example:
      split maneuver iso3888-1 --vehicle road_car.yaml -o run1.parquet --set run1.split
      split maneuver iso3888-1 --vehicle road_car.yaml --start-set run1.split --speed 16 --speed 17 --grip 0.5
    """
    from split_cli.workflows.racing.maneuver import ManeuverSettings, run_maneuvers

    shared.refuse_without_use(
        {"predictor": (options["start_set"] is not None, "--start-set"), "features": (set_output is not None, "--set")}
    )
    settings = ManeuverSettings(scenario=scenario, delay=not no_delay, **options)
    with StepBar(max(len(settings.speeds), 1)) as bar:

        def tell(text: str) -> None:
            """Show a speed as the step that begins; let what is said of the course stay."""
            bar.say(text) if ":" in text else bar(text)

        result = run_maneuvers(settings, vehicle_path, output=output, set_output=set_output, progress=tell)
    if as_json:
        shared.print_json(result.summary())
        return
    sizes = f"car {result.width:.2f} m wide, course {result.scale:.3g} of full size"
    click.echo(f"{result.scenario}, grip {result.grip:g}, {sizes}, {result.model}")
    header = ["speed m/s", "entry m/s", "exit m/s", "cones hit", "deviation m", "|ay| m/s^2", "failures", "ended"]
    rows = [
        [
            run.speed,
            *map(three_digits, (run.entered, run.left)),
            run.hit,
            *map(three_digits, (run.deviation, run.max_lateral)),
            run.failures,
            run.ended or "-",
        ]
        for run in result.runs
    ]
    shared.print_table(header, rows)
    if len(result.runs) > 1:
        best = result.highest_passed
        click.echo(f"highest speed without a cone: {'none' if best is None else f'{best:g} m/s'}")
    written = [path for path in (result.output, result.set_path) if path]
    if written:
        click.echo(f"written: {', '.join(written)}")
