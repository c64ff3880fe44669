"""`split export`: its options, and how its result is printed."""

import click

from split_cli.cli.digits import three_digits, two_digits
from split_cli.cli.options import existing_file, json_option, output_option, positive, print_json, print_table
from split_cli.cli.verbosity import print_notes


@click.command("export")
@click.argument("set_path", type=existing_file, metavar="SET.split")
@click.option(
    "--target",
    "targets",
    multiple=True,
    required=True,
    type=click.Choice(["c", "casadi", "npz", "json", "ggv"]),
    help="Format to write; repeatable. ggv: limits of acceleration at each speed, for lap-time planners.",
)
@output_option("Folder to write into.", folder=True)
@click.option(
    "--predictor",
    default="projected",
    type=click.Choice(["projected", "table", "bcm", "rbcm"]),
    help="projected: Gaussian process on at most 600 points. table: B-splines of projected, the fastest. "
    "bcm: Bayesian committee machine of one Gaussian process a cell. rbcm: its robust form.",
)
@click.option("--name", metavar="NAME", help="Prefix of files and functions [default: the set's file name].")
@click.option("--real", default="double", type=click.Choice(["double", "float"]), help="Number type of the C code.")
@click.option(
    "--queries",
    default=10_000,
    type=click.IntRange(100, 10_000_000),
    metavar="N",
    help="Number of queries on which the export is compared with Python.",
)
@click.option(
    "--step",
    type=positive,
    metavar="S",
    help="Sampling time of the controller [s]; it matters only where the vehicle file delays commands [default: "
    "the set's label interval].",
)
@click.option(
    "--insist",
    is_flag=True,
    help="Export even if drives are faulty, labels are too few, or the correction helps no output.",
)
@json_option
def command(set_path, targets, output, predictor, name, real, queries, step, insist, as_json) -> None:
    """Write a trained set as code or numbers for controllers and other programs.

    Every target is first compared with Python, at random and at the borders of cells. If one differs, nothing is
    written.
    C is compiled with $CC, or cc, gcc or clang. Without a compiler the C is written and reported as unverified.

    \b
    Example:
      split export car.split --target c --target casadi -o controller/
    """
    from split_cli.workflows.export import export_set

    result = export_set(
        set_path,
        output,
        targets,
        predictor=predictor,
        name=name,
        real=real,
        queries=queries,
        step=step,
        insist=insist,
        progress=lambda line: click.echo(f"{line} ...", err=True),
    )
    print_notes(f"WARNING: {doubt}" for doubt in result.doubts)
    print_notes(result.reservations)
    if as_json:
        print_json(result)
        return
    header = ["target", "mean error", "variance error", "Jacobian error", "step error", "us/query", "tables kB"]
    print_table([*header, "code kB"], [_row(target) for target in result.targets])
    checked = ", ".join(target.target for target in result.targets if target.check)
    if checked:
        click.echo(f"{checked}: compared with Python on {queries} queries, all errors within the tolerances\n")
    click.echo(f"{result.points} points in {result.cells} cells, set SHA-256 {result.set_sha256}")
    for target in result.targets:
        click.echo(f"{target.target}: {', '.join(target.files)} ({target.note})")
    click.echo(f"written: {result.folder}")


def _row(target) -> list:
    check = target.check
    sizes = [check.mean_error, check.variance_error, check.jacobian_error] if check else [None] * 3
    errors = [None if size is None else two_digits(size) for size in (*sizes, target.step_error)]
    microseconds = None if target.seconds_per_query is None else target.seconds_per_query * 1e6
    code = None if target.code_bytes is None else target.code_bytes / 1e3
    speed = None if microseconds is None else three_digits(microseconds)
    return [target.target, *errors, speed, three_digits(target.table_bytes / 1e3), code and three_digits(code)]
