"""The GG diagram: which accelerations were driven, and which of them can be learned from."""

import numpy as np
from matplotlib.figure import Figure

from split_cli.learning.features import flow_along
from split_cli.learning.labels import Reason
from split_cli.learning.pieces import pieces
from split_cli.logs.drive import Drive
from split_cli.plots.style import PALETTE, new_figure, quiet
from split_cli.scoring.evaluation import HeldOutSamples
from split_cli.scoring.run import EvaluationRun
from split_cli.vehicle.effects.recording import Recording
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack

_MOST_POINTS = 6000
#: Reasons that say something of the driving; samples in gaps or without numbers have no place in the plane.
_SHOWN = (Reason.ACCEPTED, Reason.SPEED, Reason.SLIP, Reason.SLIP_DIFFERENCE, Reason.ELLIPSE, Reason.GRID)
_COLOURS = (PALETTE[0], "0.5", PALETTE[1], PALETTE[3], PALETTE[4], PALETTE[2])
_MARKERS = (".", "x", "^", "v", "s", "+")


def specific_forces(
    vehicle: Vehicle, drive: Drive, recording: Recording | None = None
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return a_x, a_y at the CG [m/s^2], shape (N,) each, and whether they were recorded.

    `recording` is as of `flow_along`.
    Where they were not, they are the nominal model's: a_x = v_x' - v_y r, a_y = v_y' + v_x r.
    """
    if "ax" in drive and "ay" in drive:
        return drive["ax"], drive["ay"], True
    model = SingleTrack(vehicle)
    dvx, dvy, _ = model.balance(flow_along(model, drive, recording))
    return dvx - drive["vy"] * drive["r"], dvy + drive["vx"] * drive["r"], False


def draw_accelerations(run: EvaluationRun) -> Figure:
    """Draw a_x against a_y where labels start, accepted ones and rejected ones by reason."""
    vehicle = run.sets[0].vehicle
    parts = [_at_labels(vehicle, held) for held in run.held[0]]
    across, along, reason = (np.concatenate([part[i] for part in parts]) for i in range(3))
    recorded = {part[3] for part in parts}
    figure = new_figure(7.6)
    axis = figure.subplots()
    quiet(axis)
    axis.axhline(0.0, color="0.6", linewidth=0.8)
    axis.axvline(0.0, color="0.6", linewidth=0.8)
    shown = np.isin(reason, [int(code) for code in _SHOWN])
    for code, colour, marker in zip(_SHOWN, _COLOURS, _MARKERS, strict=True):
        mine = np.flatnonzero(reason == code)
        if not len(mine):
            continue
        name = "accepted" if code is Reason.ACCEPTED else f"rejected: {code.word.replace('_', ' ')}"
        thinned = mine[:: max(1, -(-len(mine) // _MOST_POINTS))]
        axis.plot(
            across[thinned], along[thinned], marker, color=colour, markersize=4 if marker == "." else 5, alpha=0.6,
            linestyle="none", label=f"{name} ({len(mine)})",
        )  # fmt: skip
    axis.set_xlabel("lateral acceleration $a_y$, left positive [m/s²]")
    axis.set_ylabel("longitudinal acceleration $a_x$ [m/s²]")
    axis.set_aspect("equal", adjustable="datalim")
    axis.legend(loc="upper right", fontsize="medium", markerscale=1.6)
    source = {True: "recorded", False: "of the nominal model"}
    figure.suptitle(
        _finding(across, along, reason, shown) + f"\naccelerations {' or '.join(source[r] for r in recorded)}"
    )
    return figure


def _at_labels(vehicle: Vehicle, held: HeldOutSamples) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    rows, recorded = held.labels.row, False
    along, across = np.empty((2, len(rows)))
    for span, piece in pieces(SingleTrack(vehicle), held.drive, rows, 0):
        *forces, recorded = specific_forces(vehicle, piece.drive, piece.recording)
        along[span], across[span] = (force[rows[span] - piece.first] for force in forces)
    return across, along, held.labels.reason, recorded


def _finding(across: np.ndarray, along: np.ndarray, reason: np.ndarray, shown: np.ndarray) -> str:
    share = np.mean(reason[shown] == Reason.ACCEPTED) if shown.any() else 0.0
    with np.errstate(invalid="ignore"):
        reach = np.nanquantile(np.hypot(across, along), 0.99)
    return f"99 % of samples stay below {reach:.1f} m/s²; {100 * share:.1f} % of samples lie in the valid region"
