"""Which channels of a drive were measured, so that they can be checked against each other."""

from split_cli.logs.drive import Drive


def measures(drive: Drive, *channels: str) -> bool:
    """Return whether channels were recorded independently, so that each can contradict the others.

    A channel that ingest derived from another one, or that another one was derived from, cannot.
    """
    if "ay" in channels and drive.metadata.lateral_velocity_is_integrated:
        return False
    return all(name in drive.columns and not drive.metadata.is_derived(name) for name in channels)


def velocity_is_from_position(drive: Drive) -> bool:
    """Return whether a velocity or the yaw rate was differentiated from position and yaw.

    Such velocities have no delay against position.
    """
    known = drive.metadata
    return any(known.is_derived(name) and "X, Y" in known.kinds[name] for name in ("vx", "vy", "r"))
