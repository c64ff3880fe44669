"""Every command is documented, quick to ask for help, and fails in one line."""

import subprocess
import sys
from pathlib import Path

import click
import pytest

from split_cli.cli.main import COMMANDS, group

ROOT = Path(__file__).resolve().parents[2]
NAMES = group.list_commands(click.Context(group))


def run(*arguments: str, **options) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "split_cli", *arguments], capture_output=True, text=True, timeout=120, **options
    )


def test_every_command_of_the_table_exists():
    assert list(COMMANDS) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_command_has_help_with_an_example_and_documents_every_option(name):
    command = group.get_command(click.Context(group), name)
    assert command.help and "Example" in command.help
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            assert parameter.help, f"split {name}: {parameter.opts} has no help"


def test_the_reference_in_the_docs_is_what_the_commands_say():
    # In a process of its own: click remembers how a command was asked for help the first time.
    generated = subprocess.run(
        [sys.executable, "-m", "split_cli.cli.reference"], capture_output=True, text=True, timeout=60, check=True
    )
    assert (ROOT / "docs" / "commands.md").read_text() == generated.stdout


def test_help_and_version_import_nothing_heavy():
    # The contract is --help under 0.3 s; what makes it slow is these imports, so they are what is tested.
    code = (
        f"names = {NAMES!r}\n"
        "import sys\n"
        "from split_cli.cli.main import group\n"
        "for arguments in (['--help'], ['--version'], *([name, '--help'] for name in names)):\n"
        "    group.main(args=arguments, standalone_mode=False)\n"
        "heavy = {'numpy', 'scipy', 'pandas', 'numba', 'pyarrow', 'casadi', 'matplotlib', 'mcap'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    finished = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert finished.returncode == 0, finished.stderr


@pytest.mark.parametrize("arguments", [("-b", "10M", "big.bin"), ("-",), ("pyproject.toml",), ("--bytes=1k",)])
def test_called_in_the_coreutils_way_it_says_so(arguments):
    finished = run(*arguments, cwd=ROOT)
    assert finished.returncode == 2
    assert "coreutils" in finished.stderr and "split-cli" in finished.stderr


def test_an_unknown_command_names_the_nearest():
    finished = run("trian")
    assert finished.returncode == 2
    assert "train" in finished.stderr


def test_an_input_error_is_one_line_and_exit_code_1(tmp_path):
    finished = run("info", str(tmp_path / "absent.parquet"))
    assert finished.returncode == 1
    assert finished.stdout == ""
    assert len(finished.stderr.strip().splitlines()) == 1
    assert "absent.parquet" in finished.stderr


def test_a_reader_that_goes_away_makes_no_noise():
    writer = subprocess.Popen(
        [sys.executable, "-m", "split_cli", "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    writer.stdout.close()
    assert b"Traceback" not in writer.stderr.read()
    writer.wait(30)


def test_a_former_name_of_an_option_still_works_and_no_help_shows_it():
    race = group.get_command(click.Context(group), "race")
    arguments = ["--vehicle", str(ROOT / "pyproject.toml"), "--told-grip", "0.5"]
    assert race.make_context("race", arguments).params["assumed_friction"] == 0.5
    assert "--told-grip" not in race.get_help(click.Context(race))
