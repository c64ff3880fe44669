"""`split evaluate`: its options, and how its result is printed."""

import click

from split_cli.cli import options as shared
from split_cli.cli.digits import three_digits
from split_cli.cli.verbosity import StepBar, print_notes


def _size(text: str) -> int:
    return 0 if text == "all" else int(text)


def _feature_sets(context: click.Context, parameter: click.Parameter, texts: tuple[str, ...]) -> tuple[str, ...]:
    """Split ``z1,z2`` into two sets; a list that holds anything else is one set of named signals."""
    sets: list[str] = []
    for text in texts:
        parts = [part.strip() for part in text.split(",") if part.strip()]
        sets += parts if all(part.lower() in ("z1", "z2") for part in parts) else [",".join(parts)]
    return tuple(sets)


@click.command("evaluate")
@click.argument("drives", nargs=-1, required=True, type=shared.existing_file, metavar="DRIVE...")
@shared.vehicle_option(required=False)
@click.option(
    "--set", "set_path", type=shared.existing_file, metavar="SET", help="Trained set to score on whole drives."
)
@click.option(
    "--predictor",
    "predictors",
    default="projected,bcm",
    callback=shared.list_of(str),
    metavar="LIST",
    help="Predictors to score: projected, bcm, rbcm, grbcm, local, weights, table, full, fitc, iol.",
)
@click.option(
    "--protocol",
    type=click.Choice(["held-out", "paper"]),
    default="held-out",
    help="held-out: blocks of time unseen in training. paper: 100 samples of a lap, scored on that same lap.",
)
@click.option(
    "--features",
    multiple=True,
    default=("z2",),
    callback=_feature_sets,
    metavar="LIST",
    help="Inputs of the correction: z1, z2, or a comma-separated list of signals and terms with states. Set z2 has "
    "slip angles and T/T_max, z1 has v_x, v_y, r, T/T_max and delta. Repeat the option, or write z1,z2, to compare "
    "feature sets at equal sizes.",
)
@click.option(
    "--sizes",
    callback=shared.list_of(_size),
    metavar="LIST",
    help="Set sizes at which feature sets are compared [default: 50,100,200,500,1000,all].",
)
@click.option("--blocks", type=click.IntRange(2), default=10, metavar="N", help="Number of time blocks per drive.")
@click.option("--holdout", type=float, default=0.3, metavar="SHARE", help="Share of the time that is held out.")
@click.option(
    "--guard", type=float, default=1.0, metavar="S", help="Unused time on either side of a held-out block [s]."
)
@click.option(
    "--rollout",
    default="0.5,1,2",
    callback=shared.list_of(float),
    metavar="LIST",
    help="Durations of the open-loop simulations (rollouts) [s].",
)
@click.option("--horizon", type=float, default=0.05, metavar="S", help="Without --set: label interval h [s].")
@click.option(
    "--trust",
    type=click.Choice(["held-out", "full"]),
    default="held-out",
    help="Without --set: held-out applies the share of the correction that held-out blocks support; full applies "
    "all of it.",
)
@click.option("--any-vehicle", is_flag=True, help="Warn instead of stopping when a drive contradicts the vehicle file.")
@click.option(
    "--select",
    is_flag=True,
    help="Choose capacity, gain threshold, cell edge and --features by their error on held-out blocks.",
)
@click.option(
    "--capacities", default="5,10,20", callback=shared.list_of(int), metavar="LIST", help="Capacities for --select."
)
@click.option(
    "--thresholds",
    default="0.001,0.01,0.1",
    callback=shared.list_of(float),
    metavar="LIST",
    help="Gain thresholds for --select.",
)
@click.option(
    "--cell-edges",
    default="1,2",
    callback=shared.list_of(float),
    metavar="LIST",
    help="Cell edges for --select, as multiples of the standard edge.",
)
@click.option(
    "--keep-going", is_flag=True, help="Leave out drives that cannot be read or are of another vehicle; exit code 1."
)
@shared.engine_options(1)
@shared.output_option("Folder for figures and report.html.", required=False, folder=True)
@shared.held_option
@shared.json_option
def command(
    drives, vehicle_path, set_path, output, as_json, select, keep_going, engine, scheduler, jobs, **settings
) -> int:
    """Measure the error of a corrected model on drives, beside that of the nominal model.

    With --set, a trained set is judged on whole drives, which it should not have learned. Without --set, a set and
    its hyperparameters are learned from training blocks of the drives, and the errors are those on held-out blocks.

    The first table gives the rms error of one step, in m/s^2 for v_x and v_y and in rad/s^2 for r. It also has
    persistence, the prediction that the velocities stay as they are. The noise floor is the error that sensor
    noise alone causes.

    \b
    Example:
      split evaluate lap.parquet --vehicle car.yaml --features z1,z2 -o figures
      split evaluate lap2.parquet --set car.split --predictor bcm,full
      split evaluate lap.parquet --vehicle car.yaml --select -o figures
    """
    from split_cli.workflows.sources import local_drives

    tried = {name: settings.pop(name) for name in ("capacities", "thresholds", "cell_edges")}
    if select and (engine != "process" or jobs > 1):
        raise click.UsageError("--select works in this process: leave out --engine and --jobs")
    if select and keep_going:
        raise click.UsageError("--select takes no --keep-going")
    failed, absent = False, []
    with local_drives(drives, absent if keep_going else None) as paths:
        if select:
            _select(paths, vehicle_path, set_path, output, as_json, tried, settings)
        else:
            worked = engine, scheduler, jobs, keep_going
            learned, away, failed = _evaluate(paths, vehicle_path, set_path, output, as_json, worked, settings)
    shared.tell_left_out(tuple(map(str, absent)))
    if not as_json and not select:
        _tell_what_follows(drives, vehicle_path, set_path, learned, away)
    return 1 if failed or absent else 0


def _evaluate(
    drives, vehicle_path, set_path, output, as_json, worked: tuple, settings: dict
) -> tuple[bool, bool, bool]:
    """Evaluate and print.

    Returns
    -------
    tuple of bool
        Whether the set was trained on every drive, whether the nominal model runs away, and whether drives were left
        out.
    """
    from split_cli.scoring.report import EvaluationSettings
    from split_cli.scoring.verdict import nominal_runs_away, runs_away
    from split_cli.workflows.engine import open_engine
    from split_cli.workflows.evaluate import evaluate_files

    asked = EvaluationSettings(**settings)
    # Labels, each predictor trusted and believed in full, rollouts and noise: no more steps than this.
    steps = len(asked.features) * (1 + 2 * len(asked.predictors)) + 2
    engine, scheduler, jobs, keep_going = worked
    with open_engine(engine, jobs=jobs, scheduler=scheduler) as where, StepBar(steps) as progress:
        run = evaluate_files(
            drives, vehicle_path, asked, set_path, progress=progress, engine=where, keep_going=keep_going
        )
    if output is not None:
        from split_cli.workflows.pages import write_evaluation

        drawn = write_evaluation(run, output)
        click.echo(f"split: report in {output / 'report.html'}", err=True)
        click.echo(f"split: {len(drawn.written)} figures in {output}: its charts and others", err=True)
        for reason in drawn.left_out:
            click.echo(f"split: not drawn: {reason}", err=True)
    print_notes(run.report.notes)
    shared.tell_left_out(run.failures)
    if as_json:
        shared.print_json(run.report)
    else:
        _print_report(run.report)
    first = [c for c in run.report.comparisons if c.name == asked.predictors[0]]
    learned = set_path is not None and all(drive.in_sample for drive in run.report.drives)
    return learned, nominal_runs_away(runs_away(first)), bool(run.failures)


def _tell_what_follows(drives, vehicle_path, set_path, learned: bool, runs_away: bool) -> None:
    if runs_away:
        made = shared.named_after(drives[0], "calibrated.yaml")
        words = ["split", "calibrate", *drives, "--vehicle", vehicle_path or "VEHICLE", "-o", made]
        what = "the vehicle file runs away on this driving, so no correction of it is worth an export"
        shared.tell_next(words, before=f"{what}. Fit it to this driving, then train and evaluate again: ")
    elif learned:
        vehicle = [] if vehicle_path is None else ["--vehicle", vehicle_path]
        unseen = ["split", "evaluate", "ANOTHER_DRIVE", "--set", set_path, *vehicle]
        shared.tell_next(unseen, before="these drives were learned, so take another one, ")
    elif set_path is not None:
        exported = ["split", "export", set_path, "--target", "c", "-o", shared.named_after(set_path, "controller/")]
        shared.tell_next(exported, before="where the correction helps, ")
    else:
        real = [word for path in drives for word in ("--real", path)]
        made = shared.named_after(drives[0], "diagnosis/")
        shared.tell_next(["split", "diagnose", *real, "--vehicle", vehicle_path, "--out", made])


def _select(drives, vehicle_path, set_path, output, as_json, tried: dict, settings: dict) -> None:
    from split_cli.scoring.selection import SelectionSettings
    from split_cli.workflows.training.select import select_files

    if vehicle_path is None or set_path is not None:
        raise click.UsageError("--select trains sets of its own: give --vehicle, and no --set")
    asked = SelectionSettings(settings["features"], **tried, horizon=settings["horizon"])
    trusted = {name: settings[name] for name in ("held", "any_vehicle")}
    with StepBar() as progress:
        found = select_files(drives, vehicle_path, asked, **trusted, progress=progress)
    if output is not None:
        from split_cli.plots.selection import write_selection

        click.echo(f"split: figure in {output}: {write_selection(found, output)}", err=True)
    if as_json:
        shared.print_json(found)
        return
    click.echo(f"{found.vehicle}: {found.labels} labels on {found.blocks} held-out blocks, {found.folds} folds")
    click.echo("error: root mean over v_x, v_y, r of MSE/MSE of the nominal model; behind: of the mean square\n")
    header = (
        "",
        "features",
        "capacity",
        "threshold",
        "cell edge",
        "points",
        "cells",
        "us/query",
        "error",
        "behind",
        "+-",
        "v_x",
        "v_y",
        "r",
    )
    shared.print_table(
        header,
        [
            (
                _mark(one),
                one.features,
                one.capacity,
                one.threshold,
                one.cell_edge,
                one.points,
                one.cells,
                one.microseconds,
                one.error,
                one.behind,
                one.behind_error,
                *map(three_digits, one.rmse),
            )
            for one in found.candidates
        ],
    )
    click.echo("\nchosen: fewest points among those within one standard error of the best")
    click.echo(found.command)


def _mark(one) -> str:
    """Return how a row is marked: on the front, chosen, what `split train` does by itself."""
    marks = (("front", one.on_front), ("CHOSEN", one.chosen), ("default", one.usual))
    return ", ".join(name for name, true in marks if true)


def _print_report(report) -> None:
    tested = sum(drive.tested for drive in report.drives)
    valid = sum(drive.tested_valid for drive in report.drives)
    seen = all(drive.in_sample for drive in report.drives) and report.settings.protocol != "paper"
    protocol = "in sample" if seen else report.settings.protocol
    click.echo(f"{report.vehicle}, protocol {protocol}, h = {report.settings.horizon:g} s")
    drives = "1 drive" if len(report.drives) == 1 else f"{len(report.drives)} drives"
    click.echo(f"{tested} test samples of {drives}, {valid} in the valid region")
    click.echo("rms errors of one step: labels, in m/s^2, m/s^2, rad/s^2; --legend explains every column\n")
    header = (
        "model",
        "features",
        "points",
        "norm",
        "v_x",
        "v_y",
        "r",
        "norm valid",
        "skill",
        "skill v_x,v_y,r",
        "NLPD",
        "in 50 %",
        "in 95 %",
        "us/query",
    )
    pooled = [score for score in report.scores if not score.drive]
    rows = [_score_row(score) for score in pooled]
    floor = report.noise_floor
    if floor.rms is not None:
        blank = [None, None, "", None, "", "", None]
        rows.append(["noise floor", "", None, three_digits(floor.norm), *map(three_digits, floor.rms), *blank])
    shared.print_table(header, rows)
    if floor.reason:
        click.echo(f"noise floor: {floor.reason}")
    if report.sizes:
        click.echo("\nDense process on the most informative samples of each feature set")
        sizes = [("all" if s.size == 0 else str(s.size), *_score_row(s.score)[1:11]) for s in report.sizes]
        shared.print_table(("size", *header[1:11]), sizes)
    if report.rollouts:
        click.echo("\nRollouts (open-loop simulation on the recorded inputs)")
        click.echo("rms errors of v_x, v_y [m/s], r [rad/s], position [m]\n")
        shared.print_table(
            ("model", "features", "after s", "starts", "v_x", "v_y", "r", "position"),
            [
                (r.name, r.features, r.horizon, r.starts, *map(three_digits, r.rmse), _number(r.distance))
                for r in report.rollouts
            ],
        )
    if report.intervals:
        click.echo("\nLabels inside intervals of v_x/v_y/r, within a length scale of the set's points and beyond")
        shared.print_table(
            ("model", "features", "samples", "share", "in 50 %", "in 90 %", "in 95 %"),
            [
                (
                    s.name,
                    s.features,
                    "within" if s.near else "beyond",
                    f"{100 * s.share:.0f} %",
                    *map(_shares, (s.coverage_50, s.coverage_90, s.coverage_95)),
                )
                for s in report.intervals
            ],
        )
    if report.verdicts:
        # What is read last is the verdict on the predictor that is named first: a terminal shows the end.
        click.echo("\n" + "\n".join(reversed(report.verdicts)))


def _score_row(score) -> list:
    return [
        score.name,
        score.features,
        score.points,
        three_digits(score.rmse[3]),
        *(three_digits(value) for value in score.rmse[:3]),
        _number(score.rmse_valid[3]),
        _number(score.skill_velocity_held[3]),
        "/".join(f"{value:.2f}" for value in score.skill_velocity_held[:3]),
        None if score.nlpd is None else three_digits(score.nlpd.sum()),
        _shares(score.coverage_50),
        _shares(score.coverage_95),
        None if score.time_per_query is None else three_digits(1e6 * score.time_per_query),
    ]


def _number(value: float) -> float | None:
    return three_digits(value) if value == value else None


def _shares(shares) -> str:
    return "" if shares is None else "/".join(f"{100 * share:.0f}" for share in shares)
