"""Where the gap is: planted gaps of known dependence, place and noise."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.remainder.location import dependence, force_noise, gap_forces, locate
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import recorded

ROWS = 6000
BLOCK = np.arange(ROWS) // 40  # blocks of 1.6 s, rows of 0.04 s


def walk(seed: int, rows: int = ROWS) -> np.ndarray:
    """Return a variable that wanders over about a second, unit variance, as operating points do."""
    rng = np.random.default_rng(seed)
    x = np.convolve(rng.normal(size=rows + 60), np.hanning(50), "same")[:rows]
    return (x - x.mean()) / x.std()


def noise_of(seed: int) -> np.ndarray:
    """Return unit noise averaged over five rows, as gap forces are."""
    rng = np.random.default_rng(seed)
    white = rng.normal(size=(ROWS + 4, 3))
    total = np.cumsum(np.concatenate([np.zeros((1, 3)), white]), axis=0)
    return (total[5:] - total[:-5]) / np.sqrt(5.0)


def scores(gap: np.ndarray, *columns: np.ndarray) -> list[float]:
    return [dependence(x, gap, np.ones(3), BLOCK) for x in columns]


class TestDependence:
    # Sampling error: the variance of what says something new once a second is known, over these 240 s, to about
    # sqrt(2/240) = 9 %; scores are ratios of such numbers, so 0.1 is the tolerance where nothing else is said.
    # Steps in place of a smooth function miss a few per cent of it.

    @pytest.mark.parametrize("size", [0.3, 1.0, 5.0])
    def test_a_gap_of_one_variable_is_its_and_nothing_elses(self, size):
        x, other = walk(1), walk(2)
        gap = noise_of(3) + size * np.stack([np.tanh(2.0 * x), 0.5 * x**2, 0.0 * x], axis=1)
        own, foreign = scores(gap, x, other)
        # At 0.3 the gap holds a tenth of the noise's variance: how much is above noise is itself uncertain.
        assert own > (0.75 if size < 1.0 else 0.9)
        assert foreign < (0.25 if size < 1.0 else 0.1)

    def test_shares_of_two_variables_are_those_of_their_variances(self):
        a, b = walk(4), walk(5)
        gap = noise_of(6) + 3.0 * np.stack([np.sqrt(0.75) * a + np.sqrt(0.25) * b, 0.0 * a, 0.0 * a], axis=1)
        assert scores(gap, a, b) == pytest.approx([0.75, 0.25], abs=0.1)

    def test_a_product_of_two_variables_is_explained_by_neither(self):
        a, b = walk(7), walk(8)
        gap = noise_of(9) + 3.0 * np.stack([a * b, 0.0 * a, 0.0 * a], axis=1)
        assert max(scores(gap, a, b)) < 0.15

    def test_a_constant_gap_depends_on_nothing(self):
        gap = noise_of(10) + np.array([5.0, 0.0, 0.0])
        assert max(scores(gap, walk(11), walk(12))) < 0.15

    def test_noise_alone_depends_on_nothing(self):
        # Shares are of two standard errors of noise at least, and the best of three numbers of steps is taken.
        assert max(scores(noise_of(13), walk(14), np.arange(ROWS) / ROWS)) < 0.35

    def test_a_drift_goes_with_time_and_channels_are_weighed_by_noise(self):
        t = np.arange(ROWS) / ROWS
        x = walk(15)
        gap = noise_of(16) + np.stack([4.0 * t, 0.0 * t, 0.0 * t], axis=1)
        assert scores(gap, t, x) == pytest.approx([1.0, 0.0], abs=0.1)
        # The same in newtons of a car a thousand times as heavy, one channel with ten times the noise.
        newton = gap * 1e3 * np.array([1.0, 10.0, 1.0])
        heavy = dependence(t, newton, 1e6 * np.array([1.0, 100.0, 1.0]), BLOCK)
        assert heavy == pytest.approx(scores(gap, t)[0], abs=1e-9)


DRAG = CATALOGUE["aero_drag"]({"drag": 1.2})


@pytest.fixture(scope="module")
def plain() -> Evidence:
    return recorded(1)


def test_noise_of_gap_forces_is_what_sensor_noise_makes_of_them(plain):
    """A car that is its own simulation: the gap is noise, and its variance is the predicted one."""
    gap = gap_forces(plain, (), np.zeros_like(plain.series.measured))
    # Averages reach over 0.2 s; those that a run's start or end cuts are left out.
    inside = plain.at[np.minimum(plain.at % 401, 400 - plain.at % 401) > 10]
    told = force_noise(plain, inside)
    gap = gap[inside]
    # 400 independent averages of 0.2 s: 7 % of a variance in one standard error; noise itself is estimated, and
    # predicted states enter to second order.
    np.testing.assert_allclose(np.mean(gap**2, axis=0), told, rtol=0.25)


def test_drag_is_longitudinal_and_goes_with_speed():
    evidence = recorded(2, (DRAG,))
    keep = [np.ones(len(evidence.at), dtype=bool)]
    shared = np.zeros_like(evidence.series.measured)
    found = locate([evidence], [gap_forces(evidence, (), shared)], [gap_forces(evidence, (DRAG,), shared)], keep)
    assert found.forces["longitudinal"] > 0.9
    name, score = found.depends_on[0]
    assert name == "v_x" and score > 0.7
    low, high = found.region["v_x"]
    speed = evidence.series.measured[:, 0]
    assert high == pytest.approx(speed.max(), rel=0.02) and low > np.median(speed)


@pytest.mark.parametrize(("begin", "end"), [(200.0, 260.0), (980.0, 40.0)])
def test_a_patch_is_placed_also_across_the_start_of_the_lap(plain, begin, end):
    """Forces planted by hand on a stretch of a lap of 1,000 m that is driven twice."""
    s = np.linspace(0.0, 2000.0, len(plain.series)) % 1000.0
    evidence = replace(plain, series=replace(plain.series, s=s, lap_length=1000.0))
    inside = (s >= begin) & (s < end) if begin < end else (s >= begin) | (s < end)
    rng = np.random.default_rng(5)
    noise = rng.normal(0.0, 50.0, (len(s), 3))
    gap = noise + 900.0 * inside[:, None] * np.array([0.0, 1.0, 0.0])
    keep = [np.ones(len(evidence.at), dtype=bool)]
    found = locate([evidence], [gap], [noise], keep)
    # Rows are 0.04 s apart, 1 m here; a few rows of noise may be taken in.
    assert found.place.s_start == pytest.approx(begin, abs=5.0)
    assert found.place.s_end == pytest.approx(end, abs=5.0)
    assert found.share_of_samples == pytest.approx(0.06, abs=0.01) and found.share_of_gap > 0.9
    # Steps of 50 m cannot follow a stretch of 60 m exactly; the two passes are one place, not two times.
    assert dict(found.depends_on)["s"] > 0.25 and found.time is None
