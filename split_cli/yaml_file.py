"""Reading the YAML files users write, with errors that name the line. Imports only `errors`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from split_cli.errors import SplitError

__all__ = ["read_yaml_mapping"]


class _StrictLoader(yaml.SafeLoader):
    """YAML without the silent rule that the last of two equal keys wins."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        twice = next((key for key in keys if keys.count(key) > 1), None)
        if twice is not None:
            raise yaml.constructor.ConstructorError(None, None, f"the key {twice!r} stands twice", node.start_mark)
        return super().construct_mapping(node, deep)


# YAML 1.1 takes 1e3 and 1.5e3 for words, since they lack a dot or the sign of the exponent; people mean numbers.
_StrictLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)[eE][-+]?[0-9]+$"),
    list("-+.0123456789"),
)


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
        content = yaml.load(Path(path).read_text(encoding="utf-8"), Loader=_StrictLoader)
    except FileNotFoundError:
        raise error(missing, where=where, advice=advice) from None
    except OSError as problem:
        raise error(f"cannot be read ({problem.strerror or problem})", where=where) from problem
    except UnicodeDecodeError as problem:
        raise error("cannot be read (it is no text, YAML was expected)", where=where) from problem
    except RecursionError as problem:
        raise error("is nested too deeply", where=where, advice="See docs/formats.md.") from problem
    except yaml.YAMLError as problem:
        mark = getattr(problem, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        raise error(f"is not YAML ({getattr(problem, 'problem', problem)}{line})", where=where) from problem
    if not isinstance(content, dict):
        raise error("holds no keys", where=where, advice="See docs/formats.md.")
    return content
