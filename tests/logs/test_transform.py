"""Frames and places: against rigid-body motion, rotation matrices and the ellipsoid's radii."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from split_cli.logs.assembling import transform


def test_yaw_of_a_quaternion_is_the_azimuth_of_the_forward_axis_at_any_roll_and_pitch():
    rng = np.random.default_rng(0)
    yaw = rng.uniform(-np.pi, np.pi, 500)
    pitch, roll = rng.uniform(-1.2, 1.2, 500), rng.uniform(-3.0, 3.0, 500)
    rotation = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1))
    x, y, z, w = rotation.as_quat().T
    forward = rotation.apply([1.0, 0.0, 0.0])
    np.testing.assert_allclose(transform.yaw_from_quaternion(x, y, z, w), np.arctan2(forward[:, 1], forward[:, 0]))
    # -q is the same attitude, and a norm other than one (float32 logs) does not turn it.
    np.testing.assert_allclose(np.unwrap(transform.yaw_from_quaternion(-x, -y, -z, -w) - yaw), 0.0, atol=1e-12)
    np.testing.assert_allclose(transform.yaw_from_quaternion(3 * x, 3 * y, 3 * z, 3 * w), yaw, atol=1e-12)


def test_no_attitude_gives_nan():
    zero = np.zeros(1)
    assert np.isnan(transform.yaw_from_quaternion(zero, zero, zero, zero)).all()


def test_moving_to_the_cg_agrees_with_a_rigid_body():
    """The path of a point fixed to the car, differentiated, must give the CG's velocity and acceleration."""
    x, y = 1.7, -0.6
    t = np.linspace(0.0, 8.0, 80001)
    yaw = 0.4 * np.sin(0.8 * t) + 0.1 * t
    X, Y = 12.0 * t + np.sin(t), 3.0 * np.cos(0.5 * t)
    c, s = np.cos(yaw), np.sin(yaw)
    d = lambda v: np.gradient(v, t, edge_order=2)  # noqa: E731
    to_body = lambda a, b: (c * a + s * b, c * b - s * a)  # noqa: E731
    r = d(yaw)
    v_cg, a_cg = to_body(d(X), d(Y)), to_body(d(d(X)), d(d(Y)))
    pX, pY = X + c * x - s * y, Y + s * x + c * y
    v_point, a_point = to_body(d(pX), d(pY)), to_body(d(d(pX)), d(d(pY)))
    inside = slice(5, -5)
    moved = transform.velocity_at_cg(*v_point, r, x, y)
    for got, expected in zip(moved, v_cg, strict=True):
        np.testing.assert_allclose(got[inside], expected[inside], atol=1e-6)
    moved = transform.acceleration_at_cg(*a_point, r, d(r), x, y)
    for got, expected in zip(moved, a_cg, strict=True):
        np.testing.assert_allclose(got[inside], expected[inside], atol=1e-5)
    for got, expected in zip(transform.position_of_cg(pX, pY, yaw, x, y), (X, Y), strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-12)


@pytest.mark.parametrize("datum", [(35.05, -118.04), (-33.9, 151.2), (0.0, 0.0), (60.2, 179.9999)])
def test_a_small_step_in_the_local_plane_is_the_radius_of_curvature_times_the_angle(datum):
    a, e2 = 6378137.0, 6.69437999014e-3
    sine = np.sin(np.radians(datum[0]))
    meridian = a * (1 - e2) / (1 - e2 * sine**2) ** 1.5
    normal = a / np.sqrt(1 - e2 * sine**2)
    step = 1e-3  # deg, about 100 m
    latitude = np.array([datum[0], datum[0] + step, datum[0]])
    longitude = np.array([datum[1], datum[1], datum[1] + step])
    east, north = transform.local_tangent_plane(latitude, longitude, datum)
    # Over d = 100 m the plane leaves the ellipsoid by d^2/2a = 0.8 mm, and the parallel curves by as much.
    np.testing.assert_allclose(east, [0, 0, normal * np.cos(np.radians(datum[0])) * np.radians(step)], atol=2e-3)
    np.testing.assert_allclose(north, [0, meridian * np.radians(step), 0], atol=2e-3)


def test_north_east_down_to_east_north_up():
    assert transform.yaw_from_ned(np.array(0.0)) == pytest.approx(np.pi / 2)  # north
    assert transform.yaw_from_ned(np.array(np.pi / 2)) == pytest.approx(0.0)  # east
    assert [transform.frame_sign(c, "frd") for c in ("vx", "vy", "r", "ax", "ay", "delta", "T")] == [
        1,
        -1,
        -1,
        1,
        -1,
        -1,
        1,
    ]
    assert transform.frame_sign("r", "flu") == 1.0
