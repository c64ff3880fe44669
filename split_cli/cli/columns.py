"""What the columns of printed tables mean: for `split explain`, for `--legend`, and for the page in the docs."""

from __future__ import annotations

__all__ = ["COLUMNS", "LABELS_REASONS", "meaning"]

_RMS = "root mean square error"
_INTERVAL = "interval that holds the true value in 95 of 100 cases"

#: Table (the command that prints it), column, meaning. `any` holds columns that mean the same everywhere.
COLUMNS: dict[str, dict[str, str]] = {
    "any": {
        "+-": f"half of the 95 % {_INTERVAL}, in the unit of the value beside it",
        "cells": "cells of the feature space that hold at least one point",
        "drive": "the recording, by its file name",
        "failures": "steps in which the solver found no solution, so that the car followed the previous plan",
        "features": "what the correction depends on: z2 slip angles and torque, z1 velocities, torque, steering",
        "lap": "number of the lap; 0 is driven with the nominal model",
        "points": "number of samples stored in the set",
        "r": f"{_RMS} of yaw rate: rad/s^2 of one step, rad/s after an open-loop simulation",
        "time s": "duration [s]",
        "unit": "SI unit; 1 for a plain number",
        "updates": "number of samples that changed the set",
        "us/query": "time of one prediction [microseconds], on this machine, one thread",
        "v_x": f"{_RMS} of longitudinal velocity: m/s^2 of one step, m/s after an open-loop simulation",
        "v_y": f"{_RMS} of lateral velocity: m/s^2 of one step, m/s after an open-loop simulation",
        "value": "estimate, in the unit of its row or column",
        "valid region %": "share of the cells of the valid region that hold a point",
        "samples": "label windows of the drive",
        "accepted": "samples inside the valid region, which may be learned from",
    },
    "evaluate": {
        "+-": "standard error of the value to its left",
        "NLPD": "negative log predictive density of the labels, over all outputs; less is better",
        "after s": "length of the open-loop simulation on the recorded inputs [s]",
        "behind": "by how much the mean squared error exceeds that of the best candidate [1]",
        "capacity": "largest number of points in a cell",
        "cell edge": "edge length of a cell as a multiple of the standard edge",
        "error": "error of one step over that of the nominal model, on blocks used for choosing [1]",
        "share": "share of the labels that lie within a length scale of the set's points, or beyond [%]",
        "in 50 %": "share of labels inside the 50 % interval, of v_x/v_y/r [%]",
        "in 90 %": "share of labels inside the 90 % interval, of v_x/v_y/r [%]",
        "in 95 %": "share of labels inside the 95 % interval, of v_x/v_y/r [%]; far below 95 means overconfident",
        "model": "predictor; nominal: the vehicle file alone; velocity held: persistence; last label held: the "
        "last label as correction; noise floor: error of sensor noise alone",
        "norm": "root of the sum of the three squared errors of one step; for ranking only, since it mixes units",
        "norm valid": "the same, inside the valid region only",
        "position": f"{_RMS} of position after the open-loop simulation [m]",
        "size": "requested size of the set",
        "skill": "1 - MSE/MSE of persistence (velocities held): 1 is perfect, 0 as good as persistence, "
        "below 0 worse",
        "skill v_x,v_y,r": "skill of each state separately",
        "starts": "number of open-loop simulations, each from a start of its own",
        "threshold": "smallest marginal gain of a sample that is kept",
    },
    "compare": {
        "after s": "length of the open-loop simulation on the recorded inputs [s]",
        "fit %": "100 (1 - |error|/|measured - mean|), the fit of identification tools; below 0 the mean is "
        "better",
        "model": "vehicle file, or trained set with its predictor; * marks the best of a column",
        "of held": "mean over the three states of the rms error over that of velocities held [1]; less is better",
        "r": f"{_RMS} of yaw rate after the open-loop simulation [rad/s]",
        "skill": "1 - MSE/MSE of velocities held: 1 is perfect, 0 no better than persistence",
        "v_x": f"{_RMS} of longitudinal velocity after the open-loop simulation [m/s]",
        "v_y": f"{_RMS} of lateral velocity after the open-loop simulation [m/s]",
    },
    "diagnose": {
        "from": "smallest size at which this effect, if it were the only one, would have been identified on these "
        "drives",
        "or": "alternatives: explanations that these data cannot separate from the term",
        "parameter": "parameter of the term; docs/catalogue.md gives unit and sign",
        "std error": "standard error of the estimate, in its unit; includes the uncertainty from effects "
        "that look alike",
        "term": "physical effect or sensor fault, by its name in the catalogue",
        "simulation as it is": "the nominal model, with what was learned from simulated drives, if any",
        "with the identified effects": "the simulation with the identified effects",
        "with SPLIT only": "the simulation with the correction that SPLIT learns, without physical effects",
        "with effects and SPLIT": "the simulation with the identified effects, and SPLIT on the residual",
        "persistence": "prediction that the velocities stay as they are",
        "noise floor": "error that sensor noise alone causes",
    },
    "calibrate": {
        "B": "stiffness factor of the Magic Formula [1/rad]",
        "C": "shape factor of the Magic Formula [1]",
        "D [N]": "peak lateral force of the whole axle",
        "differ there [N]": "largest difference between equally good curves at slip angles that the drives cover",
        "to alpha_max [N]": "the same at all slip angles up to alpha_max",
        "at [rad]": "slip angle of the largest deviation",
        "axle": "front or rear",
        "from turning": "parameter of the body that turning shows",
        "held out [N]": "rms force error on blocks of time not fitted to",
        "in the source": "the curve in the other project's file",
        "largest deviation [N]": "largest difference between the curve in the source and the fitted one",
        "resistance": "force that slows a rolling car",
        "determined": "what the drives determine; the other coefficients stay as given",
        "force [N]": "rms of the force itself, to compare the error with",
        "covered to [rad]": "largest slip angle that the drives cover",
        "stiffness [N/rad]": "cornering stiffness: slope of the curve at zero slip",
        "given file [N]": "the same error of the file that was given",
    },
    "export": {
        "target": "the format that was written",
        "mean error": "largest difference of the mean from Python's, in signal standard deviations",
        "variance error": "largest difference of the variance from Python's, in signal variances",
        "Jacobian error": "largest difference of the derivatives from Python's",
        "step error": "largest difference of the model's discrete step from Python's",
        "tables kB": "size of the numbers",
        "code kB": "size of the code",
    },
    "ingest": {
        "channel": "name in the recording",
        "type": "kind of its values",
        "count": "number of samples",
        "source": "recorded signal that the map assigns to the channel",
        "rate/Hz": "rate of the source, from the median distance of two samples [Hz]",
        "jitter": "half the spread between the 1 % and 99 % quantile of that distance, over the median",
        "gaps": "number of gaps in the source",
        "min": "smallest value, in the SI unit of the row",
        "max": "largest value, in the SI unit of the row",
        "resampling": "how the source was put on the drive's clock: held, interpolated or low-passed",
    },
    "maneuver": {
        "speed m/s": "speed asked for at the entry",
        "entry m/s": "speed at the first cone; nan if the car did not reach it",
        "exit m/s": "speed at the end of the run",
        "cones hit": "number of cones that the car touched",
        "deviation m": "largest distance of the CG from the planned line",
        "|ay| m/s^2": "largest lateral acceleration",
        "ended": "why the run ended",
    },
    "prove": {
        "what": "the rate that has a goal",
        "goal": "required value, set before the run",
        "reached": "value on these cases",
        "met": "whether the goal is met",
        "held-out rmse": "model, scored on time that it was not fitted to",
        "v_x m/s^2": f"{_RMS} of one step",
        "v_y m/s^2": f"{_RMS} of one step",
        "r rad/s^2": f"{_RMS} of one step",
        "fault": "the sensor fault that was added",
        "put in": "true size of the fault",
        "outcome": "whether the fault was found",
        "said": "what the diagnosis named",
        "found": "the size that the diagnosis estimated",
        "interval": _INTERVAL,
    },
    "race": {
        "speed m/s": "mean speed of the lap",
        "|ay| g": "largest lateral acceleration of the lap [9.81 m/s^2]",
        "set": "number of points in the set",
        "error vx": f"{_RMS} of v_x over 50 ms with the learned correction [m/s^2]",
        "vy": f"{_RMS} of v_y over 50 ms with the learned correction [m/s^2]",
        "of nominal": "these errors over those of the nominal model, v_x/v_y/r [1]; less is better",
        "outside m": "how far a side of the car left the track",
        "learning ms": "CPU time of labels and update: median, 99 %, worst",
        "solver ms (median, 99 %, worst)": "CPU time of the solver in a step",
        "step ms (median, 99 %, worst)": "CPU time of a whole step",
    },
    "simulate": {
        "distance m": "distance driven",
        "top speed m/s": "largest speed",
        "|ay| max": "largest lateral acceleration [m/s^2]",
        "ax max": "largest acceleration [m/s^2]",
        "ax min": "hardest braking [m/s^2]",
    },
    "train": {
        "mean speed m/s": "mean speed of the lap",
        "max |v_x r| m/s^2": "largest lateral acceleration of the lap",
        "set size": "number of points stored so far",
        "us/sample": "time of an update per sample [microseconds]",
        "MB": "memory of the set",
    },
    "verify": {"check": "what was checked", "result": "ok or not", "detail": "what was found"},
}
#: Why a sample is not learned from; columns of `split label` and `split train`, behind the word *rejected*.
LABELS_REASONS = {
    "gap": "the label window contains a gap of the recording",
    "non_finite": "a value is not a number",
    "speed": "slower than the model is valid for, or at standstill",
    "slip": "a slip angle beyond alpha_max",
    "slip_difference": "|alpha_f - alpha_r| beyond dalpha_max",
    "ellipse": "the demanded axle force is outside its friction ellipse",
    "grid": "outside the grid of cells",
    "gain": "the sample adds no information to the stored points",
}
for _table in ("label", "train"):
    COLUMNS.setdefault(_table, {}).update({f"rejected: {name}": text for name, text in LABELS_REASONS.items()})


def meaning(table: str, column: str) -> str | None:
    """Return what a column of a table means, None where nobody has written it down."""
    return COLUMNS.get(table, {}).get(column) or COLUMNS["any"].get(column)
