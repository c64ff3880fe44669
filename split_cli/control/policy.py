"""Every number that decides in the controllers, with its unit, what it means and where it comes from.

What a user sets stands in the settings (`MpccSettings`, `MpcSettings`, `Limits`, `Actuators`), whose defaults come
from here. Inputs are weighed in units of the largest torque a second and of 1 rad/s. Imports nothing.
"""

# What may be asked of the tyres and of the actuators.

P_LONG, P_ELLIPSE = 0.9, 0.95
"""Shape of the force ellipse [1]; judgement: the SPLIT paper leaves them open."""

SHARE_NOMINAL, SHARE_LEARNED, RACE_P_LONG = 0.85, 0.95, 1.2
"""Shares of the peak that races use with the nominal model and with what was learned, and the shape of the ellipse
[1]: found by one search for both, docs/experiments.md."""

SHARE_STEP = SHARE_LEARNED - SHARE_NOMINAL
"""By how much the share of the peak may rise after a clean lap [1]: what was learned tells of forces up to those
that were driven, and a correction that is asked far beyond them extends what it saw. It is the step from what
races use with the nominal model to what they use with what was learned."""

MARGIN, FIRST_DEVIATION = 0.3, 0.8
"""Kept from the car's side to the border in races, and on top of it until a lap has shown how far plan and drive
part [m]; by every controller. Of the same search: its laps came up to 0.75 m nearer to the border than planned."""

FIRST_ERROR = 0.08
"""Error of acceleration for which FIRST_DEVIATION is kept, over the largest lateral acceleration that was driven
[1]: of the car with which the latter was found, lap 0 of the small track, seed 100 (0.51 m/s^2 of v_y and 0.28
rad/s^2 of r at 0.82 g)."""

SIZE = 2.68
"""Wheelbase of the car that MARGIN and FIRST_DEVIATION were found with [m]. Cars of other sizes keep these lengths
in proportion: at equal accelerations the time of a manoeuvre goes with the root of a length (Froude), and what an
error of acceleration adds up to goes with the square of the time."""

MODEL_CAR = 1.0
"""Wheelbase below which a car carries nobody [m]: courses for cars are scaled to it. Model cars of 1:10 have
0.33 m, the smallest cars with a driver 1.5 m."""

DEVIATION_KEPT = 0.8
"""Share of what was kept on top that the next lap keeps at least [1]: a lap without a mistake is no proof of the
next."""

ALPHA_MAX, DALPHA_MAX = 0.18, 0.10
"""Slip angle and difference of slip angles [rad]: the SPLIT paper's section on the controller."""

LEAST_SIDE = 0.1
"""Share of its side force that an axle keeps when it brakes with all it has [1], so that the limit has a
slope."""

SATURATED = 1.0 - LEAST_SIDE**2
"""Share of the squared ellipse beyond which the slip limit no longer moves with the force [1]: what LEAST_SIDE
leaves."""

NO_FORCE = 1e-100
"""Share of the peak that is none [1]: keeps quotients finite, and its third power is not rounded to zero."""

MAX_STEER, STEER_RATE, TORQUE_RATE = 0.5, 0.6, 20000.0
"""What commands may be: [rad], [rad/s], [N m/s]. A driver's quick hands at a steering ratio of 15 (9 rad/s),
and the rate of the plant's road car."""

SLOWEST = 1.0
"""Speed below which a linearisation is taken at this speed [m/s]: slip angles have no meaning at a
standstill."""

# How far the programmes go.

TRACK_SLACK, ELLIPSE_SLACK, SLIP_DIFFERENCE_SLACK = 300.0, 4e4, 4e4
"""Weights of squared slacks: contour beyond the border [1/m^2], slip angles beyond their limits [1/rad^2]. In
one stage a border broken by 0.1 m costs 3, a limit broken by 0.01 rad costs 4, and driving at 20 m/s earns 20.
From a prototype on the same plant."""

PROXIMAL = 0.02
"""Of squared steps of the scaled states from one plan to the next [1]: keeps a plan where its linearisation
holds."""

RETURN_SHARE = 0.5
"""Of the torque's rate at which a torque beyond its bound has to come back [1]: below 1, so that a programme
always has an answer."""

PATIENCE = 10
"""Programmes in a row without a solution after which a controller gives up [1]: half a second at 50 ms, what a
plan of 4 s outlives."""

ANEW = 4
"""Programmes from the line on after a plan that spins [1]: what fits into an interval of 50 ms."""

FIRST_STEPS = (1.0, 0.5, 0.25)
"""Shares of a programme's step that are taken in turn until a first plan is found [1]: a line search by halving.
A plan that is found with a share is a fixed point of whole steps too."""

PROGRESS_ACCELERATION = 30.0
"""Bound of the rate of the progress speed [m/s^2]: three times what tyres give, so that it never decides."""

ROOM_SHARE = 0.5
"""Most of the room between car and border that tightening may take [1]: the track must stay passable."""

# The solver.

FREE = 1e4
"""What stands for no bound, in scaled variables [1]. HPIPM treats an infinite one as 1e8, which spoils its
scaling."""

FAR = 1e3
"""So far from the plan that a state's bound is none, in scaled variables [1]."""

ATTEMPTS: tuple[dict[str, str | int | float], ...] = (
    {"mode": "speed_abs", "iter_max": 40, "mu0": 1.0},
    {"mode": "robust", "iter_max": 40},
)
"""HPIPM's settings in the order in which they are tried: mode, most iterations (the SPLIT paper's), and the
barrier to begin with, in scaled variables [1]. On 240 programmes of races ``speed_abs`` took 3.5 instead of 5.1 ms
of mode ``speed`` (13 states) and 5.2 instead of 7.6 ms (18 states), and solved all. Its applied inputs differed by at
most 0.003 of their scale from those of ``robust``, their costs by 7e-5, where a stage costs up to 20. A barrier of 1
instead of 10 takes a tenth less time."""

FEASIBLE = 1e-5
"""By how much an accepted answer may break equations and bounds, of the largest scaled variable [1]."""

# What is learned while driving.

WIDER = 1.35
"""How much wider the learned region is than the controller's limits of slip angles [1]. A fast lap runs along
the limits, and its samples scatter to both sides of them."""

OPEN_ELLIPSE = 1.1
"""Ellipse of the learned region [1]: open beyond the peak, since the force of a saturated nominal axle no
longer tells how far it slips."""

SETTLED = 8.0
"""Time constants after which a lag has forgotten where it began [1]: e^-8 is 3e-4 of the first difference, far
below what sensors tell of it."""

PAST = 0.08
"""Time constant behind which slip angles and torque tell of the recent past as features [s]: from labels of races
with seed 100, which no table has."""

DICTIONARY = 400
"""Points that the dictionary of the rival may keep [1]: more than the 361 that the SPLIT paper's held after ten
laps."""

GRIP_RANGE, GRIP_STEP = (0.2, 1.6), 0.005
"""Of the peak over the file's that is looked for [1]: from ice to tyres that a file takes for half as good."""

GRIP_TORQUE = 0.25
"""Largest |T/T_max| of labels that tell the peak [1]: an axle that drives or brakes harder has less force to the
side for another reason."""

GRIP_DOUBT = 4.0
"""By how much, times the labels' variance, a sum of squares may exceed the least [1]: two standard deviations."""

LEAST_KNOWN = 0.5
"""Share of what there is to know from which an exported function tells an axle's force [1]: it knows more than it
lacks."""

TABLE_BOUND = 0.02
"""Error of a race's table in signal deviations [1]; judgement: label noise is more than a tenth of the signal."""
