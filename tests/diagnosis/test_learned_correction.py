"""SPLIT beside a model: trusted where it helps on time it has not seen, and nowhere else."""

import numpy as np

from split_cli.diagnosis.innovations.rollouts import Stage, roll_out_stages
from split_cli.diagnosis.verdict.label_errors import in_standard_errors, label_errors
from split_cli.diagnosis.verdict.learned_correction import learn_correction
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import recorded

RESISTANCE = CATALOGUE["rolling_resistance"]({"force": 450.0})


def learned(evidence):
    held = evidence.series.t > 0.75 * evidence.series.t[-1]
    part = label_errors(evidence, (), None, None, held)
    return learn_correction([(evidence, held)], [Stage((), None)], [part], [part.before]), held


def test_noise_alone_earns_no_trust():
    """A nominal car: what SPLIT learns is noise, and no output of it predicts the time left out."""
    correction, _ = learned(recorded(31))
    # Chance lets one output in six beyond one standard error; its regression is near nothing even then.
    assert correction is None or np.all(correction.trust < 0.2)


def test_a_force_that_is_missing_earns_trust_and_is_predicted():
    evidence = recorded(11, (RESISTANCE,))
    correction, held = learned(evidence)
    # A label's noise is twice the force; what is learned of it carries a part of that and is shrunk for it.
    assert 0.5 < correction.trust[0] <= 1.0
    errors = roll_out_stages(evidence, {"plain": Stage((), None), "rest": Stage((), None, correction)}, held)
    plain, with_correction = (np.sqrt(errors.squared[name][:, 2, 0].mean()) for name in ("plain", "rest"))
    assert with_correction < 0.7 * plain


def test_sums_in_standard_errors_by_hand():
    """Blocks that sum to 2 and 4: a sum of 6, an error of sqrt(2 (1 + 1)) = 2."""
    told = in_standard_errors(np.array([1.0, 1.0, 3.0, 1.0]), np.array([0, 0, 1, 1]))
    assert told == 6.0 / 2.0
