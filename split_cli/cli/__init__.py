"""One file a command: parse, call one workflow, render. The only place that imports click.

May import: workflows, errors, signals; anything heavy inside the command's body, so that --help is instant.
"""

from split_cli.cli.main import main

__all__ = ["main"]
