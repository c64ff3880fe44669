"""`split race`."""

import click

from split_cli.cli import options as shared
from split_cli.cli.digits import three_digits
from split_cli.cli.verbosity import StepBar, print_notes
from split_cli.control.policy import MARGIN, RACE_P_LONG, SHARE_LEARNED, SHARE_NOMINAL, SHARE_STEP, SIZE

#: Former names of options, by which scripts may still call them; the help shows the present ones.
_FORMER_NAMES = {"told-grip": "assumed-friction"}


@click.command("race", context_settings={"token_normalize_func": lambda name: _FORMER_NAMES.get(name, name)})
@shared.vehicle_option()
@click.option(
    "--track",
    default="small",
    metavar="NAME",
    help="Track: handling (2.3 km), small (580 m), oval, f1tenth, or a centre-line CSV with the columns "
    "x_m,y_m,w_tr_right_m,w_tr_left_m.",
)
@shared.car_option
@click.option(
    "--laps",
    type=int,
    default=3,
    metavar="N",
    help="Number of laps after lap 0, which is driven with the nominal model.",
)
@click.option(
    "--learner",
    "learners",
    multiple=True,
    default=("split",),
    metavar="NAME",
    help="none; iol (one dictionary, Kabzan et al. 2019); or split (this project's: a small set in each cell). "
    "Repeat the option to compare several learners in one report.",
)
@click.option(
    "--start-set",
    type=shared.existing_file,
    metavar="PATH",
    help="Trained set to start from; without one, lap 0 is nominal and the kernel is fitted to it. With "
    "--learner none it may be a folder of `split export --target casadi`, whose function is then evaluated.",
)
@click.option(
    "--predictor",
    default="auto",
    metavar="NAME",
    help="Predictor that evaluates the set: bcm and projected follow every update, others are rebuilt after each "
    "lap. With auto it is bcm for three features and projected for more.",
)
@click.option("--max-speed", type=float, default=30.0, metavar="M/S", help="Largest speed [m/s].")
@click.option(
    "--max-torque",
    type=float,
    metavar="NM",
    help="Largest driving torque, total at the wheels [N m]  [default: the vehicle's].",
)
@shared.grip_option
@click.option(
    "--p-ellipse",
    type=float,
    metavar="SHARE",
    help="Share of the axles' peak force "
    f"that the controller may use with the learned model  [default: {SHARE_LEARNED}].",
)
@click.option(
    "--p-ellipse-lap0",
    type=float,
    metavar="SHARE",
    help="The same share in lap 0. After each clean lap it "
    f"rises by {SHARE_STEP:.2g} up to --p-ellipse, and by less on a track that is too "
    "narrow for the margin. With --learner none it is at "
    f"most {SHARE_NOMINAL} if the tyre peaks in the vehicle file are assumed. [default: --p-ellipse if given; else "
    f"{SHARE_LEARNED} if the peaks are from data, "
    f"{SHARE_NOMINAL - SHARE_STEP:.2g} if they are assumed].",
)
@click.option(
    "--p-unknown",
    type=float,
    metavar="SHARE",
    help="The same share in states "
    "without training data. It approaches --p-ellipse as the predicted variance falls  "
    "[default: --p-ellipse].",
)
@click.option(
    "--assumed-friction",
    type=float,
    default=1.0,
    metavar="SCALE",
    help="Friction scale that the controller assumes before it has learned.",
)
@click.option(
    "--learn-grip/--no-learn-grip",
    default=True,
    help="After each lap, estimate the tyre peaks from the labels and limit the slip angles by them.",
)
@click.option(
    "--margin",
    type=float,
    metavar="M",
    help="Distance to keep between the car's side and the track "
    f"border, in addition to what earlier laps needed  [default: {MARGIN} for a wheelbase of {SIZE} m, "
    "in proportion for others].",
)
@click.option(
    "--margin-by-error/--margin-by-laps",
    default=True,
    help="After each lap, reduce the margin that no lap needed by a fifth. With --margin-by-error it also falls with "
    "the error of the learned model, if there is one.",
)
@click.option(
    "--p-long",
    type=float,
    default=RACE_P_LONG,
    metavar="WEIGHT",
    help="Weight of the longitudinal force in the friction ellipse.",
)
@click.option(
    "--guarded/--unguarded",
    default=True,
    help="guarded: force limits "
    "follow the load transfer, and the torque is limited. Where the correction has no data, it assumes the learned "
    "tyre peaks. --unguarded: none of the three.",
)
@click.option(
    "--features",
    default="auto",
    metavar="LIST",
    help="Inputs of the correction: z2, z1 or a comma-separated list of these, signals and terms with states. "
    "With auto it is z2 or z2,feature_lag: the one with the smaller error on held-out tenths of the laps.",
)
@click.option(
    "--hyperparameters", default="fit", metavar="KIND", help="Kernel: fit (to lap 0), default, or a YAML file."
)
@click.option(
    "--iol-update",
    type=click.Choice(["printed", "incremental"]),
    default="printed",
    help="Update of iol: one matrix inversion per gain as printed in its paper, or an incremental inverse.",
)
@click.option(
    "--tightening",
    type=float,
    default=0.0,
    metavar="SIGMA",
    help="Move the track borders inwards by this many standard deviations of the predicted position.",
)
@shared.sensor_options
@click.option(
    "--set", "set_output", type=shared.OutputPath("file"), metavar="FILE", help="Save the set after each lap."
)
@click.option("--report", type=shared.OutputPath("file"), metavar="FILE", help="Write an HTML report of the laps.")
@shared.output_option("Drive to write (Parquet, or MCAP with ROS 2 messages).", required=False)
@shared.json_option
def command(
    vehicle_path,
    output,
    set_output,
    report,
    p_ellipse,
    p_ellipse_lap0,
    p_unknown,
    guarded,
    p_long,
    no_delay,
    iol_update,
    learners,
    as_json,
    **options,
) -> None:
    """Race a simulated double-track car, with a contouring controller that learns while it drives.

    The controller (MPCC, 80 steps of 50 ms) drives with the vehicle's nominal model plus what the learner has
    found so far. Lap 0 has a flying start and is driven with the nominal model alone; the learner learns from it.
    The table compares the errors of each lap with those of the nominal model. It marks laps on which a side of the
    car left the track.

    \b
    Example:
      split race --vehicle road_car.yaml --track small --max-speed 15 --laps 3 -o race.parquet --set race.split
      split race --vehicle road_car.yaml --learner none --learner iol --learner split --laps 1 --report laps.html
      split race --vehicle road_car.yaml --track monza.csv --learner none --json
    """
    from split_cli.control.limits import Limits
    from split_cli.control.mpcc import MpccSettings
    from split_cli.workflows.racing.race import run_race
    from split_cli.workflows.racing.settings import RaceSettings

    learners = tuple(dict.fromkeys(learners))
    if len(learners) > 1 and (output or set_output):
        raise click.UsageError("-o and --set take the drive and the set of one learner; name one.")
    asks_a_set = "split" in learners or options["start_set"] is not None
    shared.refuse_without_use(
        {
            "predictor": (asks_a_set, "--learner split, or to --start-set"),
            "hyperparameters": (any(name != "none" for name in learners), "--learner split or iol"),
            "iol_update": ("iol" in learners, "--learner iol"),
            "margin_by_error": (asks_a_set or "iol" in learners, "--learner split or iol, or to --start-set"),
        }
    )
    first_share = p_ellipse if p_ellipse_lap0 is None else p_ellipse_lap0
    p_ellipse = SHARE_LEARNED if p_ellipse is None else p_ellipse
    limits = Limits(p_long=p_long, p_ellipse=p_ellipse, p_unknown=p_unknown, guarded=guarded)
    results = []
    # Without a learner first: the others are compared with it.
    for learner in sorted(learners, key=lambda name: name != "none"):
        settings = RaceSettings(
            learner=learner,
            delay=not no_delay,
            printed_iol=iol_update == "printed",
            settings=MpccSettings(limits=limits),
            first_share=first_share,
            **options,
        )
        say = f"race, {learner}" if len(learners) > 1 else "race"
        with StepBar(settings.laps + 1) as bar:

            def tell(text: str, say: str = say, bar: StepBar = bar) -> None:
                """Show "lap 3" as the step that begins; let "lap 3: 34.76 s" stay."""
                bar.say(f"{say}: {text}") if ":" in text else bar(text)

            results.append(
                run_race(settings, vehicle_path, output=output, set_output=set_output, progress=tell, others=results)
            )
    if report is not None:
        from split_cli.files import atomic_write_text
        from split_cli.workflows.racing.race_page import race_page

        atomic_write_text(report, race_page(results, results[0].path))
    if as_json:
        shared.print_json(results[0].summary() if len(results) == 1 else [result.summary() for result in results])
    for result in results:
        print_notes(result.notes)
        if not as_json:
            _tell(result)
    written = [str(path) for path in (results[0].output, results[0].set_path, report) if path]
    if written and not as_json:
        click.echo(f"written: {', '.join(written)}")


def _tell(result) -> None:
    """Print the laps of one race."""
    begins = f", begins with {result.start}" if result.start else ""
    click.echo(f"{result.track}, {result.length:.0f} m a lap; {result.car}, learner {result.learner}{begins}")
    header = [
        "lap",
        "time s",
        "speed m/s",
        "|ay| g",
        "updates",
        "set",
        "cells",
        "error vx",
        "vy",
        "r",
        "of nominal",
        "outside m",
        "at m",
        "failures",
    ]
    rows = []
    for lap in result.laps:
        share = [a / b if b else None for a, b in zip(lap.error_after, lap.error_before, strict=True)]
        ratios = "/".join("-" if s is None else f"{s:.2f}" for s in share)
        rows.append(
            [
                lap.number,
                lap.time,
                *map(three_digits, (lap.mean_speed, lap.max_lateral)),
                lap.updates,
                lap.size,
                lap.cells,
                *map(three_digits, lap.error_after),
                ratios,
                lap.outside,
                None if lap.outside_at is None else round(lap.outside_at),
                lap.failures,
            ]
        )
    shared.print_table(header, rows)
    shared.print_table(
        ["lap", "solver ms (median, 99 %, worst)", "step ms (median, 99 %, worst)", "learning ms"],
        [
            [
                lap.number,
                *(", ".join(f"{v:.2g}" for v in times) for times in (lap.solver_ms, lap.step_ms, lap.update_ms)),
            ]
            for lap in result.laps
        ],
    )
    for lap in result.laps:
        if lap.ended:
            click.echo(f"lap {lap.number} was not finished: {lap.ended}")
    if result.verdict:
        click.echo(result.verdict)
