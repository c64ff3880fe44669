"""Track position on paths whose length is known."""

import numpy as np

from split_cli.logs.drive import Drive
from split_cli.logs.track_position import build_reference, places_of
from tests.factories import one_run


def circle(radius: float, speed: float, laps: float, seed: int, start: float = 0.0) -> Drive:
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, laps * 2 * np.pi * radius / speed, 0.01)
    angle = start + speed * t / radius
    n = len(t)
    columns = {
        "X": radius * np.sin(angle) + rng.normal(0, 0.02, n),
        "Y": radius * (1 - np.cos(angle)) + rng.normal(0, 0.02, n),
        "yaw": angle + rng.normal(0, 0.001, n),
        "vx": speed + rng.normal(0, 0.02, n),
        "vy": rng.normal(0, 0.02, n),
        "r": np.full(n, speed / radius),
    }
    return one_run(columns, 0.01, f"circle {seed}")


def test_a_closed_path_has_the_length_of_its_circle():
    reference = build_reference(circle(40.0, 12.0, 2.3, 1), 2.7)
    # Speed noise adds in quadrature to the arc: 0.02^2/(2 12^2) is nothing; the sample spacing is 0.12 m.
    assert abs(reference.lap_length - 2 * np.pi * 40.0) < 0.3


def test_laps_and_other_drives_are_projected_on_the_first_lap():
    first, other = circle(40.0, 12.0, 2.3, 1), circle(40.0, 9.0, 1.5, 2, start=1.0)
    places, lap = places_of([first, other], 2.7)
    assert [reference for _, reference in places] == ["position", "position"]
    for drive, (s, _), start in ((first, places[0], 0.0), (other, places[1], 1.0)):
        truth = np.mod(40.0 * start + drive["vx"].mean() * drive["t"], lap)
        error = np.mod(s - truth + lap / 2, lap) - lap / 2
        # Position noise of 0.02 m along the path, the nearest of points 0.12 m apart, and the lap's own 0.3 m.
        assert np.quantile(np.abs(error), 0.99) < 0.5


def test_without_position_places_are_dead_reckoned_and_have_no_lap():
    drive = circle(40.0, 12.0, 1.2, 3)
    columns = {name: drive[name] for name in ("t", "vx", "vy", "r", "T", "delta")}
    blind = Drive("blind", columns, drive.segment, drive.period)
    ((s, reference),), lap = places_of([blind], 2.7)
    assert reference == "dead_reckoned" and lap is None
    np.testing.assert_allclose(s[-1], 12.0 * drive["t"][-1], rtol=1e-3)


def test_an_open_path_keeps_its_own_arc_length():
    t = np.arange(0.0, 30.0, 0.01)
    zero = np.zeros(len(t))
    columns = {"X": 15.0 * t, "Y": zero, "yaw": zero, "vx": zero + 15.0}
    ((s, _),), lap = places_of([one_run(columns, 0.01, "road")], 2.7)
    assert lap is None
    np.testing.assert_allclose(s, 15.0 * t, atol=1e-9)


def test_a_drive_that_leaves_an_open_path_has_places_on_it_alone():
    t = np.arange(0.0, 20.0, 0.01)

    def straight(begin: float, speed: float) -> Drive:
        columns = {"X": begin + speed * t, "Y": 0.0 * t, "yaw": 0.0 * t, "vx": np.full(len(t), speed)}
        return one_run(columns, 0.01, "straight")

    # The first ten seconds lie before the path begins.
    (_, (s, reference)), lap = places_of([straight(0.0, 10.0), straight(-100.0, 10.0)], 2.7)
    assert reference == "position" and lap is None
    np.testing.assert_allclose(s, np.clip(10.0 * t - 100.0, 0.0, None), atol=3.0)
    assert s.min() == 0.0
