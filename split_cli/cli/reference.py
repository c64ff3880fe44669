"""The command reference, generated from the commands themselves: ``python -m split_cli.cli.reference``."""

import click

from split_cli.cli.main import COMMANDS, group


def command_reference() -> str:
    """Return docs/commands.md: the help of every command, in the order in which one uses them."""
    context = click.Context(group, info_name="split", **group.context_settings)
    names = group.list_commands(context)
    parts = [
        "# Commands",
        "",
        "This page lists every command and option, for those who know what they want to do. Others start with the",
        "[tutorial](tutorial.md).",
        "",
        "The commands generate this page (`python -m split_cli.cli.reference > docs/commands.md`), and a "
        "test compares both.",
        "",
        "Results go to stdout, progress and notes to stderr.",
        "Exit codes: 0 success, 1 faulty input, 2 wrong usage, 3 a check failed (`--exit-code`, `--most`).",
        "",
        *(f"- [`split {name}`](#split-{name}): {COMMANDS[name]}" for name in names),
    ]
    for name in names:
        command = group.get_command(context, name)
        sub = click.Context(command, info_name=name, parent=context, max_content_width=100, terminal_width=100)
        parts += ["", f"## split {name}", "", "```text", command.get_help(sub), "```"]
    return "\n".join(parts) + "\n"


if __name__ == "__main__":
    click.echo(command_reference(), nl=False)
