"""`split verify`."""

from __future__ import annotations

import click

from split_cli.cli.options import existing_file, json_option, print_json, print_table
from split_cli.errors import SplitError

__all__ = ["command"]


@click.command("verify")
@click.argument("path", type=existing_file, metavar="FILE|FOLDER")
@json_option
def command(path, as_json) -> None:
    """Check any file or folder of this program against itself.

    A drive or labels: checksums of the pages, ranges, clock, sources that lie beside it, and whether the channels
    fit together. A vehicle, a map, hyperparameters: every key and value. A set: its digest, order, capacity, that
    every point lies in its cell, and every marginal gain against the inverse of its cell's kernel matrix. The
    folder of an export: the hash of every file, the set beside it, then the self-test in C and the stored queries
    of every other target. A diagnosis: its document, the report against it, its vehicles. A folder of drives: each
    of them, and against the manifest. Exit code 1 when something fails.

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
        raise SplitError(
            f"fails {len(failed)} of {len(result.items)} checks: {'; '.join(failed)}", where=result.path
        )
