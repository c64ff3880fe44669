"""The double track: its states, its equations, and a step of it for whoever holds the wheel from outside.

Equations, ISO 8855 axes at the CG, i over the wheels, x_i and y_i where wheel i stands, d_i its angle:

- body: m (v_x' - v_y r) = sum F_xi + F_air,x - m g sin(grade);
  m (v_y' + v_x r) = sum F_yi + F_air,y - m g sin(bank);
  I_z r' = sum (x_i F_yi - y_i F_xi), the wheel forces turned into the body by d_i;
- air: F = -rho/2 (c_d A v_air,x, c_s A v_air,y) |v_air| with the wind taken off the car's velocity; the axles gain
  rho/2 c_l A v_air,x^2 of load;
- load: static share, minus or plus m a_x h/L between the axles, and m a_y (share h_roll centre + roll stiffness
  share x (h - h_roll axis))/track between the wheels of one; a_x, a_y reach the tyres through the suspension, a
  second-order lag; a wheel that lifts leaves its load to its neighbour, so the sum always holds;
- wheel: I_w w' = torque + locking (w_other - w) - f_r F_z R - F_x R;
- tyre: slip ratio and tan(slip angle) follow the kinematic ones over a distance (first-order relaxation,
  sigma s' = v_slip - |v| s: Pacejka, Tyre and Vehicle Dynamics, 2nd ed., eqs. (7.7) and (7.9)); forces from
  `tire.tire_force`;
- actuators: first-order lags with a smooth rate limit.

References: Pacejka as above; Gillespie, Fundamentals of Vehicle Dynamics; Milliken and Milliken, Race Car Vehicle
Dynamics, ch. 18 (lateral load transfer).
"""

from dataclasses import dataclass

import numpy as np

from split_cli.plant import _compiled
from split_cli.plant._numbers import as_numbers
from split_cli.plant.cars import CarParameters

_CORNERS = ("fl", "fr", "rl", "rr")
STATE_NAMES = (
    "X",
    "Y",
    "yaw",
    "vx",
    "vy",
    "r",
    *(f"wheel_speed_{c}" for c in _CORNERS),
    *(f"slip_ratio_{c}" for c in _CORNERS),
    *(f"tan_slip_angle_{c}" for c in _CORNERS),
    "torque",
    "steer",
    "ax_load",
    "ax_load_rate",
    "ay_load",
    "ay_load_rate",
)
"""The state vector: pose [m, m, rad], velocities [m/s, m/s, rad/s], wheel spins [rad/s], relaxed slips [1],
delivered torque [N m] and steer angle [rad], specific forces as the suspension passes them on [m/s^2] with their
rates.
"""


@dataclass(frozen=True)
class Surroundings:
    """What is around the car at one instant."""

    friction: float = 1.0  # against the tyres' own peak [1]
    # grade, bank: uphill and left side higher are positive [rad].
    grade: float = 0.0
    bank: float = 0.0
    # wind_x, wind_y: velocity of the air in the world's axes [m/s].
    wind_x: float = 0.0
    wind_y: float = 0.0

    def vector(self) -> np.ndarray:
        """Return the row that compiled code takes: friction at both axles, and no fault."""
        row = np.zeros(_compiled.ENV_SIZE)
        row[: _compiled.ENV_FRICTION_REAR] = self.friction, self.grade, self.bank, self.wind_x, self.wind_y
        row[_compiled.ENV_FRICTION_REAR] = self.friction
        return row


@dataclass(frozen=True)
class Outputs:
    """What follows from a state and an input."""

    specific_force: np.ndarray  # (2,): a_x, a_y at the CG [m/s^2]
    # load, force_x, force_y: (4,): of front left, front right, rear left, rear right; forces in the wheel's frame
    # [N].
    load: np.ndarray
    force_x: np.ndarray
    force_y: np.ndarray
    # power_in, power_tire, power_rolling, power_air, power_gravity: put in by drive and brakes, lost to sliding
    # tyres, to rolling and locked axles, and to the air, gained from gravity [W]; the kinetic energy changes by in
    # - tire - rolling - air + gravity.
    power_in: float
    power_tire: float
    power_rolling: float
    power_air: float
    power_gravity: float


def outputs_from(vector: np.ndarray) -> Outputs:
    """Return the outputs packed in a row, shape (19,), at the places `OUT_...` of the compiled code."""
    return Outputs(vector[0:2], vector[2:6], vector[6:10], vector[10:14], *(float(v) for v in vector[14:19]))


def advance(
    car: CarParameters,
    state: np.ndarray,
    torque_command: float,
    steer_command: float,
    duration: float,
    *,
    step: float = 1e-3,
    surroundings: Surroundings | None = None,
) -> tuple[np.ndarray, Outputs]:
    """Return the state after `duration` seconds of held commands, and what follows from it there.

    For a controller outside. Delay, gain and backlash of the actuators belong to the loop that remembers commands
    (`simulation`); lags, rate limits and the offset of the steering act here.

    Parameters
    ----------
    duration : float
        Rounded to whole steps, at least one [s].
    step : float
        Of the Runge-Kutta method of order 4 [s].
    """
    count = max(1, int(round(duration / step)))
    around = (surroundings or Surroundings()).vector()
    after, out = _compiled.advance(
        np.asarray(state, dtype=float),
        float(torque_command),
        float(steer_command),
        around,
        as_numbers(car),
        float(step),
        count,
    )
    return after, outputs_from(out)
