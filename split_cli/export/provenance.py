"""What every export carries: where it comes from, what its numbers mean, and how it was verified."""

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from split_cli import __version__
from split_cli.learning.training_set import TrainingSet
from split_cli.scoring.export_warnings import reservations
from split_cli.vehicle.parameters import vehicle_to_mapping

CONVENTIONS = {
    "frame": "ISO 8855 at the centre of gravity: x forward, y left, z up, yaw counter-clockwise positive",
    "units": "SI, radians",
    "slip_angles": "alpha_f = delta - atan((v_y + l_f r)/v_x), alpha_r = -atan((v_y - l_r r)/v_x)",
    "torque": "T is the total torque at the wheels, driving positive [N m]; torque_ratio = T/max_torque",
    "state": "x = [X, Y, yaw, v_x, v_y, r, T, delta], input u = [dT/dt, ddelta/dt]",
    "outputs": "g(z) = residual of [v_x' m/s^2, v_y' m/s^2, r' rad/s^2]; latent variance, without label noise",
    "trust": "of an output with trust tau and doubt w, mean m and variance v become tau m and a v + w, "
    "a = max(tau^2, 1 - w/S0), S0 the variance of the signal",
    "prediction": "x(t + h) = f_h(x, u) + h B Phi g(z), Phi = (1/h) int_0^h exp(A s) ds, A the nominal velocity "
    "Jacobian, B selecting v_x, v_y, r",
    "not_a_number": "a query that is not a number gives not-a-number; an infinite one gives the prior",
}
"""Meaning of every number in an export, the same for all targets."""


@dataclass(frozen=True)
class Provenance:
    """Where an export comes from."""

    # set_name, set_sha256: file name, without folder, and SHA-256 of the trained set.
    set_name: str
    set_sha256: str
    vehicle: dict[str, Any]  # as a vehicle file holds it
    vehicle_digest: str  # SHA-256 of the vehicle's values
    features: tuple[str, ...]
    horizon: float  # label interval h [s]
    predictor: str
    slowest: float  # v_x above which training took samples [m/s], `Region.minimum_speed`
    version: str = __version__  # of split
    reservations: tuple[str, ...] = ()  # where the correction may do harm, `scoring.export_warnings`
    memory: dict[str, Any] | None = None  # states of the step beyond the first eight, as `Memory.to_mapping` has it

    @property
    def conventions(self) -> dict[str, str]:
        """Meaning of every number, of states beyond the first eight too."""
        if self.memory is None:
            return dict(CONVENTIONS)
        return {**CONVENTIONS, "state": CONVENTIONS["state"] + "; x continues with the states named in `memory`"}


def provenance_of(training_set: TrainingSet, predictor: str, set_name: str = "", set_sha256: str = "") -> Provenance:
    """Return the provenance of a set; without a file, its SHA-256 is that of its content."""
    return Provenance(
        set_name=set_name,
        set_sha256=set_sha256 or prediction_digest(training_set),
        vehicle=vehicle_to_mapping(training_set.vehicle),
        vehicle_digest=training_set.vehicle.digest(),
        features=training_set.features.names,
        horizon=float(training_set.horizon),
        predictor=predictor,
        slowest=float(training_set.region.minimum_speed),
        reservations=reservations(training_set),
    )


def prediction_digest(training_set: TrainingSet) -> str:
    """Return the SHA-256 of what predictions depend on: points, labels, cells, kernel, trust, vehicle, names."""
    digest = hashlib.sha256(training_set.vehicle.digest().encode())
    digest.update("\0".join(training_set.features.names).encode())
    kernel = training_set.kernel
    trust = training_set.trust
    arrays = [training_set.cell_numbers, training_set.offsets, training_set.z, training_set.y]
    arrays += [kernel.length_scales, kernel.signal_variance, kernel.noise_variance]
    for array in (*arrays, trust.array, trust.doubts(kernel.signal_variance)):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
