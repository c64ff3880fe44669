"""The group of commands, loaded one by one, and the one place where an error becomes a line and an exit code."""

import contextlib
import importlib
import os
import signal
import sys
import threading
import warnings
import weakref
from types import FrameType

import click

from split_cli import CACHE_NOTE, __version__
from split_cli.cli.verbosity import show_only
from split_cli.compiled_code import postponed_by_compiled_code, send_again
from split_cli.errors import NumericalRepairWarning, SplitError, nearest_names

COMMANDS = {
    "init": "Draft a signal map and a vehicle file for a recording.",
    "ingest": "Read recordings into drives on one clock, in SI units.",
    "label": "Compute the error of the nominal model, sample by sample.",
    "train": "Learn the error of the nominal model from drives into a trained set.",
    "evaluate": "Measure the error of a corrected model on drives or held-out blocks.",
    "compare": "Compare models on the same drives.",
    "export": "Write a trained set as C, CasADi, npz or json.",
    "calibrate": "Fit a vehicle file to gentle drives, or convert another project's file.",
    "diagnose": "Say where a simulation and a real drive differ, and why.",
    "prove": "Validate the diagnosis on cases with hidden, known effects.",
    "race": "Race the simulated car with a controller that learns while it drives.",
    "maneuver": "Drive ISO 3888 and brake-and-avoid between cones.",
    "simulate": "Simulate the double-track car and write its logs.",
    "explain": "Explain the columns of printed tables.",
    "info": "Describe a file: its kind, content and origin.",
    "verify": "Check the integrity of a file or folder of this program.",
    "demo": "Run all steps on the bundled samples.",
}

_COREUTILS_OPTIONS = ("-a", "-b", "-C", "-d", "-e", "-l", "-n", "-t", "-u", "-x", "--bytes", "--lines", "--number")


#: Options of the group that a user may write behind the command as well.
_ANYWHERE = ("--quiet", "--verbose", "--legend")

_STOPPED = "stopped; what was being written is left as it was before"


class LazyGroup(click.Group):
    """A group that knows its commands by name and imports one only when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the commands in the order in which one uses them."""
        return [name for name in COMMANDS if _exists(name)]

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """Import and return one command."""
        if name not in COMMANDS or not _exists(name):
            return None
        return importlib.import_module(f"split_cli.cli.{name}").command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name]) for name in self.list_commands(ctx)] or [("-", "none")])

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple:
        """Find the command; name the nearest, or say that this is not the split of coreutils."""
        name = args[0] if args else ""
        if name not in COMMANDS and (os.path.exists(name) or name == "-"):
            raise click.UsageError(_not_coreutils(name), ctx)
        if self.get_command(ctx, name) is None:
            advice = nearest_names(name, self.list_commands(ctx))
            raise click.UsageError(f"No such command {name!r}. {advice}", ctx)
        return super().resolve_command(ctx, args)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the group's own options; those that say how much is said may stand anywhere."""
        end = args.index("--") if "--" in args else len(args)
        moved = [word for word in args[:end] if word in _ANYWHERE]
        args = [*moved, *(word for word in args[:end] if word not in _ANYWHERE), *args[end:]]
        if args and args[0].startswith(_COREUTILS_OPTIONS):
            raise click.UsageError(_not_coreutils(args[0]), ctx)
        return super().parse_args(ctx, args)


def _exists(name: str) -> bool:
    folder = os.path.dirname(__file__)
    return os.path.isfile(os.path.join(folder, f"{name}.py"))


def _not_coreutils(name: str) -> str:
    return (
        f"{name!r} is not a command. This `split` learns vehicle models from driving logs; the `split` of "
        "coreutils, which cuts files into pieces, is usually /usr/bin/split. To avoid the clash call this one "
        "`split-cli`."
    )


#: Of every command: the help shows what an option is without being given.
_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100, "show_default": True}


@click.command(cls=LazyGroup, context_settings=_SETTINGS)
@click.version_option(__version__, prog_name="split", message="%(prog)s %(version)s")
@click.option("--quiet", is_flag=True, help="Print only warnings and errors; results still go to stdout.")
@click.option("--verbose", is_flag=True, help="Report every step, also without a terminal.")
@click.option("--legend", is_flag=True, help="Explain the columns below every table.")
@click.option("--config", metavar="FILE", help="YAML file with options; it overrides ./split.yaml and the user's file.")
@click.pass_context
def group(context, quiet, verbose, legend, config) -> None:
    """Turn driving logs into vehicle models that a controller can trust, and explain what a simulation lacks.

    \b
    Example, from a log to C code:
      split init lap.mcap -o car/
      split ingest lap.mcap --vehicle car/vehicle.yaml --map car/map.yaml -o lap.parquet
      split train lap.parquet --vehicle car/vehicle.yaml -o car.split
      split evaluate lap2.parquet --vehicle car/vehicle.yaml --set car.split
      split export car.split --target c -o controller/

    \b
    Example, from a simulation and a real drive to the effect that the simulation lacks:
      split diagnose --real lap.parquet --sim twin.parquet --vehicle car.yaml --out diagnosis

    Results go to stdout, progress and notes to stderr. Exit codes: 0 success, 1 faulty input, 2 wrong usage,
    3 a check failed (--exit-code, --most). --quiet, --verbose and --legend may stand anywhere on the line.
    """
    from split_cli.cli.settings import default_options, settings_files
    from split_cli.cli.verbosity import Loud, Quiet

    if quiet and verbose:
        raise click.UsageError("--quiet and --verbose exclude each other.")
    context.obj = {"legend": legend}
    files = settings_files(config)
    if files:
        context.default_map = default_options(context.command, context, files)
        if not quiet:
            click.echo(f"split: note: options of {', '.join(map(str, files))}", err=True)
    if quiet or verbose:
        usual = sys.stderr
        sys.stderr = Quiet(usual) if quiet else Loud(usual)
        context.call_on_close(lambda: setattr(sys, "stderr", usual))


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; leave with 0, 1 (the input is at fault) or 2 (usage), never with a traceback."""
    # Matrices here are small: BLAS threads only wait for each other, and stall when other programs are busy.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("MKL_NUM_THREADS", "1")
    if "OMP_NUM_THREADS" in os.environ:
        # A list for nested loops is legal, and numexpr, which pandas loads, fails on it.
        outermost = os.environ["OMP_NUM_THREADS"].partition(",")[0]
        os.environ["OMP_NUM_THREADS"] = outermost if outermost.isdigit() else "1"
    warnings.showwarning = _show_warning
    warnings.simplefilter("always", NumericalRepairWarning)
    _open_closed_streams()
    show_only()
    stopped = _stop_cleanly()
    if CACHE_NOTE:
        click.echo(f"split: note: {CACHE_NOTE}", err=True)
    _refuse_undecodable(sys.argv[1:] if arguments is None else arguments)
    try:
        result = group.main(args=arguments, prog_name="split", standalone_mode=False)
        sys.stdout.flush()
    except SplitError as error:
        if stopped:  # what the interrupt broke was taken for a fault of the input
            _leave_stopped(stopped)
        _fail(str(error), 1)
    except click.exceptions.Abort:
        _leave_stopped(stopped)
    except click.MissingParameter as error:
        error.message = getattr(error.param, "help", None) or ""  # of the option: what it is
        error.show()
        sys.exit(2)
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except BrokenPipeError:
        _silence_stdout()  # a reader such as `head` went away
        sys.exit(1)
    except OSError as error:
        if os.environ.get("SPLIT_TRACEBACK"):
            raise
        _silence_stdout()
        _fail(f"{error.filename or 'reading or writing'}: {error.strerror or error}", 1)
    except MemoryError:
        _fail("not enough memory; try shorter recordings or fewer at once", 1)
    except Exception as error:
        if stopped:  # a library that was loading turned the interrupt into an error of its own
            _leave_stopped(stopped)
        if os.environ.get("SPLIT_TRACEBACK"):
            raise
        _fail(
            f"an error of this program, not of yours: {type(error).__name__}: {error}. "
            "Set SPLIT_TRACEBACK=1 and report what it prints",
            1,
        )
    sys.exit(result if isinstance(result, int) else 0)


class _Interrupt(KeyboardInterrupt):
    """Raised by a signal; unlike the exception of Python it can be watched."""


def _stop_cleanly() -> list[int]:
    """Let Ctrl-C and `kill` unwind, so that unfinished files are removed; the list holds what signal came.

    An interrupt may come where it is swallowed: in a library that catches everything while it loads or compiles,
    or where an object is taken down. Nobody holds the exception then any longer, and the signal comes once more.
    Where compiled code would take no notice of it, it comes later, too.
    """
    came: list[int] = []
    held: list[weakref.ref[_Interrupt]] = []
    here = os.getpid()

    def stop(number: int, frame: FrameType | None) -> None:
        if os.getpid() != here:  # a worker process has nothing to tidy: its parent does
            os._exit(128 + number)
        came.append(number)
        if postponed_by_compiled_code(number, frame):
            return
        interrupt = _Interrupt()
        held[:] = [weakref.ref(interrupt, lambda _: send_again(number))]
        try:
            raise interrupt
        finally:
            del interrupt  # this frame belongs to the traceback: the exception would hold itself

    usual = sys.unraisablehook

    def silent(unraisable) -> None:
        if not isinstance(unraisable.exc_value, _Interrupt):
            usual(unraisable)

    sys.unraisablehook = silent
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, stop)
        for name in ("SIGINT", "SIGHUP"):  # the second, as a terminal is closed, is not known to Windows
            number = getattr(signal, name, None)
            if number and signal.getsignal(number) != signal.SIG_IGN:  # in the background of a shell, after nohup
                signal.signal(number, stop)
    return came


def _open_closed_streams() -> None:
    """Give a run whose stdout or stderr is closed one that goes nowhere."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8"))


def _silence_stdout() -> None:
    """Point stdout elsewhere, so that what is left in its buffer makes no noise at the exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(text: str, code: int) -> None:
    line = " ".join(text.split())
    click.echo(f"split: {line}", err=True)
    sys.exit(code)


def _leave_stopped(came: list[int]) -> None:
    """Leave with 130 once all is unwound; at once where a signal `came`.

    What the signal left half made (a module, an object of a library) would make noise as it is taken down, and
    an interrupt inside an `exec` of a library makes Python itself end by SIGINT, whatever code it was told.
    """
    if not came:
        _fail(_STOPPED, 130)
    with contextlib.suppress(OSError):  # of a terminal that was closed
        click.echo(f"split: {_STOPPED}", err=True)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    if "multiprocessing.util" in sys.modules:
        # Locks of worker processes that are still held here: Python's tracker would tell of each.
        with contextlib.suppress(Exception):
            sys.modules["multiprocessing.util"]._run_finalizers(0)
    os._exit(130)


def _refuse_undecodable(arguments: list[str]) -> None:
    """Refuse names that are no valid text: they could not be stored in a drive's or a set's provenance."""
    for argument in arguments:
        try:
            argument.encode("utf-8")
        except UnicodeEncodeError:
            try:
                name = os.fsencode(argument).decode("utf-8")
            except UnicodeError:
                _fail(f"the name {ascii(argument)} is not valid UTF-8. Rename the file", 1)
            problem = f"Python reads names as {sys.getfilesystemencoding()} here, so that {ascii(name)} is no text"
            _fail(f"{problem}. Set PYTHONUTF8=1", 1)


def _show_warning(message, category, filename, lineno, file=None, line=None) -> None:
    """Show our own warnings as one line each; leave out where in the source they arose.

    Those of libraries (an overflow, an empty slice) say nothing to a user, who sees their consequence in counts
    and errors; they are shown to whoever debugs.
    """
    if not issubclass(category, NumericalRepairWarning) and not os.environ.get("SPLIT_TRACEBACK"):
        return
    click.echo(f"split: warning: {message}", err=True)
