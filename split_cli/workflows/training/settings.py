"""How to train a set."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TrainSettings:
    """How to train; None means the default for a new set, and the set's own when appending."""

    features: str | None = None  # ``z2`` (default), ``z1`` or a comma-separated list of names
    hyperparameters: str | None = None  # ``fit`` (default), ``default``, or a YAML file; only for a new set
    horizon: float | None = None  # label interval [s], 0.05 by default
    stride: int | None = None  # samples between labels; the horizon by default
    capacity: int | None = None  # points a cell, 10 by default
    threshold: float | None = None  # gain that a point needs to enter a cell with room, 1e-3 by default
    cell_edge: float | None = None  # edge of the cells in usual edges, 1 by default; only for a new set
    forgetting: float | None = None  # time constant [s]; off by default
    plain: bool = False  # use the paper's plain difference as label
    exclude: tuple[tuple[float, float], ...] = ()  # stretches of time of every drive [s] that are not learned
    # ``split`` (default), or ``iol``: one dictionary of `capacity` points, 300 by default.
    learner: str | None = None
    held: tuple[str, ...] = ()  # inputs that keep their value between samples, whatever the files say
    # ``held-out`` (default): found on held-out blocks of the drives; ``full``: the plain method; or three numbers
    # from 0 to 1 for v_x, v_y and r, separated by commas. Only for a new set.
    trust: str | None = None
    # ``held-out`` (default): a lag of the torque that labels show is put into the set's model where held-out
    # blocks gain by it; ``none``: the vehicle file as it is. Only for a new set whose trust is held-out.
    lag: str | None = None
    any_vehicle: bool = False  # learn drives that contradict the vehicle all the same, with a warning
