"""`split simulate`: its options, and how its result is printed."""

import click

from split_cli.cli.options import OutputPath, json_option, output_option, print_json, print_table
from split_cli.cli.verbosity import print_notes


@click.command("simulate")
@click.option("--car", default="road_car", metavar="NAME", help="Simulated car: road_car, f1tenth_car or formula_car.")
@click.option("--track", metavar="NAME", help="Track for laps: handling (2.3 km), small (580 m), oval or f1tenth.")
@click.option("--maneuver", metavar="NAME", help="Standard test instead of laps. A wrong name lists all names.")
@click.option(
    "--calibration-tests",
    is_flag=True,
    help="Instead of either, drive the gentle calibration tests as one drive (Parquet).",
)
@click.option("--laps", type=float, default=1.0, metavar="N", help="Number of laps; fractions are allowed.")
@click.option("--duration", type=float, metavar="S", help="Duration of the drive, instead of a number of laps.")
@click.option(
    "--lead-in",
    type=float,
    default=0.0,
    metavar="S",
    help="Time between the start and the first recorded sample, so that tyres and actuators settle.",
)
@click.option("--driver", default="brisk", metavar="NAME", help="Driver: smooth, brisk, racer or novice.")
@click.option(
    "--aggressiveness",
    type=float,
    metavar="SHARE",
    help="Share of the car's grip that the driver uses  [default: 0.6 for laps, 0.35 for tests].",
)
@click.option("--seed", type=int, default=0, metavar="N", help="Random seed of driver and sensors.")
@click.option(
    "--format", metavar="NAME", help="Log format: mcap, csv or parquet  [default: from the name of the output]."
)
@click.option(
    "--instruments",
    default="full",
    metavar="NAME",
    help="Sensors: full; lean (state, inertial at 50 Hz, commands); or perfect (no noise, no delay).",
)
@click.option("--workshop-units", is_flag=True, help="Write the CSV in km/h, deg, deg/s and g instead of SI units.")
@click.option(
    "--effect",
    "effects",
    multiple=True,
    metavar="NAME:P=VALUE,...",
    help="Add an effect that the driver does not know, for split diagnose to find; repeatable. A wrong name "
    "lists all names.",
)
@click.option(
    "--truth",
    type=OutputPath("file"),
    metavar="FILE",
    help="Also write the noise-free states and the effects, as a drive.",
)
@output_option("Log to write.")
@json_option
def command(output, truth, as_json, **settings) -> None:
    """Simulate a double-track car and write what its sensors record.

    MCAP logs hold ROS 2 messages at different rates, with a header time that differs from the log time. CSV and
    Parquet logs have one clock of 100 Hz. T is the total wheel torque and delta the road-wheel angle, both as
    commanded. The values after the actuators are in MCAP logs and in the --truth file. Equal settings and seeds
    give equal logs.

    \b
    Example:
      split simulate --track handling --laps 2 --driver racer --aggressiveness 0.8 --seed 3 -o lap.mcap
      split simulate --car f1tenth_car --maneuver sine_sweep --truth truth.parquet -o sweep.csv
      split simulate --calibration-tests -o road_car_tests.parquet
      split simulate --track small --effect steer_lag:tau=0.1 --effect mass:scale=1.1 -o lap.parquet
    """
    from split_cli.workflows.simulate import SimulateSettings, simulate_log

    result = simulate_log(SimulateSettings(**settings), output, truth=truth)
    print_notes(result.notes)
    if as_json:
        print_json(result)
        return
    click.echo(result.what)
    if result.effects:
        click.echo(f"with {', '.join(result.effects)}")
    header = ["time s", "distance m", "top speed m/s", "|ay| max", "ax max", "ax min"]
    peaks = [result.top_speed, result.lateral_peak, result.driving_peak, -result.braking_peak]
    print_table(header, [[result.duration, result.distance, *peaks]])
    click.echo("rates: " + ", ".join(f"{name} {rate:g} Hz" for name, rate in result.rates))
    click.echo(f"written: {', '.join(str(path) for path in (result.output, result.truth) if path)}")
