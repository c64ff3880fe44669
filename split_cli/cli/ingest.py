"""`split ingest`: its options, and how its result is printed."""

import contextlib
import re
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import click

from split_cli.cli import options as shared
from split_cli.cli.verbosity import StepBar


def _pairs(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """Parse KEY=VALUE options."""
    for value in values:
        if "=" not in value:
            raise click.BadParameter(f"{value!r} is not of the form NAME=VALUE", context, parameter)
    return dict(value.split("=", 1) for value in values)


def _delays(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, float]:
    """Parse CHANNEL=SECONDS options."""
    try:
        delays = {channel: float(text) for channel, text in _pairs(context, parameter, values).items()}
    except ValueError as error:
        raise click.BadParameter(f"a delay is a number of seconds ({error})", context, parameter) from error
    for channel, delay in delays.items():
        if not abs(delay) < float("inf"):
            raise click.BadParameter(f"a delay is a number of seconds, {channel}={delay}", context, parameter)
    return delays


@click.command("ingest")
@click.argument("logs", nargs=-1, type=shared.existing_file, metavar="LOG...")
@shared.vehicle_option(required=False)
@click.option(
    "--map",
    "maps",
    multiple=True,
    type=shared.existing_file,
    metavar="MAP",
    help="Signal map: a YAML file or the name of a preset; repeatable. Logs that `split` wrote need none.",
)
@shared.output_option("Drive to write, or a folder if there are several logs.", required=False)
@click.option("--clock", type=click.Choice(["log", "publish", "header"]), help="Which time stamp of a message to use.")
@click.option(
    "--gap",
    type=float,
    metavar="S",
    help="Longest gap to interpolate over [s]. Default: 0.1; 2.5 sampling intervals for a required channel that is "
    "slower, down to 8 Hz.",
)
@click.option(
    "--rate",
    type=float,
    metavar="HZ",
    help="Sampling rate of the drive [default: of the slowest required channel, at most 100].",
)
@click.option(
    "--delay",
    "delays",
    multiple=True,
    callback=_delays,
    metavar="CHANNEL=S",
    help="Shift a channel that is late by S seconds to earlier times; repeatable.",
)
@click.option(
    "--estimate-delays", is_flag=True, help="Estimate and correct delays between channels from kinematic identities."
)
@click.option(
    "--derive",
    multiple=True,
    metavar="NAME",
    help="Compute a missing channel; repeatable. docs/ingest.md lists the names; so does the error for an unknown one.",
)
@click.option(
    "--topic",
    "topics",
    multiple=True,
    callback=_pairs,
    metavar="NAME=/TOPIC",
    help="Use this topic where the map says NAME.",
)
@shared.log_options
@click.option(
    "--start", type=float, metavar="S", help="Leave out everything before this time [s], counted from the first sample."
)
@click.option(
    "--end", type=float, metavar="S", help="Leave out everything after this time [s], counted from the first sample."
)
@click.option(
    "--cut",
    "cuts",
    multiple=True,
    type=shared.TimeSpan(),
    metavar="A:B",
    help="Leave out the time from A to B [s], counted from the first sample.",
)
@click.option("--keep-going", is_flag=True, help="Continue with the other logs when one fails.")
@click.option(
    "--report", type=shared.OutputPath("file"), metavar="FILE", help="Write an HTML report; for one drive only."
)
@click.option("--list", "list_only", is_flag=True, help="List the channels of the logs and exit.")
@click.option("--list-maps", is_flag=True, help="List the preset signal maps and exit.")
@click.option("--suggest-map", is_flag=True, help="Print a draft signal map for the log and exit.")
@shared.engine_options(None)
@shared.json_option
def command(logs, maps, vehicle_path, output, topics, message_paths, databases, as_json, **options) -> int:
    """Read recordings into drives: one uniform clock, SI units, ISO 8855 axes at the CG.

    The command prints what it converted, assumed, dropped and found inconsistent, and stores it in the drive.

    \b
    Example:
      split ingest lap.mcap --list
      split ingest lap.mcap --vehicle car.yaml --map map.yaml -o lap.parquet
      split ingest archive/ --vehicle car.yaml --map map.yaml -o drives/ --jobs 2 --keep-going
      split ingest cpg_slow_lap.mat --vehicle genesis --map genesis_slow \\
          --derive torque-from-acceleration -o genesis.parquet
    """
    from split_cli.workflows.engine import open_engine
    from split_cli.workflows.ingesting.ingest import IngestSettings, ingest_logs

    if options["list_maps"]:
        return _list_maps(as_json)
    if not logs:
        raise click.UsageError("Missing argument 'LOG...'.")
    message_paths = (*message_paths, *databases)
    if options["list_only"] or options["suggest_map"]:
        if output is not None:
            raise click.UsageError("'-o' is for drives. Write '> map.yaml' behind it, or let 'split init' draft a map.")
        return _look_at(logs, message_paths, options, vehicle_path, as_json)
    if output is None:
        raise click.UsageError("Missing option '-o'.")
    settings = IngestSettings(**{one.name: options[one.name] for one in fields(IngestSettings)})
    opened = open_engine(options["engine"], jobs=options["jobs"], scheduler=options["scheduler"])
    with opened as engine, StepBar() as progress:
        run = ingest_logs(
            logs,
            output,
            maps=maps,
            vehicle_path=vehicle_path,
            settings=settings,
            topics=topics,
            message_paths=message_paths,
            keep_going=options["keep_going"],
            together=options["together"],
            progress=progress,
            engine=engine,
        )
    if options["report"] is not None:
        _write_report(run, vehicle_path, options["report"])
    _tell_what_was_left(logs, output)
    others = _tell_of_other_cars(run, vehicle_path)
    _show(run, as_json)
    if not as_json and not run.failures:  # else the last lines are those of the logs that failed
        _tell_what_follows(run, output, vehicle_path, others)
    return 1 if run.failures else 0


def _tell_of_other_cars(run, vehicle_path: Path | None) -> list[Path]:
    """Say which drives look like those of another car; return their paths."""
    from split_cli.logs.drive import open_drive
    from split_cli.vehicle.parameters import read_vehicle
    from split_cli.workflows.recordings import looks_like_another_car

    faulty = [result.drive_path for result in run.results if result.contradictions]
    if vehicle_path is None or not faulty:
        return []
    car = read_vehicle(vehicle_path)
    said = {path: looks_like_another_car(open_drive(path), car) for path in faulty}  # a long drive stays in its file
    for path, text in said.items():
        if text:
            click.echo(f"WARNING: {path}: {text}", err=True)
    return [path for path, text in said.items() if text]


def _tell_what_follows(run, output: Path, vehicle_path: Path | None, others: Sequence[Path]) -> None:
    """Name the command that takes the drives; where one contradicts itself, what to mend first.

    Drives `others` look like those of another car than that of the vehicle file.
    """
    from split_cli.vehicle.parameters import read_vehicle

    drives = [result.drive_path for result in run.results]
    again = _command_with_what_is_named(run)
    faulty = [result.drive_path for result in run.results if result.contradictions]
    if others:
        shared.tell_next(before=f"ingest the log of {_first_names(others)} again with the file of its car")
    elif faulty:
        before = f"correct the map as `does not fit together` says of {_first_names(faulty)}, and ingest again"
        shared.tell_next(again, before=f"{before}: " if again else before)
    elif drives:
        vehicle = vehicle_path or Path("VEHICLE.yaml")
        car = read_vehicle(vehicle_path) if vehicle_path else None
        if car is not None and not any(result.reaches(car.minimum_speed) for result in run.results):
            shared.tell_next(
                before=f"take a faster drive: none here reaches the {car.minimum_speed:.3g} m/s from which on slip "
                f"angles tell of the tyres of {vehicle.name}, so nothing can be learned from it"
            )
            return
        if again:
            shared.tell_next(again, before="to correct what does not fit together, ingest again: ")
        doubtful = any(result.quality.consistency.findings for result in run.results)
        before = "see to what does not fit together, then: " if doubtful else ""
        before += "" if vehicle_path else "describe the car in VEHICLE.yaml (`split init` drafts one), then: "
        taken = drives if len(drives) < 4 else [output]
        assumed = any(one.metadata.sideslip_is_of_tires for one in run.results)
        if car is not None and car.has_assumed_tires and not assumed:
            before += f"the tyres of {vehicle.name} are assumed, fit them first: "
            known = ["--fit", "tires"] if any(one.metadata.torque_follows_motion for one in run.results) else []
            made = shared.named_after(drives[0], "calibrated.yaml")
            shared.tell_next(["split", "calibrate", *drives, "--vehicle", vehicle, *known, "-o", made], before=before)
        else:
            shared.tell_to_train(taken, vehicle, before=before)


def _first_names(paths: Sequence[Path]) -> str:
    return f"{', '.join(map(str, paths[:3]))}{' ...' if len(paths) > 3 else ''}"


def _command_with_what_is_named(run) -> list[str]:
    """Return this command with the derivations that its findings name, to run again; empty where they name none."""
    findings = [finding.text for result in run.results for finding in result.quality.consistency.findings]
    named = [name for text in findings for name in re.findall(r"--derive ([a-z-]+[a-z])", text)]
    context = click.get_current_context()
    asked = {name.replace("_", "-") for name in context.params["derive"]}
    more = [word for name in dict.fromkeys(named) if name not in asked for word in ("--derive", name)]
    return [*shared.given_words(context), *more] if more else []


def _write_report(run, vehicle_path, path: Path) -> None:
    from split_cli.workflows.pages import write_recording_report

    if len(run.results) != 1:
        raise click.UsageError(f"--report shows one drive, {len(run.results)} were made; ingest one at a time.")
    write_recording_report(run.results[0].drive, vehicle_path, path)
    click.echo(f"split: report in {path}", err=True)


def _show(run, as_json: bool) -> None:
    if as_json:
        shared.print_json([result.to_mapping() for result in run.results])
    else:
        for result in run.results:
            click.echo(result.to_text())
    if run.unchanged:
        click.echo(f"note: {len(run.unchanged)} unchanged since they were ingested, not read again", err=True)
    if run.failures and len(run.results) + len(run.unchanged) + len(run.failures) > 1:
        made = len(run.results) + len(run.unchanged)
        click.echo(f"split: {len(run.failures)} of {made + len(run.failures)} logs gave no drive:", err=True)
    for failure in run.failures:
        click.echo(f"split: {failure.error}", err=True)


def _tell_what_was_left(logs, output) -> None:
    """Say which files of given folders are taken for no recordings."""
    from split_cli.workflows.sources import skipped_files

    left = skipped_files(logs, outside=output)
    if left:
        kinds = ", ".join(f"{count} {ending}" for ending, count in list(left.items())[:8])
        click.echo(
            f"note: files that are no logs by ending or content: {kinds}; a pattern such as '*.json' takes them",
            err=True,
        )


def _list_maps(as_json: bool) -> int:
    from split_cli.logs.presets import preset_abouts

    if as_json:
        shared.print_json(preset_abouts())
        return 0
    for name, about in preset_abouts().items():
        click.echo(f"{name}: {about}")
    return 0


def _look_at(logs, message_paths, options, vehicle_path, as_json: bool) -> int:
    from split_cli.workflows.ingesting.ingest import open_listed, suggest_map_for
    from split_cli.workflows.sources import enter_all, find_sources

    described = []
    found, together = find_sources(logs), options["together"]
    for sources in [found] if together else [[source] for source in found]:
        names = [source.address for source in sources]
        with contextlib.ExitStack() as stack:
            paths = enter_all(sources, stack)
            log = paths if together else paths[0]
            if options["suggest_map"]:
                draft = suggest_map_for(
                    log, message_paths=message_paths, row_rate=options["row_rate"], vehicle_path=vehicle_path
                )
                described.append({"log": "+".join(names), "map": draft})
                if not as_json:
                    click.echo(draft)
                continue
            recording, lines = open_listed(log, message_paths=message_paths)
            channels, clocks = recording.channels(), recording.clocks
        if as_json:
            listed = {"log": "+".join(names), "clocks": list(clocks), "channels": list(channels)}
            arrays = {line.name: line.example for line in lines if line.example}
            described.append({**listed, "arrays": arrays, "notes": list(recording.notes)})
            continue
        alone = "each channel has its own" if getattr(recording, "own_clocks", False) else "none, time is a column"
        shown, known = " + ".join(names), ", ".join(clocks) or alone
        click.echo(f"{shown}: {len(channels)} channels; clocks: {known}")
        rows = [[line.name, line.info.type_name, line.info.count, line.info.unit] for line in lines]
        shared.print_table(["channel", "type", "count", "unit"], rows)
        if examples := [line.example for line in lines if line.example]:
            # Nobody maps a covariance, nor what holds nothing.
            useful = [one.example for one in lines if one.example and not re.search(r"covariance|\[\.\.\]", one.name)]
            example = next(iter(useful), examples[0])
            click.echo(f"note: an array stands in one line; a map names one element, such as {example}", err=True)
        for note in recording.notes:
            click.echo(f"note: {note.where}: {f'{note.count} x ' * (note.count > 1)}{note.what}", err=True)
    if as_json:
        shared.print_json(described if len(described) > 1 else described[0])
    return 0
