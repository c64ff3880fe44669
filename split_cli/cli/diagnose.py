"""`split diagnose`: its options, and how its result is printed."""

import sys

import click

from split_cli.cli import options as shared
from split_cli.cli.digits import pair_known
from split_cli.cli.verbosity import StepBar

_BEGINS = {
    "smoothing": 0.0,
    "whitening": 0.02,
    "comparing": 0.05,
    "naming": 0.12,
    "naming with a fixed baseline": 0.3,
    "naming again beside what was found": 0.4,
    "naming with the late channel put right": 0.65,
    "sizing": 0.75,
    "judging": 0.85,
    "writing": 0.95,
}
"""Share of the whole time at which each step begins [1], beside a simulation."""
BEGINS_ALONE = {
    "smoothing": 0.0,
    "whitening": 0.003,
    "comparing": 0.008,
    "naming": 0.012,
    "naming with a fixed baseline": 0.4,
    "naming again beside what was found": 0.4,
    "naming with the late channel put right": 0.75,
    "sizing": 0.8,
    "judging": 0.92,
    "writing": 0.95,
}
"""The same against the nominal model, which lacks more effects than a simulation: naming takes most of the time. It was
measured on 39 s of a 1:10 car, with nine effects."""
_CHANNELS = ("v_x [m/s]", "v_y [m/s]", "r [rad/s]")
#: Stages of the improvement, in the words of the report.
_STAGES = {
    "before": "simulation as it is",
    "physics": "with the identified effects",
    "split_only": "with SPLIT only",
    "after": "with effects and SPLIT",
    "persistence": "persistence",
    "noise_floor": "noise floor",
}


@click.command("diagnose")
@click.option(
    "--real",
    "real",
    type=shared.existing_file,
    required=True,
    multiple=True,
    help="Real drive, or a folder or address of drives; repeatable.",
)
@click.option(
    "--sim", "simulated", type=shared.existing_file, multiple=True, help="Simulated drive, or drives; repeatable."
)
@click.option(
    "--holdout",
    type=shared.existing_file,
    multiple=True,
    help="Real drive on which the improvement is measured; repeatable.",
)
@shared.vehicle_option()
@shared.output_option("Folder to write into.", names=("--out",), folder=True)
@click.option("--exit-code", is_flag=True, help="Exit with code 3 if simulation and reality differ.")
@shared.held_option
@shared.engine_options(None, "threads")
@shared.json_option
def command(real, simulated, holdout, vehicle_path, output, exit_code, held, engine, scheduler, jobs, as_json) -> None:
    """Say where a simulation and a real drive differ, and name the physics that the simulation lacks.

    Without --sim the nominal model of the vehicle file serves as the simulation. The improvement is measured on
    real driving that is held out: the drives of --holdout, or else the last quarter of the real drives.

    With --engine dask, a cluster computes fits of the search, self-tests and detection limits.

    \b
    Example:
      split diagnose --real lap.parquet --sim twin.parquet --vehicle car.yaml --out diagnosis
    """
    from split_cli.diagnosis.parallel import use_threads
    from split_cli.diagnosis.statement.document import VEHICLES, diagnosis_to_text, vehicle_name
    from split_cli.workflows.diagnose import diagnose_files
    from split_cli.workflows.engine import open_engine
    from split_cli.workflows.sources import local_drives

    use_threads(jobs or 0)
    with (
        local_drives(real) as recorded,
        local_drives(simulated) as simulations,
        local_drives(holdout) as held_out,
        open_engine(engine, jobs=jobs, scheduler=scheduler) as where,
        StepBar(shares=_BEGINS if simulated else BEGINS_ALONE) as progress,
    ):
        files = {"simulated": simulations, "holdout": held_out, "held": held, "engine": where}
        files |= {"progress": progress, "note": progress.note}
        result = diagnose_files(recorded, vehicle_path, output, **files)
    if as_json:
        click.echo(diagnosis_to_text(result), nl=False)
    else:
        click.echo(f"split: report in {output / 'report.html'}", err=True)
        _tell(result)
        if vehicle_name(result) == VEHICLES[0]:
            shared.tell_to_train(real, output / VEHICLES[0], held=held)
    if exit_code and result.verdict == "mismatch":
        sys.exit(3)


def _tell(result) -> None:
    """Print a diagnosis: verdict, summary, findings, and whether they help."""
    chance = result.p_value
    p_value = "" if chance is None else ", p < 1e-6" if chance < 1e-6 else f", p = {chance:.2g}"
    click.echo(f"{result.verdict}{p_value}; compared {100.0 * result.compared_share:.0f} % of the real drive")
    if result.doubt:
        click.echo(result.doubt)
    click.echo("\n".join(result.sentences))
    # Beside the summary: a match says nothing of what these drives cannot show.
    for note in result.not_judged:
        if note not in result.summary:
            click.echo(f"not judged: {note}")
    if result.findings:
        rows = [
            [f.label, name, *pair_known(p.value, p.std_error), p.unit, ", ".join(f.alternatives)]
            for f in result.findings
            for name, p in f.parameters.items()
        ]
        shared.print_table(["term", "parameter", "value", "std error", "unit", "explained as well by"], rows)
    for lead in result.leads:
        click.echo(lead.sentence)
    if result.verdict == "match" and result.detectable:
        click.echo("each effect, alone on these drives, would have been identified from about this size on")
        rows = [
            [one.term, name, f"{value:.3g}", unit]
            for one in result.detectable
            for name, (value, unit) in one.parameters.items()
        ]
        rows += [[one.term, "", "at no size of a real car", ""] for one in result.detectable if not one.parameters]
        shared.print_table(["term", "parameter", "from", "unit"], rows)
    if result.improvement is not None and result.improvement.rollouts:
        last = result.improvement.rollouts[-1]
        named = ", ".join(one.name for one in result.inputs if one.role == "holdout")
        where = named or f"the last {100.0 * result.settings.get('holdout_share', 0.0):.0f} % of each real drive"
        click.echo(
            f"held out: {where}; rms error there after {last.horizon:g} s of open-loop simulation, 95 % intervals"
        )
        stages = [stage for stage in _STAGES if result.findings or stage not in ("physics", "after")]
        shared.print_table(["", *_CHANNELS], [[_STAGES[stage], *_with_intervals(last, stage)] for stage in stages])


def _with_intervals(errors, stage: str) -> list[str]:
    values, intervals = getattr(errors, stage), errors.confidence.get(stage)
    if not intervals:
        return [f"{value:.3g}" for value in values]
    return [f"{v:.3g} ({low:.3g} to {high:.3g})" for v, (low, high) in zip(values, intervals, strict=True)]
