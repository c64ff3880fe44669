"""Options that several commands share, and how results are printed."""

import json
import math
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from split_cli.cli.digits import Printed, plausible
from split_cli.errors import SplitError
from split_cli.files import json_ready, typed_path


class _PlaceOfFile(click.Path):
    """A path that no two options of a command may name, if one of them is an output.

    Not checked here: a file that cannot be read is an input at fault (one line, exit code 1), not wrong usage.
    """

    kind = "input"

    def __init__(self) -> None:
        super().__init__(path_type=Path, readable=False)

    def convert(self, value, param, ctx) -> Path:
        """Return the path; refuse a file that another option names, where one of both is written."""
        path = super().convert(value, param, ctx)
        place = os.path.realpath(path)
        seen = ctx.meta.setdefault(__name__, {}) if ctx is not None else {}
        other, kind = seen.setdefault(place, (param, self.kind))
        if param is not other and (self.kind, kind) != ("input", "input") and not os.path.isdir(place):
            name = other.opts[-1] if isinstance(other, click.Option) else other.human_readable_name
            raise SplitError(f"is {name} too, it would be overwritten", where=str(path), advice="Name another file.")
        return path


existing_file = _PlaceOfFile()


class _Positive(click.FloatRange):
    """A positive number; infinity and what is no number are none."""

    def __init__(self) -> None:
        super().__init__(0.0, min_open=True)

    def convert(self, value, param, ctx) -> float:
        """Return the number."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is no finite number", param, ctx)
        return number


positive = _Positive()


class OutputPath(_PlaceOfFile):
    """A place to write to, which must be open to writing before the command begins its work.

    Parameters
    ----------
    kind : {"file", "folder", "either"}
    """

    def __init__(self, kind: str) -> None:
        super().__init__()
        self.kind = kind

    def convert(self, value, param, ctx) -> Path:
        """Return the path; refuse it where nothing can be written there."""
        from split_cli import files

        path = super().convert(value, param, ctx)
        refuse = {
            "file": files.refuse_what_cannot_be_written,
            "folder": files.refuse_what_cannot_be_a_folder,
            "either": files.refuse_place_without_access,
        }
        refuse[self.kind](path)
        return path


class TimeSpan(click.ParamType):
    """START:STOP in seconds."""

    name = "START:STOP"

    def convert(self, value, param, ctx) -> tuple[float, float]:
        """Return (start, stop)."""
        if isinstance(value, tuple):
            return value
        try:
            start, stop = (float(part) for part in value.split(":"))
        except ValueError:
            self.fail(f"{value!r} is not START:STOP in seconds, for example 60:90", param, ctx)
        if not start < stop:
            self.fail(f"{value!r} does not end after it starts", param, ctx)
        return start, stop


def refuse_without_use(used: Mapping[str, tuple[bool, str]]) -> None:
    """Refuse options that were given and would change nothing.

    Parameters
    ----------
    used : mapping of str to (bool, str)
        By an option's parameter: whether it has a use, and what it belongs to.
    """
    context = click.get_current_context()
    for parameter, (useful, belongs) in used.items():
        given = context.get_parameter_source(parameter) is ParameterSource.COMMANDLINE
        if given and not useful:
            raise click.UsageError(f"--{parameter.replace('_', '-')} belongs to {belongs}; leave it out.")


def list_of(kind: Callable) -> Callable:
    """Return a callback that parses a comma-separated list."""

    def parse(context: click.Context, parameter: click.Parameter, text: str | None) -> tuple:
        try:
            return tuple(kind(part.strip()) for part in (text or "").split(",") if part.strip())
        except ValueError as error:
            raise click.BadParameter(f"{text!r} ({error})", context, parameter) from error

    return parse


def vehicle_option(required: bool = True) -> Callable:
    """``--vehicle FILE``, the vehicle YAML."""
    return click.option(
        "--vehicle",
        "vehicle_path",
        type=existing_file,
        required=required,
        metavar="FILE",
        help="Vehicle file (YAML); `split init` drafts one.",
    )


def held_option(function: Callable) -> Callable:
    """``--held T,delta``: inputs that keep their value between samples; passed on as a tuple of names."""
    return click.option(
        "--held",
        default="",
        show_default=False,
        metavar="NAMES",
        callback=list_of(str),
        help="Inputs (T,delta) to treat as constant until the next sample. By default the files decide; "
        "other inputs are interpolated linearly.",
    )(function)


def json_option(function: Callable) -> Callable:
    """``--json``: print the result as JSON on stdout instead of a table."""
    return click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")(function)


def engine_options(processes: int | None, workers: str = "processes") -> Callable:
    """``--engine``, ``--scheduler``, ``--jobs``: where the work is done; results do not depend on it.

    Without ``--jobs`` there are so many `processes`; None stands for one a core. `workers` says what they are.
    """
    usual = "one a core, at most 4" if processes is None else str(processes)

    def decorate(function: Callable) -> Callable:
        for option in (
            click.option(
                "--jobs",
                type=click.IntRange(1),
                default=processes,
                show_default=False,
                metavar="N",
                help=f"Number of {workers}; default: {usual}.",
            ),
            click.option(
                "--scheduler", metavar="ADDRESS", help="Address of a running Dask scheduler, tcp://HOST:PORT."
            ),
            click.option(
                "--engine",
                type=click.Choice(["process", "dask"]),
                default="process",
                help="Work on this machine or on a Dask cluster; the result is the same.",
            ),
        ):
            function = option(function)
        return function

    return decorate


def log_options(function: Callable) -> Callable:
    """``--together``, ``--row-rate``, ``--msg-path``, ``--dbc``: what a log does not say of itself."""
    for option in (
        _definitions("--dbc", "databases", "FILE", "DBC database that decodes a CAN log."),
        _definitions("--msg-path", "message_paths", "DIR", "Folder with .msg definitions of ROS messages."),
        click.option("--row-rate", type=positive, metavar="HZ", help="Sampling rate of a table without a time column."),
        click.option("--together", is_flag=True, help="Join the logs into one drive; each file keeps its own clock."),
    ):
        function = option(function)
    return function


def label_options(function: Callable) -> Callable:
    """``--stride``, ``--plain-labels``: which labels are computed, and how."""
    for option in (
        click.option(
            "--plain-labels",
            "plain",
            is_flag=True,
            help="Compute labels by the paper's plain damped difference, to reproduce the paper.",
        ),
        click.option(
            "--stride", type=int, metavar="N", help="Samples between two labels; default: as many as the horizon has."
        ),
    ):
        function = option(function)
    return function


def car_option(function: Callable) -> Callable:
    """``--car``: the simulated car that a controller drives."""
    cars = "Simulated car: road_car, f1tenth_car or formula_car."
    return click.option("--car", default="road_car", metavar="NAME", help=cars)(function)


def grip_option(function: Callable) -> Callable:
    """``--grip``: of the road that a controller drives on."""
    meaning = "Friction scale of the road: 1 dry, 0.5 wet."
    return click.option("--grip", type=float, default=1.0, metavar="SCALE", help=meaning)(function)


def sensor_options(function: Callable) -> Callable:
    """``--width``, ``--seed``, ``--exact-sensors``, ``--no-delay``: what a controller has of the simulated car."""
    for option in (
        click.option("--no-delay", is_flag=True, help="Apply commands at once instead of one sampling interval later."),
        click.option("--exact-sensors", is_flag=True, help="Simulate sensors without noise."),
        click.option("--seed", type=int, default=0, metavar="N", help="Random seed of the sensor noise."),
        click.option(
            "--width", type=float, metavar="M", help="Width of the car's body  [default: 1.15 times its track width]."
        ),
    ):
        function = option(function)
    return function


def _definitions(flag: str, name: str, metavar: str, meaning: str) -> Callable:
    return click.option(flag, name, multiple=True, type=existing_file, metavar=metavar, help=meaning)


def output_option(
    meaning: str, required: bool = True, names: Sequence[str] = ("-o", "--output"), *, folder: bool = False
) -> Callable:
    """``-o PATH``, whose place must be open to writing before the command begins its work."""
    return click.option(
        *names,
        "output",
        type=OutputPath("folder" if folder else "either"),
        required=required,
        metavar="PATH",
        help=meaning,
    )


def print_json(result: Any) -> None:
    """Print a result (dataclasses, arrays, paths) as JSON; not-a-number becomes null."""
    click.echo(json.dumps(json_ready(result), indent=2, sort_keys=False, allow_nan=False))


def print_table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Print an aligned table: text to the left, numbers to the right."""
    texts = [[_cell(value) for value in row] for row in rows]
    widths = [max(len(column), *(len(row[i]) for row in texts), 0) for i, column in enumerate(header)]
    numeric = [all(isinstance(row[i], int | float) or row[i] is None for row in rows) for i in range(len(header))]

    def line(cells: Sequence[str]) -> str:
        parts = [c.rjust(w) if n else c.ljust(w) for c, w, n in zip(cells, widths, numeric, strict=True)]
        return "  ".join(parts).rstrip()

    click.echo(line(header))
    click.echo("  ".join("-" * width for width in widths))
    for row in texts:
        click.echo(line(row))
    _print_legend([*header, *(row[0] for row in texts if row)])


def _print_legend(names: Sequence[str]) -> None:
    """Explain columns (and rows that have a meaning) below a table, where it is asked for."""
    context = click.get_current_context(silent=True)
    if context is None or not (context.find_root().obj or {}).get("legend"):
        return
    from split_cli.cli.columns import meaning

    meanings = {name: meaning(context.info_name or "", name) for name in names}
    for name, text in meanings.items():
        if text:
            click.echo(f"  {name}: {text}")


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, Printed):
        return value.text
    if isinstance(value, float):
        return plausible(value)
    return str(value)


def tell_to_train(drives: Sequence[Path], vehicle: Path | str, *, held: Sequence[str] = (), before: str = "") -> None:
    """Name the command that trains on drives; the set is called as the one drive, or as the car of several."""
    name = Path(drives[0] if len(drives) == 1 else vehicle).stem
    same = ["--held", ",".join(held)] if held else []
    tell_next(["split", "train", *drives, "--vehicle", vehicle, *same, "-o", f"{name}.split"], before=before)


def named_after(path: Path | str, what: str) -> str:
    """Return a name for an output that no other log's output has."""
    return f"{Path(path).stem}_{what}"


def tell_left_out(failures: Sequence[str]) -> None:
    """Print on stderr which drives were left out, with the reason of each."""
    for text in failures:
        click.echo(f"split: left out: {text}", err=True)


def given_words(context: click.Context) -> list[str]:
    """Return the words of the command that runs, with the options that were given on its command line."""
    words = ["split", str(context.command.name)]
    for parameter in context.command.params:
        source = context.get_parameter_source(str(parameter.name))
        if source is not ParameterSource.COMMANDLINE:
            continue
        value = context.params[parameter.name]
        several = parameter.multiple if isinstance(parameter, click.Option) else parameter.nargs != 1
        for one in (value.items() if isinstance(value, dict) else value) if several else (value,):
            if isinstance(parameter, click.Option):
                words.append(parameter.opts[0])
                if parameter.is_flag:
                    continue
            text = one if isinstance(one, str) else typed_path(one) if isinstance(one, Path) else None
            joint = "=" if isinstance(value, dict) else ":"
            words.append(text or (joint.join(map(_plain, one)) if isinstance(one, tuple) else _plain(one)))
    return words


def _plain(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def tell_next(words: Sequence[str | Path] = (), *, before: str = "") -> None:
    """Print the command to run next on stderr, as a line to copy; `before` says what has to be done first."""
    line = before + " ".join(shlex.quote(typed_path(w) if isinstance(w, Path) else w) for w in words)
    if line:
        click.echo(f"next: {line}", err=True)
