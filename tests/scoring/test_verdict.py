"""The verdict: ratios of errors with intervals that cover, and words that follow them."""

from dataclasses import replace

import numpy as np

from split_cli.scoring.verdict import (
    BlockErrors,
    comparisons_of,
    nominal_runs_away,
    number_blocks,
    runs_away,
    verdict,
    warnings_of,
)


def errors(factor, seed, blocks=20, each=30):
    """Errors of a nominal model with a common part a block, and of a corrected one `factor` times as large."""
    rng = np.random.default_rng(seed)
    block = np.repeat(np.arange(blocks), each)
    strength = rng.lognormal(0.0, 0.5, blocks)[block][:, None]
    nominal = strength * rng.normal(size=(len(block), 3))
    corrected = np.asarray(factor) * strength * rng.normal(size=(len(block), 3))
    return BlockErrors(0.5, corrected, nominal, 1.5 * strength * rng.normal(size=(len(block), 3)), block)


def test_the_intervals_hold_the_true_ratio_as_often_as_they_say():
    inside = [
        c.to_nominal[1] < 0.8 < c.to_nominal[2]
        for seed in range(60)
        for c in comparisons_of("bcm", "z2", [errors((0.8, 0.8, 0.8), seed)], seed)
    ]
    # 180 intervals of 95 %: within three standard deviations, less the bootstrap's known shortfall at 20 blocks.
    assert np.mean(inside) > 0.95 - 3.0 * np.sqrt(0.05 * 0.95 / 180) - 0.03


def test_ratios_pool_squares_over_drives_and_two_drives_keep_their_blocks():
    one, two = errors((0.5, 1.0, 2.0), 1), errors((0.5, 1.0, 2.0), 2)
    two = BlockErrors(two.horizon, two.corrected, two.nominal, two.held, two.block + 20)
    found = comparisons_of("bcm", "z2", [one, two])
    assert all(c.blocks == 40 for c in found) and [c.state for c in found] == ["v_x", "v_y", "r"]
    pooled = np.sqrt(np.square(np.concatenate([one.corrected, two.corrected])).mean(axis=0))
    np.testing.assert_allclose([c.corrected for c in found], pooled, rtol=1e-12)


def test_the_words_name_what_helps_what_harms_and_what_changes_nothing():
    found = comparisons_of("bcm", "z2", [errors((0.5, 1.0, 2.0), 3)])
    said = verdict(found)
    assert said.startswith("verdict: the correction does harm: v_x better (0.")
    assert "v_y as the nominal model" in said and "r WORSE (" in said and "after 0.5 s" in said
    # Harm is said beside what to do, and what a running trust leaves of it.
    judged, way_out = said.rsplit(". ", 1)
    alone = "weigh what is worse against what is better, or use the vehicle file alone"
    assert judged.endswith(")") and way_out == f"On such driving {alone}"
    only_harm = comparisons_of("bcm", "z2", [errors((1.0, 1.0, 2.0), 3)])
    assert verdict(only_harm).endswith("). On such driving use the vehicle file alone")
    running = comparisons_of("bcm, running trust", "z2", [errors((0.5, 1.0, 1.0), 3)])
    instead = f"Without it {alone}"
    left = "With a running trust (NAME_observe in an export) no state is worse"
    assert verdict(found, running) == f"{judged}. {left}. {instead}"
    worst = [replace(c, to_nominal=(1.3, 1.2, 1.4)) if c.state == "v_y" else c for c in running]
    assert verdict(found, worst).endswith(f"v_y is 1.30 times as wrong at most. {instead}")
    assert verdict(running, worst) == verdict(running)  # where the stored trust does none, nothing is left to tell
    told = warnings_of(found)
    assert [line.split()[1] for line in told] == ["r", "r"]
    assert "the nominal model" in told[0] and "holding the velocities" in told[1]
    assert warnings_of([*found, *found])[0].count("after 0.5 s") == 1  # two predictors, one horizon
    assert verdict(comparisons_of("bcm", "z2", [errors((0.5, 0.5, 0.5), 4)])).startswith(
        "verdict: the correction helps"
    )


def test_what_counts_as_none_when_a_trust_is_found_is_told_but_is_no_harm():
    worse, *others = comparisons_of("bcm", "z2", [errors((2.0, 0.5, 1.0), 3)])
    for ratio, words, head in ((1.009, "v_x hardly worse (1.01 times", "helps"), (1.011, "v_x WORSE", "does harm")):
        one = replace(worse, to_nominal=(ratio, ratio - 1e-3, ratio + 1e-3))
        said = verdict([one, *others])
        assert words in said and said.startswith(f"verdict: the correction {head}")
        # An error larger by less than a per cent is in the verdict; a warning would cry wolf.
        warned = any("worse than the nominal model" in line for line in warnings_of([one]))
        assert warned is (ratio > 1.01)
    nearly = warnings_of([replace(worse, to_held=(1.001, 1.0005, 1.002))])[-1]
    assert "at most 1.001 times its error (95 % interval 1.0005 to 1.002" in nearly
    hardly = replace(worse, to_nominal=(1.001, 1.0005, 1.002))
    assert "hardly anything" in verdict([hardly])
    # What a state loses at one horizon hides no gain at another.
    said = verdict([hardly, replace(others[0], state=worse.state, horizon=2.0)])
    assert said.startswith("verdict: the correction helps: v_x better (0.5") and "hardly worse (1.001 times" in said


def test_what_no_decimal_shows_is_no_warning():
    """A trust of 0.05 made an error larger by 0.002 % beyond chance: a warning beside "as the nominal model"."""
    one = comparisons_of("bcm", "z2", [errors((2.0, 0.5, 1.0), 3)])[0]
    unseen = replace(one, to_nominal=(1.00002, 1.00001, 1.00003), to_held=(0.9, 0.8, 0.95))
    assert "v_x as the nominal model" in verdict([unseen]) and warnings_of([unseen]) == ()
    beside_held = replace(unseen, to_held=(1.00002, 1.00001, 1.00003))
    assert warnings_of([beside_held]) == ()
    seen = replace(unseen, to_nominal=(1.06, 1.01, 1.09), to_held=(1.5, 1.4, 1.6))
    assert len(warnings_of([seen])) == 2


def rolled(growth, horizons=(0.5, 1.0, 2.0)):
    """Comparisons of an open-loop model whose error of v_y is `growth` of the time times 3 of velocities held."""
    rng = np.random.default_rng(8)
    block = np.repeat(np.arange(20), 30)
    held = 0.1 * rng.normal(size=(len(block), 3))
    parts = []
    for horizon in horizons:
        ours = 0.5 * held
        ours[:, 1] = growth(horizon) * 3.0 * held[:, 1]
        parts.append(BlockErrors(horizon, ours, 1.1 * ours, held, block))
    return comparisons_of("bcm", "z2", parts)


def test_a_model_that_spins_runs_away_and_one_with_an_offset_does_not():
    """An unstable model's error grows with e^(t/tau); an offset stays, and a constant force's error grows with t."""
    spinning = runs_away(rolled(lambda t: np.exp(t / 0.4)))
    assert [(c.state, c.horizon) for c in spinning] == [("v_y", 2.0)] and nominal_runs_away(spinning)
    assert runs_away(rolled(lambda t: 1.0)) == () and runs_away(rolled(lambda t: t)) == ()
    # As near as velocities held: no reason to speak, however fast it grows.
    assert runs_away(rolled(lambda t: np.exp((t - 2.0) / 0.4) / 3.0)) == ()
    assert runs_away(rolled(np.exp, horizons=(2.0,))) == ()
    first, *_ = warnings_of(rolled(lambda t: np.exp(t / 0.4)))
    assert first.startswith(
        "WARNING: the corrected model (bcm) runs away, as in a spin: after 2 s its error of v_y is "
    )
    assert first.endswith("; the nominal model does so too")


def test_with_too_few_blocks_nothing_is_claimed():
    found = comparisons_of("bcm", "z2", [errors((5.0, 5.0, 5.0), 5, blocks=3)])
    assert "too few blocks" in verdict(found) and warnings_of(found) == ()


def test_blocks_are_whole_stretches_of_at_least_four_seconds_of_driving():
    time = np.concatenate([np.arange(0.0, 50.0, 0.01), 1000.0 + np.arange(0.0, 50.0, 0.01)])
    segment = np.repeat([0, 1], 5000)
    block = number_blocks(time, segment, first=7)
    assert block[0] == 7 and np.all(np.diff(block) >= 0)
    assert np.min(np.bincount(block - 7)) * 0.01 >= 3.99


def test_a_ratio_near_one_is_told_from_one():
    from split_cli.scoring.verdict import _span

    told = {(0.8512,): "0.85", (1.0031, 1.0042): "1.003 to 1.004", (0.99996,): "0.99996", (1.0,): "1.00"}
    told[0.36, 0.99996] = "0.36 to 1.00"
    assert {ratios: _span(ratios) for ratios in told} == told


def test_a_change_that_no_printed_digit_shows_is_none():
    """With a trust of 0.1 an error grew by 0.003 %, beyond chance: "hardly worse (1.00003 times)"."""
    one, *_ = comparisons_of("bcm", "z2", [errors((1.0, 1.0, 1.0), 3)])
    for ratio, words in ((1.00003, "as the nominal"), (0.99997, "as the nominal"), (0.998, "better (0.998 times")):
        said = verdict([replace(one, to_nominal=(ratio, ratio - 1e-6, ratio + 1e-6))])
        assert f"v_x {words}" in said, said
