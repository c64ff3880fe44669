"""Sentences of the documentation and of every command's help are short enough to be understood at once."""

import re
from pathlib import Path

import click
import pytest

from split_cli.cli.main import group

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    *sorted(ROOT.glob("docs/**/*.md")),
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "sample_logs/README.md",
]
#: A sentence with more words than this is two.
MOST_WORDS = 25
#: Code is read as one word.
CODE = re.compile(r"`[^`]*`")
LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
END = re.compile(r"(?<=[.!?:;])[*\")]*\s+(?=\[|[*\"(]*[A-Z0-9])")


def paragraphs(text: str) -> list[str]:
    """Return what is prose in a page: no tables, headings, code, comments or quotations."""
    text = re.sub(r"<!--.*?-->", "", text, flags=re.S)
    text = re.sub(r"^```.*?^```$", "", text, flags=re.S | re.M)
    found: list[str] = []
    for block in re.split(r"\n\s*\n", text):
        if block.startswith("    ") and not re.match(r"\s*([-*]|\d+\.) ", block):
            continue
        lines: list[str] = []
        for line in block.splitlines():
            if re.match(r"\s*[|#>]", line):
                continue
            if re.match(r"\s*([-*]|\d+\.) ", line):
                found.append(" ".join(lines))
                lines = []
            lines.append(re.sub(r"^\s*([-*]|\d+\.) ", "", line.strip()))
        found.append(" ".join(lines))
    return [paragraph for paragraph in found if paragraph]


def long_sentences(text: str) -> list[str]:
    """Return the sentences of a paragraph with more than ``MOST_WORDS`` words, each with its count."""
    plain = LINK.sub(r"\1", CODE.sub("CODE", " ".join(text.split())))
    counted = ((len(re.findall(r"[^\W\d_][\w'’-]*", part)), part) for part in END.split(plain))
    return [f"{count} words: {part}" for count, part in counted if count > MOST_WORDS]


def helps() -> dict[str, list[str]]:
    """Return the paragraphs of help of every command, by its name."""
    context = click.Context(group, info_name="split")
    commands = {name: group.get_command(context, name) for name in group.list_commands(context)}
    return {name: [*_said(command)] for name, command in {"split": group, **commands}.items()}


def _said(command: click.Command):
    prose = re.sub(r"^\s*split .*$", "", click.unstyle(command.help or ""), flags=re.M)  # no commands
    yield from re.split(r"\n\s*\n|\b\n", prose)
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            yield parameter.help or ""
    if isinstance(command, click.Group) and command is not group:
        for inner in command.commands.values():
            yield from _said(inner)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_no_sentence_of_a_page_needs_a_second_reading(page):
    text = page.read_text(encoding="utf-8")
    long = [sentence for paragraph in paragraphs(text) for sentence in long_sentences(paragraph)]
    assert not long, f"{page.name}: make two sentences of each of these:\n" + "\n".join(long)


def test_no_sentence_of_help_needs_a_second_reading():
    long = [f"split {name}: {s}" for name, said in helps().items() for text in said for s in long_sentences(text)]
    assert len(helps()) > 10 and not long, "make two sentences of each of these:\n" + "\n".join(long)


def test_a_long_sentence_is_found_and_code_tables_and_lists_are_not_joined_to_it():
    words = "a car that " * 9 + "turns"  # 28 words
    assert long_sentences(f"{words}. A short one.") == [f"28 words: {words}."]
    page = f"# {words}\n\n| {words} |\n\n    {words}\n\n- {'one ' * 20}\n- {'two ' * 20}\n"
    assert [s for p in paragraphs(page) for s in long_sentences(p)] == []
