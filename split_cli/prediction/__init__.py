"""Predictors behind one interface: mean, variance and Jacobian of the correction.

May import: learning, vehicle, signals, files, errors.
"""

import importlib
from typing import Any

from split_cli.errors import SplitError, nearest_names
from split_cli.learning.training_set import TrainingSet
from split_cli.prediction.predictor import Prediction, Predictor
from split_cli.prediction.trusted import TrustedPredictor

__all__ = ["DEFAULT_PREDICTOR", "PREDICTORS", "Prediction", "Predictor", "make_predictor", "refuse_unknown"]

#: The predictor that evaluates, compares and exports a set by default (docs/decisions/0030).
DEFAULT_PREDICTOR = "projected"

#: Name on the command line to module and class; a module is imported when its predictor is made.
PREDICTORS = {
    "full": ("split_cli.prediction.full", "FullPredictor"),
    "bcm": ("split_cli.prediction.bcm", "BcmPredictor"),
    "rbcm": ("split_cli.prediction.bcm", "RbcmPredictor"),
    "grbcm": ("split_cli.prediction.grbcm", "GrbcmPredictor"),
    "fitc": ("split_cli.prediction.fitc", "FitcPredictor"),
    "local": ("split_cli.prediction.local", "LocalPredictor"),
    "weights": ("split_cli.prediction.weights", "WeightsPredictor"),
    "table": ("split_cli.prediction.table", "TablePredictor"),
    "projected": ("split_cli.prediction.projected", "ProjectedPredictor"),
    "iol": ("split_cli.prediction.iol", "IolPredictor"),
}


def refuse_unknown(name: str) -> None:
    """Raise a `SplitError` where there is no predictor of this name; it names the nearest."""
    if name not in PREDICTORS:
        raise SplitError(f"no predictor {name!r}", advice=nearest_names(name, PREDICTORS))


def make_predictor(name: str, training_set: TrainingSet, **options: Any) -> Predictor:
    """Return the predictor called `name` over a trained set, as far as the set is trusted.

    Parameters
    ----------
    name : str
        A key of `PREDICTORS`.
    **options
        What the predictor's constructor takes beside the set.

    Raises
    ------
    SplitError
        As `refuse_unknown`.
    """
    refuse_unknown(name)
    module, attribute = PREDICTORS[name]
    predictor = getattr(importlib.import_module(module), attribute)(training_set, **options)
    return predictor if training_set.trust.is_full else TrustedPredictor(predictor)
