"""How much of a strange effect no two terms of the catalogue can absorb: linear regression on what terms do."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from split_cli.proof.windows import errors_of_terms
from split_cli.signals import STANDARD_GRAVITY
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.parameters import Vehicle

_STRETCHES = 12


@dataclass(frozen=True)
class Library:
    """Regressors of a recording."""

    matrix: np.ndarray  # (3 K, C): a column a regressor, errors of v_x, v_y, r over the noise, window by window
    terms: tuple[str, ...]  # of the catalogue, to which a column belongs; a term may have several


def _small_terms(vehicle: Vehicle, lap_length: float) -> list[Term]:
    """Return a little of every term, several where one column does not say it."""
    load, size = STANDARD_GRAVITY * vehicle.mass, vehicle.wheelbase / 2.7
    speed = 20.0 * size**0.5
    lift = 0.03 * load / speed**2
    steps: dict[str, list[dict[str, float]]] = {
        "combined_slip": [{"strength": 0.3}],
        "friction_scale": [{"scale": 0.95}],
        "grip_fade": [{"final_loss": 0.05, "tau": tau} for tau in (20.0, 60.0)],
        "tire_relaxation": [{"length": 0.1 * size}],
        "load_transfer": [{"cg_height": 0.1 * vehicle.wheelbase}],
        "tire_stiffness": [{"front_scale": 0.97, "rear_scale": 1.0}, {"front_scale": 1.0, "rear_scale": 0.97}],
        "aero_downforce": [{"front": lift, "rear": 0.0}, {"front": 0.0, "rear": lift}],
        "aero_drag": [{"drag": 0.005 * load / speed**2}],
        "road_bank": [{"angle": 0.01}],
        "drive_gain": [{"drive_gain": 0.97, "brake_gain": 1.0}, {"drive_gain": 1.0, "brake_gain": 0.97}],
        "drive_lag": [{"tau": 0.03}],
        "drive_delay": [{"delay": 0.02}],
        "rolling_resistance": [{"force": 0.003 * load}],
        "yaw_moment_differential": [{"yaw_damping": 0.2 * vehicle.yaw_inertia}],
        "steer_offset": [{"offset": 0.002}],
        "steer_gain": [{"gain": 0.98}],
        "steer_delay": [{"delay": 0.01}],
        "steer_lag": [{"tau": 0.015}],
        "steer_backlash": [{"width": 0.01}],
        "mass": [{"scale": 1.03}],
        "yaw_inertia": [{"scale": 1.03}],
        "cg_shift": [{"dx": 0.01 * vehicle.wheelbase}],
        "sensor_lever_arm": [{"dx": 0.03 * vehicle.wheelbase}],
        "sensor_misalignment": [{"angle": 0.003}],
        "sensor_delay": [{"delay": 0.01}],
    }
    small = [CATALOGUE[term](parameters) for term, several in steps.items() for parameters in several]
    for wind in ({"wx": speed / 6, "wy": 0.0}, {"wx": 0.0, "wy": speed / 6}):
        small.append(CATALOGUE["wind"](wind, "side"))
    for term in ("road_grade", "road_bank"):
        for waves in (1, 2, 3):
            for phase in (0.0, 0.5 * np.pi):
                wave = {"amplitude": 0.01, "wavelength": lap_length / waves, "phase": phase}
                small.append(CATALOGUE[term](wave, "wave"))
    for start in np.arange(_STRETCHES) * lap_length / _STRETCHES:
        stretch = {"s_start": float(start), "s_end": float(start + 1.5 * lap_length / _STRETCHES) % lap_length}
        small.append(CATALOGUE["friction_patch"]({"scale": 0.9, **stretch}))
        for term in ("road_grade", "road_bank"):
            small.append(CATALOGUE[term]({"angle": 0.01, **stretch}, "stretch"))
    return small


def _large_terms(vehicle: Vehicle) -> list[Term]:
    """Return more of the terms whose effect is not proportional to it, and their variants.

    With them a regression can say of a large effect what a fit of the term itself would.
    """
    scales = [
        CATALOGUE["friction_scale"]({"scale": scale}, variant)
        for scale, variant in ((0.8, ""), (0.95, "curve"), (0.8, "curve"))
    ]
    fades = [
        CATALOGUE["grip_fade"]({"final_loss": loss, "tau": tau}, variant)
        for tau in (3.0, 20.0, 60.0)
        for variant in ("", "curve")
        for loss in (0.05, 0.2)
    ]
    stiffness = [
        CATALOGUE["tire_stiffness"]({"front_scale": front, "rear_scale": rear})
        for front, rear in ((0.85, 1.0), (1.0, 0.85))
    ]
    body = [
        CATALOGUE["mass"]({"scale": scale}, variant)
        for scale, variant in ((1.15, ""), (1.03, "loaded"), (1.15, "loaded"))
    ]
    moved = [CATALOGUE["cg_shift"]({"dx": 0.04 * vehicle.wheelbase}, variant) for variant in ("", "loaded")]
    plays = [CATALOGUE["steer_backlash"]({"width": width}) for width in (0.001, 0.003, 0.03)]
    late = [CATALOGUE[term]({"delay": 0.05}) for term in ("steer_delay", "drive_delay", "sensor_delay")]
    slow = [CATALOGUE[term]({"tau": 0.08}) for term in ("steer_lag", "drive_lag")]
    return [*scales, *fades, *stiffness, *body, *moved, *plays, *late, *slow]


def build_library(columns: Mapping[str, np.ndarray], vehicle: Vehicle, lap_length: float, noise: np.ndarray) -> Library:
    """Return the regressors of a recording: `errors_of_terms` of the plain model less that with each term."""
    nominal = errors_of_terms(columns, vehicle, ())
    found, names = [], []
    for term in (*_small_terms(vehicle, lap_length), *_large_terms(vehicle)):
        column = ((nominal - errors_of_terms(columns, vehicle, [term])) / noise).ravel()
        if np.isfinite(column).all() and np.any(column):
            found.append(column)
            names.append(term.id)
    return Library(np.stack(found, axis=1), tuple(names))


def greedy_selection(library: Library, target: np.ndarray, most: int) -> list[tuple[str, float]]:
    """Return terms chosen one after the other, each with the share of squares that is left with it.

    Parameters
    ----------
    target : ndarray, shape (3 K,)
        Errors over the noise.
    most : int
        Terms at most; a term enters with all its columns.
    """
    names = sorted(set(library.terms))
    owner = np.array(library.terms)
    total = float(target @ target)
    chosen: list[tuple[str, float]] = []
    inside = np.zeros(len(owner), dtype=bool)
    for _ in range(most):
        best = (np.inf, "")
        for name in names:
            if any(name == taken for taken, _ in chosen):
                continue
            trial = library.matrix[:, inside | (owner == name)]
            weights, *_ = np.linalg.lstsq(trial, target, rcond=1e-9)
            left = target - trial @ weights
            best = min(best, (float(left @ left), name))
        chosen.append((best[1], best[0] / total))
        inside |= owner == best[1]
    return chosen


def beyond_catalogue(
    error: np.ndarray, columns: Mapping[str, np.ndarray], vehicle: Vehicle, lap_length: float, noise: np.ndarray
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return what the two best terms together leave of an effect's error, shape (K, 3), and their names."""
    library = build_library(columns, vehicle, lap_length, noise)
    rows = error.size
    library = Library(library.matrix[:rows], library.terms)
    target = (error / noise).ravel()
    names = tuple(name for name, _ in greedy_selection(library, target, 2))
    matrix = library.matrix[:, np.isin(library.terms, names)]
    weights, *_ = np.linalg.lstsq(matrix, target, rcond=1e-9)
    return (target - matrix @ weights).reshape(-1, 3) * noise, names
