"""`split calibrate`: its options, and how its result is printed."""

import click

from split_cli.cli import options as shared
from split_cli.cli.digits import pair_known, three_digits
from split_cli.cli.verbosity import print_notes


@click.command("calibrate")
@click.argument("files", nargs=-1, required=True, type=shared.existing_file, metavar="DRIVE...")
@click.option("--vehicle", "start", type=shared.existing_file, metavar="FILE", help="Vehicle YAML to start from.")
@shared.output_option("Vehicle YAML to write.")
@click.option(
    "--fit",
    "parts",
    default="tires,drag,rolling",
    callback=shared.list_of(str),
    metavar="LIST",
    help="What to fit: any of tires, drag, rolling, splits, inertia. Without the option, drag and rolling resistance "
    "are left out where the torque was derived with those of the vehicle file.",
)
@click.option("--training-blocks", is_flag=True, help="Leave out the blocks of time that `split evaluate` holds out.")
@click.option("--offsets", is_flag=True, help="Fit a constant offset of each slip angle even if it is within chance.")
@click.option(
    "--measured-ay", is_flag=True, help="Use the channel ay instead of v_y' + v_x r; correct on a banked road."
)
@click.option(
    "--max-ax",
    type=shared.positive,
    default=2.0,
    metavar="A",
    help="Largest |a_x| of samples for the tyre fit [m/s^2].",
)
@click.option(
    "--max-ay",
    type=shared.positive,
    default=2.0,
    metavar="A",
    help="Largest |a_y| of samples for the fit of drag and rolling resistance [m/s^2].",
)
@click.option(
    "--alpha-max",
    type=click.FloatRange(0.0, 1.5, min_open=True),
    default=0.18,
    metavar="RAD",
    help="Largest slip angle up to which samples are used and curves are compared [rad].",
)
@click.option(
    "--smooth",
    type=shared.positive,
    metavar="SECONDS",
    help="Width of the smoothing kernel; by default from the wheelbase.",
)
@click.option("--figure", type=shared.OutputPath("file"), metavar="FILE", help="Draw the curves (png, svg, pdf).")
@click.option("--convert", is_flag=True, help="Convert a CommonRoad, F1TENTH or ForzaETH parameter file instead.")
@click.option(
    "--to",
    "kind",
    type=click.Choice(["f1tenth", "forzaeth", "commonroad"]),
    help="With --convert: write a vehicle file as that project's parameters.",
)
@shared.json_option
def command(
    files,
    start,
    output,
    parts,
    training_blocks,
    offsets,
    measured_ay,
    max_ax,
    max_ay,
    alpha_max,
    smooth,
    figure,
    convert,
    kind,
    as_json,
) -> None:
    """Fit a vehicle file to gentle drives, or convert another project's file.

    Tyres are fitted to the axles' lateral forces, drag and rolling resistance to the longitudinal force balance.
    The report gives the error on held-out blocks of time, the slip angles covered, and how far equally good curves
    differ. A coefficient that the drives do not determine keeps its given value.

    \b
    Example:
      split calibrate steps.parquet sweep.parquet coast.parquet --vehicle start.yaml -o car.yaml
      split calibrate --convert parameters_vehicle2.yaml parameters_tire.yaml -o bmw.yaml
      split calibrate --convert car.yaml --to f1tenth -o params.yaml
    """
    from split_cli.workflows.calibrate import calibrate_files, convert_files, write_foreign

    if kind is not None:
        if not convert or len(files) != 1:
            raise click.UsageError("--to writes one vehicle file: --convert car.yaml --to f1tenth.")
        _show_foreign(write_foreign(files[0], output, kind, alpha_max=alpha_max), output, as_json)
        return
    if convert:
        _show_conversion(convert_files(files, output, alpha_max=alpha_max), output, as_json)
        return
    if start is None:
        raise click.UsageError("Missing option '--vehicle': mass, geometry and inertia must be known.")
    from split_cli.vehicle.calibration.calibrate import CalibrationSettings
    from split_cli.workflows.sources import local_drives

    if figure is not None:
        from split_cli.plots.calibration import check_figure_path, plot_calibration

        check_figure_path(figure)
    settings = CalibrationSettings(
        parts=parts,
        alpha_max=alpha_max,
        max_longitudinal_acceleration=max_ax,
        max_lateral_acceleration=max_ay,
        smoothing=smooth,
        offsets=offsets,
    )
    given = {"training_blocks": training_blocks, "measured_lateral_acceleration": measured_ay}
    source = click.get_current_context().get_parameter_source("parts")
    given["only_what_can_be_fitted"] = source is click.core.ParameterSource.DEFAULT
    with local_drives(files) as paths:
        calibration, used = calibrate_files(paths, start, output, settings, **given)
    if figure is not None:
        plot_calibration(calibration, figure)
    _show_calibration(calibration, files, used, output, as_json)


def _show_foreign(written, output, as_json) -> None:
    if as_json:
        shared.print_json(written)
        return
    front, rear = written.deviations
    click.echo(f"lateral forces differ by at most {front:.3g} N at the front axle and {rear:.3g} N at the rear")
    for lost in written.lost:
        click.echo(f"not in this format: {lost}")
    click.echo(f"written: {output}")


def _show_calibration(calibration, drives, used, output, as_json) -> None:
    if as_json:
        names = ("samples", "blocks", "curves", "resistance", "estimates", "remarks")
        values = {name: getattr(calibration, name) for name in names}
        shared.print_json({"vehicle": output, "drives": used, **values})
        return
    if calibration.curves:
        header = (
            "axle",
            "B",
            "C",
            "D [N]",
            "determined",
            "stiffness [N/rad]",
            "+-",
            "covered to [rad]",
            "differ there [N]",
            "to alpha_max [N]",
            "held out [N]",
            "given file [N]",
            "force [N]",
        )
        rows = [
            (
                c.axle,
                c.tire.B,
                c.tire.C,
                c.tire.D,
                " ".join(c.determined) or "none",
                *_stiffness(c),
                three_digits(c.covered),
                *_differences(c),
                *map(three_digits, (c.held_out.calibrated, c.held_out.start, c.held_out.signal)),
            )
            for c in calibration.curves
        ]
        shared.print_table(header, rows)
    if calibration.resistance is not None:
        found = calibration.resistance
        click.echo()
        rows = [
            ("drag [N/(m/s)^2]", *pair_known(found.drag, found.drag_error), _yes("drag" in found.determined)),
            ("rolling [N]", *pair_known(found.rolling, found.rolling_error), _yes("rolling" in found.determined)),
            ("force per T/r_e [1]", *pair_known(*found.torque_gain), "check only"),
        ]
        shared.print_table(("resistance", "value", "+-", "determined"), rows)
        held = found.held_out
        click.echo(
            f"rms error of the longitudinal force, held out: {held.calibrated:.3g} N; with the given file "
            f"{held.start:.3g} N; the force itself {held.signal:.3g} N"
        )
    if calibration.estimates:
        click.echo()
        rows = [(e.name, *pair_known(e.value, e.error), _yes(e.settled)) for e in calibration.estimates]
        shared.print_table(("from turning", "value", "+-", "determined"), rows)
    print_notes(calibration.remarks)
    click.echo(f"wrote {output} from {calibration.samples} samples in {calibration.blocks} blocks of time", err=True)
    shared.tell_to_train(drives, output)


def _yes(determined: bool) -> str:
    return "yes" if determined else "no"


def _stiffness(curve) -> tuple[float | str, float | str]:
    """Return the fitted cornering stiffness and half its 95 % interval, to the digits that this supports."""
    if not curve.slope_is_known:
        return "open", "open"
    middle, low, high = curve.cornering_stiffness
    return pair_known(middle, 0.5 * (high - low))


def _differences(curve) -> tuple[str, ...]:
    """Return by how much equally good curves differ; nothing where not even their slope is known."""
    if not curve.slope_is_known:
        return "open", "open"
    return tuple(map(three_digits, (curve.deviation_covered, curve.deviation_everywhere)))


def _show_conversion(conversion, output, as_json) -> None:
    if as_json:
        shared.print_json(
            {"vehicle": output, "kind": conversion.kind, "tires": conversion.tires, "assumed": conversion.assumed}
        )
        return
    rows = [(t.axle, t.law, t.peak, t.largest_deviation, t.at) for t in conversion.tires]
    shared.print_table(("axle", "in the source", "D [N]", "largest deviation [N]", "at [rad]"), rows)
    for text in conversion.assumed:
        click.echo(f"assumed: {text}", err=True)
    click.echo(f"wrote {output} from a {conversion.kind} parameter file", err=True)
