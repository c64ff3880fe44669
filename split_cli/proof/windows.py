"""Prediction errors of the nominal model, with and without terms, over windows of a recording."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from split_cli.proof.recordings import RATE
from split_cli.vehicle.effects import Recording, Term
from split_cli.vehicle.integration import Situation
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.windows import recorded_inputs

HORIZON = 0.05
"""Length of a window [s]."""
FIRST = 0.5
"""Where the first window starts, when tyres are loaded and late channels have begun [s]."""


def errors_of_terms(
    columns: Mapping[str, np.ndarray], vehicle: Vehicle, terms: Sequence[Term], held: Sequence[str] = ()
) -> np.ndarray:
    """Return recorded minus predicted v_x, v_y, r over windows of 0.05 s with the model and terms, shape (K, 3).

    Parameters
    ----------
    columns : mapping of str to ndarray, shape (N,)
        t, s, yaw, vx, vy, r, T, delta at 100 Hz, without a gap, SI.
    held : sequence of str
        Which of T and delta keep their value between samples; for terms that do not act on commands.
    """
    recording = Recording.single(1.0 / RATE, len(columns["t"]))
    for term in terms:
        # A late sensor is described by the commands' clock, see the term.
        if term.corrects:
            columns = term.correct(columns, recording)
    velocity = np.stack([columns["vx"], columns["vy"], columns["r"]], axis=1)
    situation = Situation(columns["t"], columns["s"], columns["yaw"])
    torque, steer = _arrived(vehicle, terms, velocity, columns, recording)
    model = SingleTrack(vehicle, [term for term in terms if not term.acts_on_commands()])
    inputs = recorded_inputs(model, velocity, torque, steer, recording, situation)
    steps = int(round(HORIZON * RATE))
    start = np.arange(int(round(FIRST * RATE)), len(velocity) - steps, steps)

    begin, windows = velocity[start], replace(inputs.windows(start, steps), held=tuple(held))
    jacobian = SingleTrack(vehicle, ()).velocity_jacobian(*begin.T, np.zeros(len(begin)), np.zeros(len(begin)))
    return velocity[start + steps] - windows.predict(model, begin, jacobian)


def _arrived(
    vehicle: Vehicle,
    terms: Sequence[Term],
    velocity: np.ndarray,
    columns: Mapping[str, np.ndarray],
    recording: Recording,
) -> tuple[np.ndarray, np.ndarray]:
    """Return torque and steer angle as actuators pass them on, followed exactly along the recording."""
    acting = [term for term in terms if term.acts_on_commands()]
    if not acting:
        return columns["T"], columns["delta"]
    flow = SingleTrack(vehicle, acting).flow(*velocity.T, columns["T"], columns["delta"], recording=recording)
    return flow.T, flow.delta
