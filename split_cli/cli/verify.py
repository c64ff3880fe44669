"""`split verify`: its options, and how its result is printed."""

import click

from split_cli.cli.options import existing_file, json_option, print_json, print_table
from split_cli.errors import SplitError


@click.command("verify")
@click.argument("path", type=existing_file, metavar="FILE|FOLDER")
@json_option
def command(path, as_json) -> None:
    """Check the integrity of a file or folder that this program wrote.

    \b
    What is checked:
    - drive, labels: page checksums, ranges, clock, source files beside it, consistency of the channels
    - vehicle, map, hyperparameters: every key and value, and whether a vehicle was changed since it was written
    - trained set: digest, order, capacity, the cell of every point, and every marginal gain against the
      inverse of its cell's kernel matrix
    - labels and points of a set are computed again, if their drive (and vehicle file) lies beside them
    - export folder: the hash of every file, the set beside it, the self-test in C, and the stored queries
      of every other target
    - diagnosis folder: the digest of every file, its JSON document, the report and the vehicle file against it
    - folder of an evaluation or a comparison: the digest of every file, its page, the table against the page
    - folder of drives: each drive, and all of them against the manifest
    - any other folder: everything of the above in it, a line each; exports are only named, since their C would
      be compiled and run

    The exit code is 1 if a check fails.

    \b
    Example:
      split verify controller/
    """
    from split_cli.workflows.verifying.verify import verify

    result = verify(path)
    if as_json:
        print_json(result)
    else:
        words = {True: "passed", False: "FAILED", None: "not checked"}
        print_table(["check", "result", "detail"], [[i.check, words[i.passed], i.detail] for i in result.items])
    failed = [item.check for item in result.items if item.passed is False]
    if failed:
        what = f"fails {len(failed)} of {len(result.items)} checks: {'; '.join(failed)}"
        raise SplitError(what, where=result.path)
