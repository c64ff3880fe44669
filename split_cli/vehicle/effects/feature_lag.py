"""The term without a force: lagged motion, kept as features for a learned correction."""

from typing import ClassVar

from split_cli.vehicle.effects.search import LAG_SEARCH
from split_cli.vehicle.effects.term import Term
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.parameters import Vehicle

__all__ = ["FeatureLag"]

_SHORTEST = 1e-3  # time constant that is stepped as it stands [s]; the neutral value 0 is followed at once


class FeatureLag(Term):
    """Slip angles and torque behind a first-order lag, as features; no force depends on them.

    Each state follows its source: tau y' = source - y, steady at each start. Training uses the states as features
    where `--features` names them. Late forces (tyre relaxation, actuators) depend on the recent past, which slip
    angles and torque of one moment do not tell. A diagnosis never claims this term.
    """

    id = "feature_lag"
    units: ClassVar = {"tau": "s"}
    neutral: ClassVar = {"tau": 0.0}
    order = 9
    states = ("alpha_f", "alpha_r", "torque")
    state_units: ClassVar = {"alpha_f": "rad", "alpha_r": "rad", "torque": "N m"}

    @classmethod
    def limits(cls, vehicle: Vehicle) -> dict[str, tuple[float, float]]:
        """Return those of a lag of an actuator."""
        slowest = LAG_SEARCH.ranges["tau"].widened(0.0)
        return {"tau": (slowest.lower, slowest.upper)}

    def fastest_rate(self, speed: float) -> float:
        """Return 1/tau."""
        return 1.0 / max(self.parameters["tau"], _SHORTEST)

    def lateral(self, flow: Flow) -> None:
        """Follow both slip angles and the torque that arrives."""
        tau = self.parameters["tau"]
        rate = 1.0 / (max(tau, _SHORTEST) if isinstance(tau, int | float) else tau)
        self.first_order(flow, "alpha_f", flow.front.slip_angle, rate)
        self.first_order(flow, "alpha_r", flow.rear.slip_angle, rate)
        self.first_order(flow, "torque", flow.T, rate)
