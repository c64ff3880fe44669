"""`split prove`: its options, and how its result is printed."""

import contextlib
from pathlib import Path

import click

from split_cli.cli import options as shared

_folder = click.Path(path_type=Path, file_okay=False)


@click.group("prove", context_settings={"help_option_names": ["-h", "--help"]})
def command() -> None:
    """Validate the diagnosis on simulated or recorded drives with hidden, known effects.

    generate writes cases, and their true effects into a file whose hash it prints (the seal). identify diagnoses
    the cases without reading that file. score compares both. An interrupted step continues where it stopped. Seeds
    0 to 999 are for development, those from 1000000 on for reports.

    \b
    Example:
      split prove generate proof --seed 5 --cases 40 --jobs 2
      split prove generate sets --seed 5 --cases 10 --sets
      split prove identify proof --jobs 2
      split prove score proof
      split prove recording drive.parquet --vehicle car.yaml -o faults
    """


@command.command("generate")
@click.argument("folder", type=_folder)
@click.option("--seed", type=int, required=True, help="The same seed gives the same cases.")
@click.option("--cases", type=click.IntRange(1), default=40, help="Number of cases.")
@click.option(
    "--kinds",
    default="null,single,pair,strange",
    help="Kinds of cases; also hard-pair, set, nominal-set and whole-car.",
)
@click.option("--sets", is_flag=True, help="Short for --kinds set,nominal-set: sets of three to five effects.")
@shared.engine_options(1)
@shared.json_option
def generate(folder, seed, cases, kinds, sets, engine, scheduler, jobs, as_json) -> None:
    """Write cases and their hidden answers.

    The hash of the answers, the seal, is printed."""
    from split_cli.workflows.engine import open_engine
    from split_cli.workflows.proving.prove import generate_cases

    kinds = tuple(("set,nominal-set" if sets else kinds).split(","))
    with open_engine(engine, jobs=jobs, scheduler=scheduler) as where:
        seal = generate_cases(folder, seed, cases, apply=where.map, kinds=kinds, count=_progress("cases"))
    _tell_seal(seal, as_json)


@command.command("identify")
@click.argument("folder", type=_folder)
@click.option("--limit", type=click.IntRange(1), help="Diagnose only this many cases, from the first.")
@shared.engine_options(1)
@shared.json_option
def identify(folder, limit, engine, scheduler, jobs, as_json) -> None:
    """Diagnose the cases that have no result yet.

    The answers are not read. The seal is printed first."""
    from split_cli.workflows.engine import open_engine
    from split_cli.workflows.proving.prove import check_seal, identify_cases

    _tell_seal(check_seal(folder), as_json)
    with contextlib.ExitStack() as stack:
        own = engine == "process" and scheduler is None
        cluster = None if own else stack.enter_context(open_engine(engine, jobs=jobs, scheduler=scheduler))
        identify_cases(folder, jobs=jobs, limit=limit, count=_progress("identified"), cluster=cluster)


@command.command("score")
@click.argument("folder", type=_folder)
@click.option("--markdown", type=shared.OutputPath("file"), help="Write all tables to this file as well.")
@shared.json_option
def score(folder, markdown, as_json) -> None:
    """Read the answers, check their seal, and score the diagnoses."""
    from split_cli.proof.tables import markdown_of, target_rows
    from split_cli.workflows.proving.prove import score_cases

    result = score_cases(folder, count=_progress("scored"))
    if markdown:
        from split_cli.files import atomic_write_text

        atomic_write_text(markdown, markdown_of(result))
    if as_json:
        shared.print_json(result)
        return
    click.echo(f"seal {result.seal.sha256}, {result.identified} of {result.cases} cases identified")
    shared.print_table(["what", "goal", "reached", "met"], target_rows(result.diagnosis))
    for name, failure in result.failed:
        click.echo(f"case {name} could not be diagnosed: {failure}", err=True)


def _numbers(text: str | None) -> list[float]:
    try:
        return [float(one) for one in text.split(",")] if text else []
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a list of numbers", param_hint="--multiples") from None


@command.command("recording")
@click.argument("drives", type=shared.existing_file, nargs=-1, required=True)
@click.option("--vehicle", "vehicle_path", type=shared.existing_file, required=True, help="Vehicle YAML.")
@shared.output_option("Folder to write into.")
@click.option("--faults", help="Only these faults, separated by commas. A wrong name lists all names.")
@click.option("--block", type=float, default=10.0, help="Length of the blocks of time [s].")
@click.option("--halves", is_flag=True, help="Use the first and second half of a drive instead of alternating blocks.")
@click.option(
    "--multiples", help="Fault sizes as multiples of the detection limit of the pair without a fault, e.g. 0.5,1,1.5."
)
@shared.json_option
def recording(drives, vehicle_path, output, faults, block, halves, multiples, as_json) -> None:
    """Diagnose real recordings with known faults added.

    Alternating blocks of time of a drive form two halves. One half stays as it is and stands for the simulation;
    the other gets the fault. One more pair has no fault.
    """
    from split_cli.workflows.proving.prove_recording import prove_recording

    rows = prove_recording(
        drives,
        vehicle_path,
        output,
        only=faults.split(",") if faults else None,
        block=block,
        halves=halves,
        multiples=_numbers(multiples),
        count=_progress("faults"),
    )
    if as_json:
        shared.print_json(rows)
        return
    header = ["drive", "fault", "put in", "outcome", "said", "found", "interval"]
    shared.print_table(header, [[r.drive, r.fault, r.value, r.outcome, r.said, r.found, r.interval] for r in rows])


def _tell_seal(seal, as_json: bool) -> None:
    if as_json:
        shared.print_json(seal)
    else:
        click.echo(f"seal {seal.sha256} of {seal.cases} answers, seed {seal.seed}, version {seal.version}")


def _progress(what: str):
    """Return a function that tells progress on stderr."""
    from split_cli.cli.verbosity import StepBar

    bar = StepBar()
    bar.text = what

    def count(done: int, total: int) -> None:
        bar.count(done, total)
        if done == total:
            bar.close()

    return count
