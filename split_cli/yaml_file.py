"""Reading the YAML files users write, with errors that name the line. Imports only `errors` and `files`."""

import re
from pathlib import Path
from typing import Any

import yaml

from split_cli.errors import SplitError
from split_cli.files import read_text

_MOST_BYTES = 4 << 20
"""Size of a YAML file [bytes]; judgement: the largest of ours has 20 kB."""
_MOST_VALUES = 100_000
"""Values of a file, also once its aliases are written out [1]; judgement: the longest map has 300."""
_MOST_DIGITS = 400
"""Digits of a number [1]; theory: no double has more than 309 before its point."""


class _StrictLoader(yaml.SafeLoader):
    """YAML without the silent rule that the last of two equal keys wins, and without bombs.

    An alias stands for all it names. Twenty lines of lists of aliases to lists of aliases stand for more values
    than a computer holds, so what a file amounts to is counted before anything is built of it.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._composed = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        self._composed += 1
        if self._composed > _MOST_VALUES:
            raise yaml.constructor.ConstructorError(
                None, None, f"more than {_MOST_VALUES} values", self.peek_event().start_mark
            )
        return super().compose_node(parent, index)

    def compose_document(self) -> yaml.Node:
        node = super().compose_document()
        _values_of(node, {}, set())
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        keys: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in keys:
                    said = f"the key {key.value!r} stands twice"
                    raise yaml.constructor.ConstructorError(None, None, said, node.start_mark)
                keys.add(key.value)
        return super().construct_mapping(node, deep)


def _values_of(node: yaml.Node, known: dict[int, int], above: set[int]) -> int:
    """Return how many values a node amounts to with its aliases written out.

    Raises
    ------
    ConstructorError
        If they are more than `_MOST_VALUES`, or the node contains itself.
    """
    if id(node) in above:
        raise yaml.constructor.ConstructorError(None, None, "an alias names what contains it", node.start_mark)
    if id(node) not in known:
        count = 1
        if isinstance(node, yaml.ScalarNode):
            if len(node.value) > _MOST_DIGITS and node.tag == _INTEGER:
                raise yaml.constructor.ConstructorError(
                    None, None, f"a number of {len(node.value)} digits", node.start_mark
                )
        else:
            above.add(id(node))
            for part in node.value:
                for inner in part if isinstance(part, tuple) else (part,):
                    count += _values_of(inner, known, above)
            above.discard(id(node))
        if count > _MOST_VALUES:
            raise yaml.constructor.ConstructorError(
                None, None, f"its aliases stand for more than {_MOST_VALUES} values", node.start_mark
            )
        known[id(node)] = count
    return known[id(node)]


# YAML 1.1 takes 1e3 for a word, 1:30 for 90 and 01500 for the octal 832; people mean 1000, no number, and 1500.
_INTEGER, _FLOAT = "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"
_StrictLoader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag not in (_INTEGER, _FLOAT)]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _tag, _pattern in (
    (_INTEGER, r"[-+]?(0|[1-9][0-9]*|0x[0-9a-fA-F]+)$"),
    (_FLOAT, r"([-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN))$"),
):
    _StrictLoader.add_implicit_resolver(_tag, re.compile(_pattern), list("-+.0123456789"))


def parse_yaml(text: str) -> Any:
    """Return the content of YAML text.

    Raises
    ------
    yaml.YAMLError
        If it is not YAML, holds a key twice, contains itself, or amounts to more values than any file of ours.
    RecursionError
        If it is nested too deeply.
    ValueError
        If a value, such as a date of the 31st of February, does not exist.
    """
    return yaml.load(text, Loader=_StrictLoader)


def read_yaml_mapping(
    path: str | Path, error: type[SplitError], *, missing: str = "no such file", advice: str | None = None
) -> dict[str, Any]:
    """Read a YAML file whose content is a mapping.

    Parameters
    ----------
    path : str or Path
    error : type
        What to raise.
    missing : str
        What to say when the file does not exist.
    advice : str, optional
        What the reader can do then.

    Raises
    ------
    SplitError
        Of the given type: the file is missing, unreadable, not YAML (with the line), holds a key twice, or is no
        mapping.
    """
    where = str(path)
    try:
        content = parse_yaml(read_text(path, _MOST_BYTES, error))
    except FileNotFoundError:
        raise error(missing, where=where, advice=advice) from None
    except OSError as problem:
        raise error(f"cannot be read ({problem.strerror or problem})", where=where) from problem
    except UnicodeDecodeError as problem:
        raise error("is no text in UTF-8, YAML was expected", where=where, advice="Save it as UTF-8.") from problem
    except RecursionError as problem:
        raise error("is nested too deeply", where=where, advice="See docs/formats.md.") from problem
    except (yaml.YAMLError, ValueError, OverflowError) as problem:
        mark = getattr(problem, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        raise error(f"is not YAML ({getattr(problem, 'problem', problem)}{line})", where=where) from problem
    if not isinstance(content, dict):
        raise error("holds no keys", where=where, advice=f"{advice} See docs/formats.md.".lstrip())
    return content
