"""split: driving logs in, vehicle models a controller can trust out.

Imports run one way: (cli, api) -> workflows -> (diagnosis, control, export, proof, plots) -> scoring ->
prediction -> learning -> logs -> vehicle -> (signals, files, yaml_file, errors). The plant, which makes test
recordings, stands beside vehicle; only proof and workflows import it.
"""

import importlib as _importlib
from os.path import dirname as _dirname
from typing import Any as _Any

from split_cli.compiled_code import provide_cache as _provide_cache

__version__ = "0.2.0"

# Before anything imports numba: it looks for a folder when it is imported, and fails where there is none.
CACHE_NOTE = _provide_cache(_dirname(__file__))

#: What `split_cli.api` offers, loaded when it is first used, so that `split --help` stays fast.
_API = (
    "DEG_PER_G",
    "charts",
    "compare",
    "diagnose",
    "draw_chart",
    "drive_table",
    "evaluate",
    "labels",
    "read_drive",
    "read_set",
    "read_vehicle",
    "rows_table",
    "steering_response",
    "train",
    "understeer",
)


def __getattr__(name: str) -> _Any:
    if name in _API:
        return getattr(_importlib.import_module("split_cli.api"), name)
    raise AttributeError(f"module 'split_cli' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_API})
