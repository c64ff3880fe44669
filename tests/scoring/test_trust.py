"""Trust found on held-out blocks: a true correction is kept, chance is not believed, and harm is refused."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.learning.cells import empty_set
from split_cli.learning.features import Z2
from split_cli.learning.hyperparameters import default_kernel, scatter_variance
from split_cli.learning.kernel import Kernel
from split_cli.learning.labels import compute_labels
from split_cli.learning.region import z2_grid
from split_cli.logs.drive_metadata import OF_REAR_TIRES, WITHOUT_GYRO
from split_cli.scoring.evidence import TrainingDrive, TrustEvidence, held_out_evidence, held_out_whole
from split_cli.scoring.trust import (
    best_trust,
    doubt_from,
    driving_needed,
    harmless_shares,
    judge_correction,
    own_shares,
)
from split_cli.vehicle.effects import CATALOGUE
from tests.factories import MissingForce, make_drive, road_car

BLOCKS, EACH = 20, 100


def evidence(truth, harm=0.0, seed=0, noise=1.0):
    """TrustEvidence of three states whose corrections d explain `truth` d; at a third of the speeds -`harm` d."""
    rng, parts = np.random.default_rng(seed), []
    block = np.repeat(np.arange(BLOCKS), EACH)
    conditions = rng.random((len(block), 7))
    conditions[:, -1] = 0.0
    slow = conditions[:, 2] < 1 / 3
    for state, share in enumerate(truth):
        learned = rng.normal(size=len(block))
        believed = np.where(slow & (state == 0) & (harm > 0.0), -harm, share)
        change = np.zeros((len(block), 3))
        change[:, state] = learned
        error = believed * learned + noise * rng.normal(size=len(block))
        parts.append(TrustEvidence(state, 0.0, error, change, np.zeros(len(block)), block, conditions))
    return parts


def test_the_share_that_the_held_out_errors_ask_for_is_found():
    # The estimate of a share has the standard error 1/sqrt(2000) = 0.02, and the grid 0.05.
    np.testing.assert_allclose(best_trust(evidence((1.0, 0.6, 0.3)))[0], (1.0, 0.6, 0.3), atol=0.1)


def test_gains_within_chance_are_not_believed():
    """Nothing to be learned, six times: each time a spurious share of 0.02 deviation either way is there."""
    given = np.array([best_trust(evidence((0.0, 0.0, 0.0), seed=seed))[0] for seed in range(6)])
    # A one-sided level of 95 % lets 1 of 20 shares through, and then no further than the grid's first step.
    assert (given > 0.0).sum() <= 3 and given.max() <= 0.05


def test_the_driving_that_is_needed_is_what_then_shows_a_gain():
    """Half of the correction of v_y is right in the mean over blocks, and scatters by twice that between them."""
    rng, each = np.random.default_rng(3), 20

    def drives(blocks: int) -> list[TrustEvidence]:
        block, parts = np.repeat(np.arange(blocks), each), []
        for state in range(3):
            change = np.zeros((len(block), 3))
            change[:, state] = rng.normal(size=len(block))
            by_block = rng.normal(0.5, 1.0, blocks)[block]
            error = by_block * change[:, state] * (state == 1) + rng.normal(size=len(block))
            still, anywhere = np.zeros(len(block)), np.zeros((len(block), 7))
            parts.append(TrustEvidence(state, 0.0, error, change, still, block, anywhere))
        return parts

    few = [one for one in (drives(6) for _ in range(20)) if not best_trust(one)[0].any()]
    needed = [n for n in map(driving_needed, few) if n is not None]
    shown = [best_trust(drives(6 * n))[0].any() for n in needed]
    # As likely as not the gain that six blocks show is larger than the true one, and then asks for too little.
    assert len(few) >= 5 and len(needed) >= 4 and np.mean(shown) >= 0.5
    # Nothing is learned from what harms: more of it would not show a gain either.
    assert driving_needed([replace(part, change=-part.change) for part in evidence((1.0, 1.0, 1.0))]) is None


def test_a_correction_that_harms_a_third_of_the_driving_is_refused_though_it_gains_on_the_whole():
    assert best_trust(evidence((1.0, 1.0, 1.0)))[0][0] > 0.9
    refused, _ = best_trust(evidence((1.0, 1.0, 1.0), harm=0.8))
    assert refused[0] <= 0.2 and refused[1] > 0.9 and refused[2] > 0.9


def test_the_doubt_is_the_variance_that_the_process_and_the_noise_do_not_explain():
    rng, count = np.random.default_rng(7), 20_000
    block, variance = np.arange(count) % BLOCKS, rng.uniform(0.05, 0.15, count)
    noise, doubt, share = np.array([0.1, 0.1, 0.1]), np.array([0.5, 0.0, 0.2]), np.array([0.5, 1.0, 0.0])
    kernel = Kernel(np.ones(3), np.ones(3), noise)
    kept = np.maximum(share**2, 1.0 - doubt)
    parts = []
    for state in range(3):
        change = np.zeros((count, 3))
        change[:, state] = rng.normal(size=count)
        spread = np.sqrt(kept[state] * variance + noise[state] + doubt[state])
        error = share[state] * change[:, state] + spread * rng.normal(size=count)
        rest = (np.zeros(count), block, np.zeros((count, 7)), variance)
        parts.append(TrustEvidence(state, 0.0, error, change, *rest))
    # A variance from 20,000 normal samples is known to 1 %; the tried ones are 14 % apart.
    np.testing.assert_allclose(doubt_from(parts, share, kernel), doubt, atol=0.05)


def asked_of(*drives):
    """Drives with labels, and the empty set that they ask for."""
    car = road_car()
    labels = [compute_labels(drive, car, Z2) for drive in drives]
    first = labels[0]
    grid = z2_grid(car, first.region)
    kernel = default_kernel(grid, first.y[first.accepted], scatter_variance(first))
    empty = empty_set(car, Z2, first.region, grid, kernel, horizon=first.horizon)
    return [TrainingDrive(drive, its) for drive, its in zip(drives, labels, strict=True)], empty


def trust_of(drive):
    return judge_correction(*asked_of(drive))[0]


def test_on_a_drive_a_missing_force_is_trusted_and_noise_is_not():
    missing = make_drive(0, segments=24, terms=[MissingForce({"front_lateral": 600.0})])
    found = trust_of(missing)
    assert found.origin == "held-out" and found.blocks >= 20
    # The least-squares share of this thin set is 0.85; less its uncertainty remains.
    assert min(found.share[1:]) >= 0.6
    plain = make_drive(1, segments=24)
    rng = np.random.default_rng(2)
    noisy = {
        name: plain[name] + scale * rng.normal(size=len(plain))
        for name, scale in (("vx", 0.02), ("vy", 0.02), ("r", 0.003))
    }
    plain = type(plain)(plain.name, {**plain.columns, **noisy}, plain.segment, plain.period)
    assert max(trust_of(plain).share) <= 0.1


@pytest.mark.parametrize(
    ("kinds", "state"),
    [
        ({"T": "derived: torque from measured a_x by the nominal model of test car"}, 0),
        ({"vy": f"derived: r and v_y {WITHOUT_GYRO} {OF_REAR_TIRES}"}, 1),
    ],
)
def test_a_state_of_which_no_drive_says_anything_is_not_corrected(kinds, state):
    """The force acts on v_y and r alone, and v_x has one of its own: all three are trusted of a measured drive."""
    terms = [MissingForce({"front_lateral": 600.0}), CATALOGUE["rolling_resistance"]({"force": 900.0})]
    drives, empty = asked_of(make_drive(0, segments=12, terms=terms))
    metadata = replace(drives[0].drive.metadata, kinds=kinds)
    derived = [replace(drives[0], drive=replace(drives[0].drive, metadata=metadata))]
    shares = [judge_correction(one, empty).trust.array for one in (drives, derived)]
    others = np.arange(3) != state
    assert shares[0][state] > 0.5 and shares[1][state] == 0.0 and shares[1][others].max() > 0.5


def test_of_three_drives_each_is_held_out_whole():
    """One drive of three has an offset of its own, which no other shows: its held-out errors keep all of it.

    With two drives the rest of the drive itself has told the offset, and most of it is corrected.
    """
    heights = {3: 0.0, 2: 0.0}
    offset = 900.0
    made = [
        make_drive(seed, segments=6, terms=[MissingForce({"front_lateral": offset})] if not seed else [])
        for seed in range(3)
    ]
    for count in heights:
        drives, empty = asked_of(*made[:count])
        evidence, _ = held_out_evidence(drives, empty)
        step = next(part for part in evidence if part.state == 1 and part.horizon == 0.0)
        odd = step.conditions[:, -1] == 0.0
        left = step.error[odd] - step.change[odd, 1]
        heights[count] = float(np.mean(left) / np.mean(step.error[odd]))
    assert heights[3] > 0.95 and heights[2] < 0.8


def test_drives_too_short_for_a_block_leave_the_folds_of_the_long_one():
    """A drive is judged as without two stops beside it, in which the car is too slow to be learned from."""
    drives, empty = asked_of(make_drive(0, segments=6), *(make_drive(seed, segments=1) for seed in (1, 2)))
    stops = [TrainingDrive(part.drive, part.labels.take(slice(0, 0))) for part in drives[1:]]
    (alone, blocks), (beside, same) = (held_out_evidence(given, empty) for given in (drives[:1], [*stops, *drives[:1]]))
    assert blocks == same >= 5 and not held_out_whole([*stops, *drives[:1]]) and held_out_whole(drives) == 3
    for one, other in zip(alone, beside, strict=True):
        np.testing.assert_array_equal(one.change, other.change)


def test_what_a_rival_explains_as_well_is_not_credited_to_the_correction():
    """A correction that goes with a late torque: the regression on both gives each its own coefficient."""
    rng, count = np.random.default_rng(5), 4000
    block, rival = np.arange(count) % BLOCKS, rng.normal(size=count)
    change = np.zeros((count, 3))
    change[:, 0] = rival + rng.normal(size=count)  # half of its variance stands in for the rival
    error = 0.3 * change[:, 0] + 0.7 * rival + 0.2 * rng.normal(size=count)
    rest = (np.zeros(count), block, np.zeros((count, 7)), None)
    alone = TrustEvidence(0, 0.0, error, change, *rest)
    beside = TrustEvidence(0, 0.0, error, change, *rest, rival[:, None])
    # Alone the coefficient is 0.3 + 0.7/2 in the limit; the standard error of 0.3 is 0.2/sqrt(4000) = 0.003.
    np.testing.assert_allclose(own_shares([beside]), (0.3, 1.0, 1.0), atol=0.02)
    assert best_trust([alone])[0][0] >= 0.6 and best_trust([beside])[0][0] <= 0.3 + 1e-9


def test_no_share_is_trusted_that_a_new_stretch_of_driving_does_not_bear():
    """Best shares of blocks with mean 0.6 and deviation s: up to 2 (0.6 - s), however many blocks there are."""
    rng, each = np.random.default_rng(6), 200

    def found(deviation: float, blocks: int) -> tuple[float, float]:
        block = np.repeat(np.arange(blocks), each)
        share = rng.permutation(0.6 + deviation * np.where(np.arange(blocks) % 2, 1.0, -1.0))[block]
        change = np.zeros((len(block), 3))
        change[:, 1] = rng.normal(size=len(block))
        error = share * change[:, 1] + 0.1 * rng.normal(size=len(block))
        part = TrustEvidence(1, 0.5, error, change, np.zeros(len(block)), block, np.zeros((len(block), 7)))
        return float(harmless_shares([part], np.zeros(3))[1]), float(best_trust([part])[0][1])

    # A share of 200 samples has the standard error 0.1/sqrt(200) = 0.007, and the prediction 1/(2 n) more of s.
    for blocks in (20, 80):
        most, trust = found(0.5, blocks)
        np.testing.assert_allclose(most, 0.2, atol=0.06)
        assert 0.1 <= trust <= most
    assert found(0.7, 40) == (0.0, 0.0)
    most, trust = found(0.1, 20)
    np.testing.assert_allclose((most, trust), (0.98, 0.6), atol=0.06)


def test_drives_of_a_few_seconds_are_judged_on_shorter_blocks_and_shorter_ones_not_at_all():
    """Five blocks of a second at least; what no held-out driving speaks for is not applied."""
    found = trust_of(make_drive(3, segments=1))
    assert found.origin == "unjudged" and found.share == (0.0, 0.0, 0.0) and "none is applied" in found.words()
    assert trust_of(make_drive(3, segments=8)).blocks >= 5
