"""Faults of a car that no catalogue lists, so that a diagnosis meets physics it has no name for."""

from dataclasses import dataclass

from split_cli.errors import SplitError


@dataclass(frozen=True)
class Faults:
    """What is wrong with a car beyond its parameters; the default is a sound car."""

    active: bool = False  # whether any fault acts; a sound car's run does not evaluate them
    # grip_loss_fl, grip_loss_fr, grip_loss_rl, grip_loss_rr: share of one wheel's tyre force that is lost, along
    # and across: a damaged or flat tyre [1].
    grip_loss_fl: float = 0.0
    grip_loss_fr: float = 0.0
    grip_loss_rl: float = 0.0
    grip_loss_rr: float = 0.0
    torque_bend: float = 0.0  # a driving command T arrives as T (1 - bend T/T_max): a bent engine map [1]
    # ripple, ripple_order: ripple T_max sin(order x wheel angle) is added to the torque: a driveline out of
    # balance [1].
    ripple: float = 0.0
    ripple_order: float = 1.0
    # brake_fade, brake_heat_capacity, brake_cooling_time: a braking command arrives scaled by 1 - fade min(heat,
    # 1), heat' = |T w|/capacity - heat/cooling time [1], [J], [s].
    brake_fade: float = 0.0
    brake_heat_capacity: float = 1e6
    brake_cooling_time: float = 20.0
    torque_steer: float = 0.0  # the delivered torque turns the front wheels by torque_steer T/T_max [rad]
    # rear_steer, rear_steer_speed: the rear wheels turn by rear_steer delta (v_x/speed - 1): against the front
    # ones below that speed, with them above, as a four-wheel steering left in the wrong map does [1], [m/s].
    rear_steer: float = 0.0
    rear_steer_speed: float = 15.0
    # tire_heat_loss, tire_heat_power, tire_heat_time: every tyre loses loss min(warmth, 1) of its force, warmth' =
    # (P_sliding/power - warmth)/time [1], [W], [s].
    tire_heat_loss: float = 0.0
    tire_heat_power: float = 1e4
    tire_heat_time: float = 8.0
    # stuck_brake, stuck_brake_time: after braking, the front left brake lets go of this share of the braking
    # torque only with this time constant [1], [s].
    stuck_brake: float = 0.0
    stuck_brake_time: float = 1.5
    # slosh_mass, slosh_arm, slosh_frequency: a liquid that is part of the car's mass, `arm` ahead of the CG, moves
    # across on a spring with 10 % of critical damping: y'' = -a_y - w^2 y - 2 zeta w y', and pushes the car by -m
    # y'' beyond a frozen load [kg], [m], [Hz].
    slosh_mass: float = 0.0
    slosh_arm: float = 0.0
    slosh_frequency: float = 0.8
    # pulse_torque, pulse_threshold, pulse_time, pulse_pause: a stability control brakes the outer front wheel for
    # a time whenever the rear slip angle exceeds the threshold, with a pause between [N m], [rad], [s], [s].
    pulse_torque: float = 0.0
    pulse_threshold: float = 0.03
    pulse_time: float = 0.3
    pulse_pause: float = 1.0

    def __post_init__(self) -> None:
        for name in (
            "ripple_order",
            "brake_heat_capacity",
            "brake_cooling_time",
            "rear_steer_speed",
            "tire_heat_power",
            "tire_heat_time",
            "stuck_brake_time",
            "slosh_frequency",
            "pulse_time",
        ):
            if not getattr(self, name) > 0.0:
                raise SplitError(f"{name} must be above 0, got {getattr(self, name)!r}", where="faults")


SOUND = Faults()
