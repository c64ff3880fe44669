"""How large an effect is, and which parameters of a catalogue term say it best: from noise-free paired runs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.errors import SplitError
from split_cli.plant.simulation import Trajectory
from split_cli.proof.recordings import RATE, Alignment, SensorFault, command_channels, exact_motion
from split_cli.proof.windows import errors_of_terms
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.parameters import Vehicle

#: Where the fit of a parameter begins, in SI units; lengths are those of a wheelbase of 2.7 m.
GUESSES = {
    "strength": 0.5,
    "scale": 1.0,
    "final_loss": 0.05,
    "length": 0.1,
    "cg_height": 0.2,
    "front_scale": 1.0,
    "rear_scale": 1.0,
    "front": 0.0,
    "rear": 0.0,
    "force": 0.0,
    "yaw_damping": 0.0,
    "slip_stiffness": 0.1,
}


class Unreachable(SplitError):
    """No sensible size of an effect has the effect-to-noise ratio that was asked for."""


def error_to_noise(error: np.ndarray, noise: np.ndarray) -> float:
    """Return the rms of an effect's 0.05 s prediction error over the noise's, where it is largest [1].

    Parameters
    ----------
    error : ndarray, shape (K, 3)
        Of v_x, v_y, r.
    noise : ndarray, shape (3,)
        Standard deviation of one sample; a difference of two has sqrt(2) times it.
    """
    return float((np.sqrt(np.mean(error**2, axis=0)) / (np.sqrt(2.0) * noise)).max())


@dataclass(frozen=True)
class SizeFound:
    """A size, the effect-to-noise ratio it has, and how many paired runs it took."""

    size: float
    effect_to_noise: float
    trials: int


def search_size(
    measure: Callable[[float], float], start: float, most: float, target: float, *, tolerance: float = 0.08
) -> SizeFound:
    """Return the size of an effect that has a given effect-to-noise ratio, by secants in logarithms.

    Parameters
    ----------
    measure : callable
        size -> effect-to-noise ratio; may raise SplitError where the car cannot be driven any more.
    start, most : float
        First trial, and the largest size allowed.
    tolerance : float
        Relative error of the effect-to-noise ratio that is accepted [1].

    Raises
    ------
    Unreachable
        If the largest size is too small, or eight trials do not suffice.
    """
    size, slope = min(start, most), 1.0
    last: tuple[float, float] | None = None
    limit = most
    for trial in range(1, 9):
        try:
            found = measure(size)
        except Unreachable:
            raise
        except SplitError:
            limit = size
            size *= 0.6
            continue
        if abs(found / target - 1.0) <= tolerance:
            return SizeFound(size, found, trial)
        if found <= 0.0:
            size = min(4.0 * size, limit)
            continue
        if size >= limit and found < target:
            reached = f"effect-to-noise ratio {found:.3g}, {target:.3g} was asked for"
            raise Unreachable(f"the largest size {limit:.3g} has {reached}")
        if last is not None and last[0] != size and last[1] != found:
            slope = float(np.clip(np.log(found / last[1]) / np.log(size / last[0]), 0.4, 4.0))
        last = (size, found)
        size = min(size * float(np.clip((target / found) ** (1.0 / slope), 0.05, 20.0)), limit)
    raise Unreachable(f"no size with effect-to-noise ratio {target:.3g} was found in eight trials")


@dataclass(frozen=True)
class ExactDrive:
    """A noise-free recording of a run with an effect, and what the world without it gets wrong."""

    # (N,): t, s, yaw, vx, vy, r, T, delta at 100 Hz as the (possibly faulty) sensors report them; s along the lap.
    columns: Mapping[str, np.ndarray]
    error: np.ndarray  # (K, 3): `world.effect_error`


def exact_drive(run: Trajectory, alignment: Alignment, fault: SensorFault, error: np.ndarray) -> ExactDrive:
    """Return a run with an effect as its noise-free recording."""
    t = np.arange(int(run.t[-1] * RATE + 1e-6)) / RATE
    motion = exact_motion(run, fault, t)
    torque, steer = command_channels(run, t, alignment)
    s = np.interp(t, run.t, run.s) % run.lap_length
    columns = {
        "t": t,
        "s": s,
        "yaw": motion[:, 2],
        "vx": motion[:, 3],
        "vy": motion[:, 4],
        "r": motion[:, 5],
        "T": torque,
        "delta": steer,
    }
    return ExactDrive(columns, error)


def model_gain(exact: ExactDrive, vehicle: Vehicle, terms: Sequence[Term]) -> np.ndarray:
    """Return what terms explain of the nominal model's 0.05 s errors, shape (K, 3): nominal less extended."""
    gain = errors_of_terms(exact.columns, vehicle, ()) - errors_of_terms(exact.columns, vehicle, terms)
    return gain[: len(exact.error)]


def removed_share(exact: ExactDrive, vehicle: Vehicle, terms: Sequence[Term], noise: np.ndarray) -> float:
    """Return which share of an effect's squared error the terms remove; 1 is all, below 0 is harm [1].

    Channels are weighed by their noise.
    """
    if not terms:
        return 0.0
    gap = exact.error / noise
    left = gap[: len(exact.error)] - model_gain(exact, vehicle, terms) / noise
    return float(1.0 - np.sum(left**2) / np.sum(gap**2))


def fit_effective(
    exact: ExactDrive, vehicle: Vehicle, term: str, given: Mapping[str, float], noise: np.ndarray, variant: str = ""
) -> dict[str, float]:
    """Return the parameters of a term that say an effect best; `given` ones are kept.

    Notes
    -----
    Least squares of (effect error - (nominal error - extended error))/noise over all windows of a noise-free
    run: what a diagnosis with endless data would find.
    """
    from scipy.optimize import least_squares

    kind = CATALOGUE[term]
    free = [name for name in kind.parameter_units(variant) if name not in given]
    if not free:
        return dict(given)
    nominal = errors_of_terms(exact.columns, vehicle, ())
    goal = exact.error / noise

    def residuals(values: np.ndarray) -> np.ndarray:
        parameters = {**given, **dict(zip(free, values.tolist(), strict=True))}
        gain = nominal - errors_of_terms(exact.columns, vehicle, [kind(parameters, variant)])
        return np.nan_to_num((goal - gain[: len(goal)] / noise).ravel(), nan=1e6, posinf=1e6, neginf=-1e6)

    scale = {
        "force": 0.01 * vehicle.mass,
        "front": 1e-3 * vehicle.mass,
        "rear": 1e-3 * vehicle.mass,
        "yaw_damping": 0.5 * vehicle.yaw_inertia,
        "cg_height": vehicle.wheelbase,
        "length": vehicle.wheelbase,
        "slip_stiffness": 0.1,
    }
    unit = np.array([scale.get(name, 1.0) for name in free])
    guess = np.array([GUESSES[name] for name in free])
    guess = np.where(np.isin(free, ["length", "cg_height"]), guess * vehicle.wheelbase / 2.7, guess)
    limits = kind.limits(vehicle)
    bounds = np.array([limits[name] if name in kind.constants else (-np.inf, np.inf) for name in free]).T
    solution = least_squares(residuals, guess, bounds=bounds, x_scale=0.1 * unit, diff_step=1e-4, max_nfev=40)
    return {**given, **dict(zip(free, (float(v) for v in solution.x), strict=True))}
