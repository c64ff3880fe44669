"""Given hyperparameters, as a YAML file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.errors import SetError, nearest_names
from split_cli.learning.features import FeatureSet
from split_cli.learning.kernel import OUTPUTS, Kernel
from split_cli.learning.set_limits import LARGEST_OF_KERNEL
from split_cli.yaml_file import read_yaml_mapping

_KEYS = ("length_scales", "signal_variance", "noise_variance")


def read_kernel(path: str | Path, features: FeatureSet) -> Kernel:
    """Read hyperparameters: ``length_scales`` by feature, ``signal_variance`` and ``noise_variance`` by output.

    Raises
    ------
    SetError
        If the file is missing, not YAML, has unknown or missing keys, or values that are not positive.
    """
    where = str(path)
    advice = "Give fit, default, or a YAML file of hyperparameters."
    content = read_yaml_mapping(path, SetError, advice=advice)
    _check_keys(content, _KEYS, "hyperparameters", where)
    names = (features.names, OUTPUTS, OUTPUTS)
    scales, signal, noise = (
        np.array(_values(content[key], expected, key, where)) for key, expected in zip(_KEYS, names, strict=True)
    )
    return Kernel(scales, signal, noise, origin="given")


def _check_keys(content: Any, expected: Sequence[str], what: str, where: str) -> None:
    if not isinstance(content, dict):
        raise SetError(f"{what} must be a mapping with {', '.join(expected)}", where=where)
    for key in content:
        if key not in expected:
            raise SetError(f"unknown key {key!r} in {what}", where=where, advice=nearest_names(str(key), expected))
    for key in expected:
        if key not in content:
            raise SetError(f"{what} lacks {key}", where=where)


def _values(content: Any, expected: Sequence[str], key: str, where: str) -> list[float]:
    _check_keys(content, expected, key, where)
    values = []
    for name in expected:
        value = content[name]
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value <= LARGEST_OF_KERNEL:
            what = f"{key}.{name} is {value!r}, a positive number of at most {LARGEST_OF_KERNEL:g} was expected"
            raise SetError(what, where=where)
        values.append(float(value))
    return values
