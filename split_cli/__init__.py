"""split: driving logs in, vehicle models a controller can trust out.

Imports run one way: cli -> workflows -> (export, plots) -> scoring -> (prediction, learning) ->
(logs, vehicle) -> (signals, files, yaml_file, errors); plant stands beside vehicle.
"""

from os.path import dirname as _dirname

from split_cli.compiled_code import provide_cache as _provide_cache

__version__ = "0.1.0"

# Before anything imports numba: it looks for a folder when it is imported, and fails where there is none.
CACHE_NOTE = _provide_cache(_dirname(__file__))
