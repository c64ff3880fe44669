"""Names of features: single ones, sets and terms."""

import pytest

from split_cli.errors import DriveError
from split_cli.learning.features import Z1, Z2, parse_features
from split_cli.vehicle.parameters import EffectSpec
from split_cli.vehicle.single_track import SingleTrack
from tests.factories import make_drive, road_car


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("z2", Z2.names),
        ("Z1", Z1.names),
        ("z2,vx", (*Z2.names, "vx")),
        ("z2, feature_lag", (*Z2.names, "feature_lag.alpha_f", "feature_lag.alpha_r", "feature_lag.torque")),
        ("alpha_f,feature_lag.torque", ("alpha_f", "feature_lag.torque")),
        (("alpha_f", "z1"), ("alpha_f", *Z1.names)),
        ("mass", ("mass",)),  # a term without states is no feature: the drive has no such channel and says so
    ],
)
def test_lists_may_name_sets_and_terms(text, names):
    assert parse_features(text).names == names


def test_a_feature_counts_once():
    with pytest.raises(DriveError, match="alpha_f twice"):
        parse_features("z2,alpha_f")


def test_a_state_of_a_term_that_the_vehicle_lacks_is_told_so():
    features, drive = parse_features("z2,feature_lag"), make_drive()
    with pytest.raises(DriveError, match=r"term feature_lag, which .* lacks.*- term: feature_lag.*VALUE \[s\]"):
        features.compute(SingleTrack(road_car()), drive)
    lagged = SingleTrack(road_car().with_effects(EffectSpec("feature_lag", {"tau": 0.08})))
    assert features.compute(lagged, drive).shape == (len(drive), 6)
