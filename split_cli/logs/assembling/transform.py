"""Frames, signs and places: vehicle and world frames to ISO 8855, sensors moved to the CG."""

import numpy as np

from split_cli.signals import find_unit

_FLIPPED_IN_FRD = frozenset({"vy", "r", "ay", "delta", "delta_command", "steering_wheel_angle", "sideslip"})

# WGS 84.
_EQUATORIAL_RADIUS = 6378137.0
_ECCENTRICITY_SQUARED = 6.69437999014e-3


def frame_sign(channel: str, frame: str) -> float:
    """Return -1.0 when `channel` turns its sign from x-forward y-right z-down (``frd``) to ISO 8855, else 1.0."""
    return -1.0 if frame == "frd" and channel in _FLIPPED_IN_FRD else 1.0


def yaw_from_ned(yaw: np.ndarray) -> np.ndarray:
    """Return yaw counter-clockwise from east [rad], shape of `yaw`, from yaw clockwise from north [rad]."""
    return 0.5 * np.pi - yaw


def yaw_from_quaternion(x: np.ndarray, y: np.ndarray, z: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Return the azimuth of the body's forward axis about the world's third axis [rad], shape (N,).

    Parameters
    ----------
    x, y, z, w : ndarray, shape (N,)
        Unit quaternion, body to world. A quaternion of zero norm (no attitude yet) gives NaN.

    Notes
    -----
    atan2(R_10, R_00): independent of roll and pitch conventions, since only the forward axis is asked for; the
    ratio does not depend on the norm.
    """
    norm = x * x + y * y + z * z + w * w
    yaw = np.arctan2(2.0 * (x * y + w * z), w * w + x * x - y * y - z * z)
    return np.where(norm > 1e-6, yaw, np.nan)


def signed(size: np.ndarray, negative: np.ndarray) -> np.ndarray:
    """Return sizes, negative where `negative` is above a half, shapes (N,); missing where either is."""
    return np.where(np.isfinite(negative), np.where(negative > 0.5, -size, size), np.nan)


def fix_in_degrees(values: np.ndarray, *units: str | None) -> np.ndarray:
    """Return a coordinate of a satellite fix in degrees, shape (N,): of the first unit that is one of angles."""
    known = (find_unit(unit) for unit in units if unit)
    unit = next((found for found in known if found is not None and found.si == "rad"), None)
    return values if unit is None or unit.symbol == "deg" else np.degrees(values * unit.factor)


def local_tangent_plane(
    latitude: np.ndarray, longitude: np.ndarray, datum: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return east and north [m], shapes (N,), of points on the WGS 84 ellipsoid in the plane touching at `datum`.

    Parameters
    ----------
    latitude, longitude : ndarray, shape (N,)
        [deg]; NaN stays NaN.
    datum : (float, float)
        Latitude and longitude [deg] of the origin.
    """

    def earth_centred(lat: np.ndarray, lon: np.ndarray) -> np.ndarray:
        normal = _EQUATORIAL_RADIUS / np.sqrt(1.0 - _ECCENTRICITY_SQUARED * np.sin(lat) ** 2)
        return np.stack(
            [
                normal * np.cos(lat) * np.cos(lon),
                normal * np.cos(lat) * np.sin(lon),
                normal * (1.0 - _ECCENTRICITY_SQUARED) * np.sin(lat),
            ]
        )

    lat0, lon0 = np.radians(datum[0]), np.radians(datum[1])
    lever = earth_centred(np.radians(latitude), np.radians(longitude))
    lever = lever - earth_centred(np.array(lat0), np.array(lon0)).reshape(3, 1)
    east = -np.sin(lon0) * lever[0] + np.cos(lon0) * lever[1]
    along_meridian = np.cos(lon0) * lever[0] + np.sin(lon0) * lever[1]
    north = -np.sin(lat0) * along_meridian + np.cos(lat0) * lever[2]
    return east, north


def velocity_at_cg(vx: np.ndarray, vy: np.ndarray, r: np.ndarray, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
    """Return v_x, v_y at the CG [m/s], shapes (N,), from those of a sensor at (x, y) [m] from the CG.

    v_cg = v_sensor - omega x p: v_x + r y, v_y - r x.
    """
    return vx + r * y, vy - r * x


def acceleration_at_cg(
    ax: np.ndarray, ay: np.ndarray, r: np.ndarray, yaw_acceleration: np.ndarray, x: float, y: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return a_x, a_y at the CG [m/s^2], shapes (N,), from those of a sensor at (x, y) [m] from the CG.

    a_cg = a_sensor - r' x p - omega x (omega x p): a_x + r' y + r^2 x, a_y - r' x + r^2 y.
    """
    return ax + yaw_acceleration * y + r * r * x, ay - yaw_acceleration * x + r * r * y


def position_of_cg(X: np.ndarray, Y: np.ndarray, yaw: np.ndarray, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
    """Return X, Y of the CG [m], shapes (N,), from those of an antenna at (x, y) [m] from the CG."""
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return X - cosine * x + sine * y, Y - sine * x - cosine * y
