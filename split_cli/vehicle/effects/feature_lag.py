"""The term without a force: lagged motion, kept as features for a learned correction."""

from typing import ClassVar

from split_cli.vehicle.effects.late import Lagging, rate_of
from split_cli.vehicle.effects.search import LAG_SEARCH, Course, Search
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.parameters import Vehicle

__all__ = ["FeatureLag"]


class FeatureLag(Lagging):
    """Slip angles and torque behind a first-order lag, as features; no force depends on them.

    Each state follows its source: tau y' = source - y, steady at each start. Training uses the states as features
    where `--features` names them. Late forces (tyre relaxation, actuators) depend on the recent past, which slip
    angles and torque of one moment do not tell. A diagnosis never claims this term.
    """

    id = "feature_lag"
    order = 9
    moves_car = False
    states = ("alpha_f", "alpha_r", "torque")
    state_units: ClassVar = {"alpha_f": "rad", "alpha_r": "rad", "torque": "N m"}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        return None

    @classmethod
    def limits(cls, vehicle: Vehicle) -> dict[str, tuple[float, float]]:
        """Return those of a lag of an actuator."""
        slowest = LAG_SEARCH.ranges["tau"].widened(0.0)
        return {"tau": (slowest.lower, slowest.upper)}

    def lateral(self, flow: Flow) -> None:
        """Follow both slip angles and the torque that arrives."""
        self.arrived(flow, "alpha_f", flow.front.slip_angle, rate_of)
        self.arrived(flow, "alpha_r", flow.rear.slip_angle, rate_of)
        self.arrived(flow, "torque", flow.T, rate_of)
