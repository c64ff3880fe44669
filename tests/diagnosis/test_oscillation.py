"""Oscillators in the residuals: their responses, one that is planted, and errors that are spread over frequencies."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from split_cli.diagnosis.remainder.oscillation import FREQUENCIES, build_oscillators, oscillator_rows, swinging
from split_cli.diagnosis.remainder.structure import build_structure
from split_cli.vehicle.effects import Recording
from tests.diagnosis.recordings import INFLATION, bare_objective, driven, light_evidence, noisy, prepared


def test_a_response_spans_place_and_velocity_of_a_mass_on_a_spring():
    """The oracle integrates q'' + 2 d w q' + w^2 q = w^2 u with a step far below the sample period."""
    period, frequency, damping = 0.01, 0.7, 0.1
    t = period * np.arange(600)
    drive = np.sin(2.1 * t) + 0.3 * np.sin(9.0 * t)
    w = 2.0 * np.pi * frequency
    solved = solve_ivp(
        lambda at, q: [q[1], w * w * (np.interp(at, t, drive) - q[0]) - 2.0 * damping * w * q[1]],
        (0.0, t[-1]),
        [drive[0], 0.0],
        t_eval=t,
        max_step=period / 2,
        rtol=1e-9,
        atol=1e-10,
    )
    place, velocity = solved.y
    real, imaginary = swinging(Recording.single(period, len(t)), drive, frequency)
    root = np.sqrt(1.0 - damping**2)
    # y' = c (u - y) with c = w (d + i root): q = Re y - d/root Im y solves the equation of the oscillator.
    np.testing.assert_allclose(real + drive - damping / root * imaginary, place, atol=2e-6)
    # Its velocity is a sum of both, with nothing else.
    both = np.stack([real, imaginary], axis=1)
    np.testing.assert_allclose(both @ np.linalg.lstsq(both, velocity, rcond=None)[0], velocity, atol=2e-5)


def test_each_segment_begins_at_rest_and_a_constant_drive_moves_nothing():
    drive = np.concatenate([np.full(50, 2.0), np.linspace(-1.0, 1.0, 50)])
    recording = Recording(0.02, ((0, 50), (50, 100)))
    for response in swinging(recording, drive, 1.0):
        assert not response[:51].any() and response[-1] != 0.0
    alone = swinging(Recording.single(0.02, 50), drive[50:], 1.0)
    for whole, part in zip(swinging(recording, drive, 1.0), alone, strict=True):
        np.testing.assert_array_equal(whole[50:], part)


@pytest.fixture(scope="module")
def drive():
    """Forty seconds in one run: oscillators need time."""
    return driven(71, runs=1, seconds=40.0)


class TestPlanted:
    """A rate of v_y is added that follows v_x r in some way."""

    def evidence(self, drive, rate, seed: int):
        """Return evidence of a drive whose v_y changes by `rate` [m/s^2] more, with noise."""
        added = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))]) * drive.period
        moved = replace(drive, columns={**drive.columns, "vy": drive["vy"] + added})
        return light_evidence(prepared(noisy(moved, seed)))

    def least_likely(self, one):
        """Return p value and group of the oscillators in a recording."""
        objective = bare_objective(one)
        found = build_oscillators(objective, [oscillator_rows(one)], {})
        p_value, structure, _ = found.least_likely(objective.residual(()), INFLATION)
        return p_value, structure.groups[0]

    @pytest.mark.parametrize("k", [1, 3, 5])
    def test_a_mass_on_a_spring_is_found_at_its_frequency(self, drive, k):
        across = drive["vx"] * drive["r"]
        real, imaginary = swinging(Recording.single(drive.period, len(across)), across, FREQUENCIES[k])
        p_value, group = self.least_likely(self.evidence(drive, 0.05 * (0.6 * real - 0.8 * imaginary), seed=k))
        assert p_value < 1e-6
        # Neighbours overlap, and what is added to v_y the model takes for slip.
        near = FREQUENCIES[max(k - 1, 0) : k + 2]
        assert group in [f"swinging at {frequency:.2g} Hz" for frequency in near]

    def test_noise_alone_is_none(self, drive):
        nothing = np.zeros(len(drive["vx"]))
        p_values = [self.least_likely(self.evidence(drive, nothing, seed))[0] for seed in range(20, 32)]
        # One in twenty at most: of twelve, three or more would have a probability of 2 %.
        assert np.sum(np.array(p_values) < 0.05) < 3

    def test_an_error_that_is_spread_over_frequencies_is_none(self, drive):
        """A tyre that follows 20 ms late errs in proportion to the rate of v_x r. Oscillators alone would fit that."""
        one = self.evidence(drive, 0.02 * np.gradient(drive["vx"] * drive["r"], drive.period), seed=9)
        objective = bare_objective(one)
        alone = [build_structure(objective, [[piece]]) for piece in oscillator_rows(one).swings]
        assert min(fit.fit(objective.residual(()), INFLATION).p_value for fit in alone) < 1e-6
        assert self.least_likely(one)[0] > 0.05
