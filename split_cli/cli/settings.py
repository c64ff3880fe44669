"""Default options from files: `split.yaml` in the current folder, one named by --config, or the user's own."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from split_cli.errors import SplitError, nearest_names

#: In the folder one works in.
LOCAL = "split.yaml"


def settings_files(named: str | None = None) -> list[Path]:
    """Return the files that are read, the weakest first: the user's, the folder's, the one named.

    One that is named (by ``--config`` or ``SPLIT_CONFIG``) must exist; the others are read where they are.
    """
    home = os.environ.get("XDG_CONFIG_HOME") or os.path.join(os.path.expanduser("~"), ".config")
    usual = [Path(home) / "split" / LOCAL, Path(LOCAL)]
    found = [path for path in usual if path.is_file()]
    named = named or os.environ.get("SPLIT_CONFIG")
    return [*found, Path(named)] if named else found


def default_options(group: click.Group, context: click.Context, files: list[Path]) -> dict[str, dict[str, Any]]:
    """Return defaults for every command, as click's `default_map`.

    Parameters
    ----------
    context : Context
        Of the group.
    files : list of Path
        The weakest first; a later one's options replace an earlier one's, option by option.

    Raises
    ------
    SplitError
        If a file is no mapping of commands to options, or names a command or option that there is not.
    """
    merged: dict[str, dict[str, Any]] = {}
    for path in files:
        for name, options in _read(path).items():
            if name != "all" and group.get_command(context, name) is None:
                raise SplitError(
                    f"no command {name!r}",
                    where=str(path),
                    advice=nearest_names(name, [*group.list_commands(context), "all"]),
                )
            if not isinstance(options, Mapping):
                advice = f"Write {name}: {{option: value}}."
                raise SplitError(f"{name} holds no options", where=str(path), advice=advice)
            commands = group.list_commands(context) if name == "all" else [name]
            anywhere = {word: None for one in commands for word in _words(group.get_command(context, one))}
            for option in options:
                if option not in anywhere:
                    what = "no command has an option" if name == "all" else f"{name} has no option"
                    advice = nearest_names(str(option), list(anywhere))
                    raise SplitError(f"{what} {option!r}", where=str(path), advice=advice)
            for command in commands:
                own = _by_parameter(group.get_command(context, command), options, path, name)
                merged.setdefault(command, {}).update(own)
    return merged


def _read(path: Path) -> Mapping[str, Any]:
    from split_cli.yaml_file import read_yaml_mapping

    return {
        # YAML takes `on` without quotes for true.
        str(name): {"on" if option is True else option: value for option, value in options.items()}
        if isinstance(options, Mapping)
        else options
        for name, options in read_yaml_mapping(path, SplitError).items()
    }


def _words(command: click.Command) -> dict[str, click.Option]:
    """Return the options of a command as on the command line, without dashes."""
    return {
        word.lstrip("-"): parameter
        for parameter in command.params
        if isinstance(parameter, click.Option)
        for word in (*parameter.opts, *parameter.secondary_opts)
    }


def _by_parameter(command: click.Command, options: Mapping[str, Any], path: Path, name: str) -> dict[str, Any]:
    """Return the options that a command has, named as on the command line, by the names of their parameters."""
    known = _words(command)
    out = {}
    for option, value in options.items():
        if option not in known:
            continue  # of `all`: an option that other commands have
        values = value if isinstance(value, list) else [value]
        if not all(isinstance(one, str | int | float) for one in values):
            what = f"{name}: {option} is {value!r}, a value or a list of values was expected"
            raise SplitError(what, where=str(path))
        parameter = known[option]
        if parameter.multiple and not isinstance(value, list):
            value = [value]
        if not parameter.multiple and isinstance(value, list):
            value = ",".join(map(str, value))
        out[parameter.name] = [str(one) for one in value] if parameter.multiple else value
    return out
