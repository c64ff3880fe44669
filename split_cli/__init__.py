"""split: driving logs in, vehicle models a controller can trust out.

Imports run one way: cli -> workflows -> (export, plots) -> scoring -> (prediction, learning) ->
(logs, vehicle) -> (signals, files, yaml_file, errors); plant stands beside vehicle.
"""

__version__ = "0.1.0"
