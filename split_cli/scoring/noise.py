"""The noise floor: the label rms that sensor noise alone makes, below which no model can go."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.learning.labels import Labels, inputs_along
from split_cli.learning.pieces import pieces
from split_cli.logs.assembling.noise import estimate_noise
from split_cli.logs.drive import Drive, NoiseEstimate
from split_cli.scoring.persistence import phi_at
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.windows import Windows

Direction = np.ndarray | float
_VELOCITIES = ("vx", "vy", "r")
_INPUTS = ("T", "delta")
_LABELS = (("v_x", "v_y", "r"), ("m/s^2", "m/s^2", "rad/s^2"))
_MOST_WINDOWS = 400
_FAR_ABOVE = 5.0
_LARGE_SHARE = 0.25


@dataclass(frozen=True)
class NoiseFloor:
    """Label rms from sensor noise."""

    rms: np.ndarray | None  # (3,): [m/s^2], [m/s^2], [rad/s^2]; None where it is unknown
    reason: str = ""  # why it is None, or what it leaves out; empty otherwise

    @property
    def norm(self) -> float | None:
        """Root of the summed squares, to compare with the norm of an error."""
        return None if self.rms is None else float(np.sqrt(np.square(self.rms).sum()))


def noise_floor(model: SingleTrack, drive: Drive, labels: Labels) -> NoiseFloor:
    """Propagate the drive's sensor noise into its labels.

    Noise of a channel is what `split ingest` noted (standard deviation and autocorrelation on the drive's clock,
    after its filter); for a drive that came without notes, white noise estimated from third and higher
    differences of its samples.

    Notes
    -----
    y = Phi^-1 (x(t + h) - f_h(x(t), u(t..t + h)))/h, so noise w of the velocities and n of the inputs adds
    Phi^-1 (w(t + h) - F_x w(t) - sum_k F_u,k n(t_k))/h, with F_x and F_u,k the derivatives of the RK4 flow over
    the window (central differences of the integrator itself). Its covariance uses the autocorrelation between the
    window's two ends, and between input samples. Averaged over up to 400 windows spread over the labels.

    The floor is what noise adds to the *label*; noise of the features, which blurs g, is not in it.
    """
    estimates = {name: _noise_of(drive, name) for name in (*_VELOCITIES, *_INPUTS)}
    for name in _VELOCITIES:
        if estimates[name].sigma is None:
            return NoiseFloor(None, f"the noise of {name} is unknown: {estimates[name].reason}")
    usable = np.flatnonzero(np.isfinite(labels.y).all(axis=1))
    if not len(usable):
        return NoiseFloor(None, "no label could be computed")
    chosen = usable[np.unique(np.linspace(0, len(usable) - 1, _MOST_WINDOWS).astype(int))]
    rows, window = labels.row[chosen], labels.window
    by_state, by_torque, by_steer = _flow_derivatives(model, drive, rows, window)
    covariance = covariance_of_ends(by_state, [estimates[name] for name in _VELOCITIES], window)
    for name, gains in (("T", by_torque), ("delta", by_steer)):
        if estimates[name].sigma:
            covariance += _propagate(gains, estimates[name], np.arange(window + 1))
    phi = np.broadcast_to(np.eye(3), covariance.shape)
    if not labels.plain:
        phi = phi_at(model, drive, rows, labels.horizon)
    covariance = covariance_in_labels(covariance, phi, labels.horizon)
    rms = np.sqrt(np.mean(np.diagonal(covariance, axis1=1, axis2=2), axis=0))
    left_out = [f"{name} ({estimates[name].reason})" for name in _INPUTS if estimates[name].sigma is None]
    return NoiseFloor(rms, f"a lower bound: without the noise of {' and '.join(left_out)}" if left_out else "")


def covariance_of_ends(carried: np.ndarray, noise: Sequence[NoiseEstimate], window: int) -> np.ndarray:
    """Return the covariance that noise of the velocities makes of x(t + h) less its prediction from x(t).

    Parameters
    ----------
    carried : ndarray, shape (N, 3, 3)
        F_x, the derivative of the prediction by x(t).
    noise : sequence of three NoiseEstimate
        Of v_x, v_y and r.
    window : int
        Samples from t to t + h.

    Returns
    -------
    ndarray, shape (N, 3, 3)
        F_x S F_x^T + S for white noise of covariance S; autocorrelation ties the two ends.
    """
    covariance = np.zeros(carried.shape)
    for i, estimate in enumerate(noise):
        gains = np.stack([-carried[:, :, i], np.tile(np.eye(3)[i], (len(carried), 1))], axis=2)
        covariance += _propagate(gains, estimate, np.array([0, window]))
    return covariance


def covariance_in_labels(covariance: np.ndarray, phi: np.ndarray, horizon: float) -> np.ndarray:
    """Return the covariance (N, 3, 3) of labels from that of the velocities after a horizon [s]: Phi^-1 over h."""
    scale = np.linalg.inv(phi)
    labels: np.ndarray = scale @ covariance @ scale.transpose(0, 2, 1) / horizon**2
    return labels


def white_noise(sigma: np.ndarray) -> tuple[NoiseEstimate, ...]:
    """Return white noise of v_x, v_y and r with these standard deviations, shape (3,)."""
    return tuple(NoiseEstimate(name, float(size), None) for name, size in zip(_VELOCITIES, sigma, strict=True))


def fast_motion(labels: Labels, floor: NoiseFloor) -> str:
    """Say where labels jump from one to the next by far more than sensor noise explains; empty where they do not.

    Then the car (or what drives it) moves faster than labels are taken, and features that change more slowly
    cannot predict it: the floor is right, and out of reach.

    Notes
    -----
    Second differences of labels that follow one another remove what is a line over three of them; of white noise
    their mean square is 6 sigma^2. Reported from five times the floor and a quarter of the labels' rms on.
    """
    if floor.rms is None or len(labels) < 3:
        return ""
    follow = (labels.row[2:] - labels.row[:-2] == 2 * labels.window) & (labels.segment[2:] == labels.segment[:-2])
    second = np.diff(labels.y, n=2, axis=0)[follow]
    if not len(second):
        return ""
    jump = np.sqrt(np.nanmean(np.square(second), axis=0) / 6.0)
    least = np.maximum(_FAR_ABOVE * floor.rms, _LARGE_SHARE * np.sqrt(np.nanmean(np.square(labels.y), axis=0)))
    found = [
        f"{name} by {size:.2g} {unit}, {size / level:.0f} times"
        for name, unit, size, level, enough in zip(*_LABELS, jump, floor.rms, least, strict=True)
        if size > enough
    ]
    if not found:
        return ""
    return (
        f"labels jump from one to the next ({'; '.join(found)} what sensor noise explains). Something moves "
        f"within the label interval of {labels.horizon:g} s, and slower features cannot predict it"
    )


def _noise_of(drive: Drive, name: str) -> NoiseEstimate:
    kind = str(drive.metadata.kinds.get(name, ""))
    if name in _INPUTS and kind.startswith("command"):
        return NoiseEstimate(name, 0.0, 0.0)
    noted = drive.metadata.noise_of(name)
    if noted is not None:
        return noted
    if drive.metadata.noise:
        return NoiseEstimate(name, None, None, reason="ingest noted none")
    return estimate_noise(name, drive[name], [(run.start, run.stop) for run in drive.segments()])


def _propagate(gains: np.ndarray, noise: NoiseEstimate, at: np.ndarray) -> np.ndarray:
    """Return G S G^T, shape (N, 3, 3), of `gains` (N, 3, K) and the covariance S of noise at samples `at` (K,)."""
    lag = np.abs(at[:, None] - at[None, :])
    known = np.asarray(noise.autocorrelation)
    correlation = np.where(lag < len(known), known[np.minimum(lag, len(known) - 1)], 0.0)
    propagated: np.ndarray = (noise.sigma or 0.0) ** 2 * np.einsum("nik,kl,njl->nij", gains, correlation, gains)
    return propagated


def _flow_derivatives(
    model: SingleTrack, drive: Drive, rows: np.ndarray, window: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the derivatives of f_h by state (N, 3, 3), and by the torque and steer samples (N, 3, K + 1)."""
    by_state = np.empty((len(rows), 3, 3))
    by_torque, by_steer = np.empty((2, len(rows), 3, window + 1))
    for span, piece in pieces(model, drive, rows, window):
        here = rows[span] - piece.first
        state = np.stack([piece.drive[name][here] for name in _VELOCITIES], axis=1)
        windows = inputs_along(model, piece.drive, piece.recording).windows(here, window)
        by_state[span], by_torque[span], by_steer[span] = _window_derivatives(model, windows, state)
    return by_state, by_torque, by_steer


def _window_derivatives(
    model: SingleTrack, windows: Windows, state: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what `_flow_derivatives` does, of windows that begin at a state (N, 3)."""
    jacobian, samples = windows.jacobian(model, state), windows.torque.shape[1]

    def slope(step: float, of: Direction, of_torque: Direction, of_steer: Direction) -> np.ndarray:
        """Return the derivative of f_h along a direction of state, torque and steer samples."""
        ends = []
        for sign in (1.0, -1.0):
            torque = windows.torque + sign * step * of_torque
            steer_angle = windows.steer_angle + sign * step * of_steer
            moved = replace(windows, torque=torque, steer_angle=steer_angle)
            ends.append(moved.predict(model, state + sign * step * of, jacobian))
        along: np.ndarray = (ends[0] - ends[1]) / (2.0 * step)
        return along

    by_state = np.empty((len(state), 3, 3))
    for i, unit in enumerate(np.eye(3)):
        by_state[:, :, i] = slope(1e-5, unit, 0.0, 0.0)
    by_torque, by_steer = np.empty((2, len(state), 3, samples))
    for k, unit in enumerate(np.eye(samples)):
        by_torque[:, :, k] = slope(1e-5 * model.vehicle.max_torque, 0.0, unit, 0.0)
        by_steer[:, :, k] = slope(1e-6, 0.0, 0.0, unit)
    return by_state, by_torque, by_steer
