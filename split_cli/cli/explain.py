"""`split explain`: its options, and how its result is printed."""

import click

from split_cli.cli.options import json_option, print_json


@click.command("explain")
@click.argument("words", nargs=-1, metavar="[COMMAND | COLUMN]...")
@click.option("--man", is_flag=True, help="Print the manual page of all commands (roff) and exit.")
@json_option
def command(words, man, as_json) -> None:
    """Explain the columns of printed tables: all columns of one command, or one column in every table.

    \b
    Example:
      split explain evaluate
      split explain skill "in 95 %"
      split explain --man | man -l -
    """
    from split_cli.cli.columns import COLUMNS

    if man:
        from split_cli.cli.manual import manual_page

        click.echo(manual_page(), nl=False)
        return
    tables = [name for name in COLUMNS if name != "any"]
    meanings = _meanings(words or tables)
    if as_json:
        print_json([{"table": table, "column": column, "meaning": text} for table, column, text in meanings])
        return
    last = ""
    for table, column, text in meanings:
        if table != last:
            click.echo(f"{'' if not last else chr(10)}{'every table' if table == 'any' else f'split {table}'}")
            last = table
        click.echo(f"  {column:<18}  {text}")


def _meanings(words) -> list[tuple[str, str, str]]:
    """Return (table, column, meaning) for commands and columns."""
    from split_cli.cli.columns import COLUMNS
    from split_cli.errors import nearest_names

    meanings = []
    for word in words:
        if word in COLUMNS:
            meanings += [(word, column, text) for column, text in COLUMNS[word].items()]
            continue
        names = (word, f"rejected: {word}")  # a reason by itself, as files and JSON have it
        found = [(t, name, columns[name]) for t, columns in COLUMNS.items() for name in names if name in columns]
        if not found:
            known = [*COLUMNS, *(column for columns in COLUMNS.values() for column in columns)]
            advice = f"{nearest_names(word, known)} docs/glossary.md explains words of the reports."
            raise click.UsageError(f"no table and no column {word!r}. {advice}")
        meanings += found
    return meanings
