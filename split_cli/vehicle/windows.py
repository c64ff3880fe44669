"""Windows of a recording: the data from which a model can start anywhere in it, and its prediction from there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.vehicle.effects.recording import Recording, over_samples
from split_cli.vehicle.integration import NOWHERE, Situation, integrate_recorded, phi_matrix
from split_cli.vehicle.single_track import SingleTrack

#: RK4 substeps a sample at most [1]: what needs more stands still or leaves the finite numbers.
_MOST_SUBSTEPS = 1_000


@dataclass(frozen=True)
class RecordedInputs:
    """What a model, with memory or without, needs to start a window anywhere in a recording."""

    period: float  # sample period [s]
    # torque, steer_angle: (N,): recorded T [N m] and delta [rad], late by the delays among the terms. Of a held
    # input this is the mean over the sample that begins at the row: a late staircase steps inside its samples.
    torque: np.ndarray
    steer_angle: np.ndarray
    situation: Situation  # at every sample; the terms' states from steady at each segment
    held: tuple[str, ...] = ()  # inputs that are constant over each sample; the others run in straight lines

    def windows(self, rows: np.ndarray, length: int) -> Windows:
        """Return the windows of `length` samples that begin at `rows`, shape (N,); each inside one segment."""
        span = rows[:, None] + np.arange(length + 1)
        return Windows(self.period, self.torque[span], self.steer_angle[span], self.situation.at(rows), self.held)


@dataclass(frozen=True)
class Windows:
    """Stretches of a recording that begin at some rows and have one length."""

    period: float  # sample period [s]
    # torque, steer_angle: (N, K + 1): on the samples of each window [N m], [rad].
    torque: np.ndarray
    steer_angle: np.ndarray
    situation: Situation  # at the windows' begin
    held: tuple[str, ...] = ()  # as of `RecordedInputs`

    def knowing(self, knowledge: np.ndarray | None) -> Windows:
        """Return the windows with how much a trained set knows at their begin, shape (N,); as they are for None."""
        return self if knowledge is None else replace(self, situation=replace(self.situation, knowledge=knowledge))

    def jacobian(self, model: SingleTrack, state: np.ndarray) -> np.ndarray:
        """Return the velocity Jacobian at the windows' begin, (N, 3, 3), of states as `predict` takes them."""
        return model.velocity_jacobian(*self._begin(state), **self._situation(state).arguments(model))

    def phi(self, model: SingleTrack, state: np.ndarray, jacobian: np.ndarray, horizon: float) -> np.ndarray:
        """Return Phi of labels and corrections, shape (N, 3, 3): that of `responses`, whose parameters it has.

        Where no velocity moves what the terms remember, it is that of the velocities alone.
        """
        if not model.memory_feeds_back:
            return phi_matrix(jacobian, horizon)
        return self.responses(model, state, jacobian, horizon)[0]

    def responses(
        self, model: SingleTrack, state: np.ndarray, jacobian: np.ndarray, horizon: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return Phi and exp(A h), their velocity blocks, shape (N, 3, 3) each, with what the terms remember.

        Phi times h is what a constant rate of the velocities makes of them within h; exp(A h) is what is left of a
        velocity's change at the begin.

        Parameters
        ----------
        state : ndarray, shape (N, 3) or (N, 6)
            As `predict` takes it; windows are those of `RecordedInputs`, so that the terms' states are known.
        jacobian : ndarray, shape (N, 3, 3)
            `jacobian` there.
        horizon : float
            h [s].

        Notes
        -----
        A is the Jacobian of velocities and of the terms' states together. A tyre's force that builds up within h
        resists most of a rate that is held that long. With the states held still it would resist none of it, so
        that a force that builds up ever faster would never come to be one that is there at once.
        """
        A = jacobian
        if model.state_names:
            A = model.jacobian_with_memory(*self._begin(state), **self._situation(state).arguments(model))
            A = np.where(np.isfinite(A).all(axis=(1, 2), keepdims=True), A, 0.0)
        phi = phi_matrix(A, horizon)
        return phi[:, :3, :3], np.eye(3) + horizon * (A @ phi)[:, :3, :3]

    def _begin(self, state: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return v_x, v_y, r, torque and steer angle at the windows' begin."""
        return (*state[:, -3:].T, self.torque[:, 0], self.steer_angle[:, 0])

    def _situation(self, state: np.ndarray) -> Situation:
        return self.situation if state.shape[1] == 3 else replace(self.situation, yaw=state[:, 2])

    def predict(
        self, model: SingleTrack, state: np.ndarray, jacobian: np.ndarray, most: int = _MOST_SUBSTEPS
    ) -> np.ndarray:
        """Return the states at the windows' end, same shape as `state`.

        Parameters
        ----------
        state : ndarray, shape (N, 3) or (N, 6)
            (v_x, v_y, r), or (X, Y, yaw, v_x, v_y, r), at the windows' begin.
        jacobian : ndarray, shape (N, 3, 3)
            There, for the number of substeps.
        most : int
            Substeps a sample at most.
        """
        counts = np.minimum(substep_count(jacobian, self.period, model.vehicle.wheelbase), most)
        ahead = np.empty_like(state)
        for count in np.unique(counts):
            rows = np.flatnonzero(counts == count)
            ahead[rows] = integrate_recorded(
                model,
                state[rows],
                self.torque[rows],
                self.steer_angle[rows],
                self.period,
                int(count),
                self.situation.at(rows),
                held=self.held,
            )
        return ahead


def substep_count(jacobian: np.ndarray, period: float, wheelbase: float) -> np.ndarray:
    """Return for each window how many RK4 substeps a sample keep |lambda| step <= 1, int64 shape (N,).

    Parameters
    ----------
    jacobian : ndarray, shape (N, 3, 3)
        Velocity Jacobians [1/s and mixed].
    period : float
        Sample period [s].
    wheelbase : float
        [m].

    Notes
    -----
    Each window has its own count, so that what is predicted of it does not depend on what it is computed together
    with. The spectral radius is bounded by the fourth root of |A^4|, at most 15 % above it for a normal matrix,
    with the yaw rate scaled by half the wheelbase to a velocity. 1 where the Jacobian is not finite; at most
    1,000.
    """
    scale = np.array([1.0, 1.0, 0.5 * wheelbase])
    squared = np.linalg.matrix_power(jacobian * scale[:, None] / scale, 2)
    radius = np.sqrt(np.sqrt(np.linalg.norm(squared @ squared, axis=(1, 2))))
    count: np.ndarray = np.clip(np.ceil(np.nan_to_num(radius * period, nan=1.0)), 1, _MOST_SUBSTEPS)
    return count.astype(np.int64)


def recorded_inputs(
    model: SingleTrack,
    velocity: np.ndarray,
    torque: np.ndarray,
    steer_angle: np.ndarray,
    recording: Recording,
    situation: Situation = NOWHERE,
    *,
    held: Sequence[str] = (),
) -> RecordedInputs:
    """Follow delays and the terms' states along a whole recording.

    Parameters
    ----------
    velocity : ndarray, shape (N, 3)
        Recorded (v_x, v_y, r).
    torque, steer_angle : ndarray, shape (N,)
        As recorded: commands, where a term says what becomes of them.
    recording : Recording
        Its clock and segments.
    situation : Situation
        At every sample; its states are found here.
    held : sequence of str
        Which of ``T`` and ``delta`` keep their value until the next sample.
    """
    period, late = recording.period, {"T": torque, "delta": steer_angle}
    if not model.terms:
        return RecordedInputs(period, torque, steer_angle, situation, tuple(held))
    at, inputs = velocity, dict(late)
    if held and model.state_names:
        # Means over samples: lags and delays pass them on as they pass on the course itself.
        recording = replace(recording, means=True)
        at = over_samples(velocity, recording)
        inputs = {name: row if name in held else over_samples(row, recording) for name, row in inputs.items()}
    vx, vy, r = at.T
    t, s, yaw = situation.t, situation.s, situation.yaw
    flow = model.flow(vx, vy, r, inputs["T"], inputs["delta"], t=t, s=s, yaw=yaw, recording=recording)
    columns = [flow.values[name] + np.zeros(len(velocity)) for name in model.state_names]
    states = np.stack(columns, axis=1) if columns else None
    for term in model.terms:
        for channel, delay in getattr(term, "input_delays", {}).items():
            late[channel] = term.delayed(flow, late[channel], delay)
    return RecordedInputs(period, late["T"], late["delta"], replace(situation, states=states), tuple(held))
