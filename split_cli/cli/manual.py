"""The manual page of all commands, generated from the commands themselves."""

import click

from split_cli import __version__
from split_cli.cli.main import COMMANDS, group


def manual_page() -> str:
    """Return the manual page as roff: ``split explain --man > split.1``."""
    context = click.Context(group, info_name="split", **group.context_settings)
    parts = [
        f'.TH SPLIT 1 "" "split {__version__}" "User Commands"',
        ".SH NAME",
        "split \\- from driving logs to vehicle models a controller can trust",
        ".SH SYNOPSIS",
        ".B split",
        "[\\-\\-quiet] [\\-\\-verbose] [\\-\\-legend] [\\-\\-config FILE] COMMAND [ARGUMENT]...",
        ".SH DESCRIPTION",
        *_paragraphs(group.help or ""),
        ".SH COMMANDS",
    ]
    for name in group.list_commands(context):
        found = group.get_command(context, name)
        sub = click.Context(found, info_name=name, parent=context)
        usage = " ".join(found.collect_usage_pieces(sub))
        parts += [f".SS split {name} {_safe(usage)}", _safe(COMMANDS[name]), ".PP", *_paragraphs(found.help or "")]
        for parameter in found.get_params(sub):
            record = parameter.get_help_record(sub)
            if record:
                parts += [".TP", f".B {_safe(record[0])}", _safe(" ".join(record[1].split()))]
    parts += [".SH EXIT STATUS", "0 done, 1 the input is at fault, 2 usage, 3 a gate is shut (\\-\\-exit\\-code)."]
    return "\n".join(parts) + "\n"


def _paragraphs(text: str) -> list[str]:
    """Return help text as roff; blocks that keep their lines are set as they stand."""
    out = []
    for block in text.replace("\r", "").split("\n\n"):
        lines = [line for line in block.splitlines() if line.strip()]
        if lines and lines[0].strip() == "\b":
            out += [".nf", *(_safe(line) for line in lines[1:]), ".fi", ".PP"]
        elif lines:
            out += [_safe(" ".join(line.strip() for line in lines)), ".PP"]
    return out


def _safe(text: str) -> str:
    """Return a line that roff prints as it is."""
    safe = text.replace("\\", "\\e").replace("-", "\\-")
    return f"\\&{safe}" if safe[:1] in (".", "'") else safe
