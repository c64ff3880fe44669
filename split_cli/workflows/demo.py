"""The whole path on the bundled samples: which commands, in which order, on which files."""

import json
import shlex
import sysconfig
from dataclasses import dataclass
from pathlib import Path

from split_cli.errors import SplitError
from split_cli.files import typed_path

TRAINING_LOG = "road_handling_moderate.mcap"
HELD_OUT_LOG = "road_handling_aggressive.mcap"
VEHICLE = "road_car.yaml"
REAL_LOG = "road_pair_real.parquet"
SIMULATED_LOG = "road_pair_sim.parquet"
DIAGNOSIS = "diagnosis"
_SAMPLES = (VEHICLE, TRAINING_LOG, HELD_OUT_LOG, REAL_LOG, SIMULATED_LOG)
INSTALLED = Path("share/split-cli/sample_logs")
"""In the prefix of an installation (pyproject.toml, data-files)."""


@dataclass(frozen=True)
class DemoStep:
    """One command of the demo."""

    title: str  # what it does, for the reader
    arguments: tuple[str, ...]  # as typed after ``split``

    @property
    def command(self) -> str:
        """The command as one would type it."""
        return "split " + shlex.join(self.arguments)


def find_samples(folder: str | Path | None = None) -> Path:
    """Return the folder of the sample logs: the one given, or ``sample_logs`` here, beside the package, installed.

    Raises
    ------
    SplitError
        If it is in none of these places.
    """
    beside_package = Path(__file__).resolve().parents[2] / "sample_logs"
    schemes = (sysconfig.get_default_scheme(), sysconfig.get_preferred_scheme("user"))
    installed = [Path(sysconfig.get_path("data", scheme)) / INSTALLED for scheme in schemes]
    candidates = [Path(folder)] if folder else [Path("sample_logs"), beside_package, *installed]
    for candidate in candidates:
        if all((candidate / name).is_file() for name in _SAMPLES):
            return candidate
    advice = "Install the program again, run the demo in a clone of it, or name the folder with --samples."
    raise SplitError("the sample logs are not here", where=str(candidates[0]), advice=advice)


def demo_steps(samples: Path, output: Path) -> tuple[DemoStep, ...]:
    """Return the commands of the demo, reading `samples` and writing into `output`."""
    vehicle = typed_path(samples / VEHICLE)
    drives = {log: typed_path(output / Path(log).with_suffix(".parquet").name) for log in (TRAINING_LOG, HELD_OUT_LOG)}
    trained = typed_path(output / "road_car.split")

    def ingest(log: str) -> tuple[str, ...]:
        return ("ingest", typed_path(samples / log), "--vehicle", vehicle, "--map", "split_sim", "-o", drives[log])

    return (
        DemoStep(
            "Read a recording: ROS 2 messages in MCAP, each channel with a rate and a clock of its own.",
            ingest(TRAINING_LOG),
        ),
        DemoStep("Read another one, which the training will not see.", ingest(HELD_OUT_LOG)),
        DemoStep(
            "Learn what the nominal model gets wrong.",
            ("train", drives[TRAINING_LOG], "--vehicle", vehicle, "-o", trained),
        ),
        DemoStep(
            "Score it on the recording it has not seen, beside persistence and the noise floor.",
            ("evaluate", drives[HELD_OUT_LOG], "--set", trained, "-o", typed_path(output / "figures")),
        ),
        DemoStep(
            "Write it as C99 and as a CasADi function, verified against Python.",
            ("export", trained, "--target", "c", "--target", "casadi", "-o", typed_path(output / "controller")),
        ),
        DemoStep("Ask what a file is.", ("info", trained)),
        DemoStep(
            "Another pair: a real drive and its simulation, which differ in one thing. Say what it is.",
            (
                "diagnose",
                "--real",
                typed_path(samples / REAL_LOG),
                "--sim",
                typed_path(samples / SIMULATED_LOG),
                "--vehicle",
                vehicle,
                "--held",
                "T,delta",
                "--out",
                typed_path(output / DIAGNOSIS),
            ),
        ),
    )


def closing_words(output: Path) -> str:
    """Return what the diagnosis said, what had been concealed, and where the report lies."""
    folder = output / DIAGNOSIS
    document = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    names = [finding["term"] for finding in document["findings"]] or ["nothing by name"]
    return (
        f"Verdict: {document['verdict']}; found: {', '.join(names)}. What had been put into that drive stands in "
        f"sample_logs/README.md.\nOpen the report: {(folder / 'report.html').resolve().as_uri()}"
    )
