"""NetCDF in its classic form (version 3): variables as vectors, with their units, scales and fill values."""

from pathlib import Path

import numpy as np

from split_cli.errors import LogError, damaged
from split_cli.logs.raw import RawRecording, ReadNote
from split_cli.logs.readers.hdf5_attributes import unpacked
from split_cli.logs.readers.named_arrays import recording_of_vectors


def open_netcdf_classic(path: Path) -> RawRecording:
    """Open a NetCDF file of version 3; one of version 4 is HDF5.

    Raises
    ------
    LogError
        If it is damaged or holds no vector.
    """
    from scipy.io import netcdf_file

    leaves: list[tuple[str, np.ndarray]] = []
    notes: list[ReadNote] = []
    try:
        with netcdf_file(path, "r", mmap=False) as file:
            for name, variable in file.variables.items():
                values = np.array(variable.data)
                if values.dtype.kind not in "biuf" or values.ndim > 2:
                    continue
                attributes = dict(variable._attributes)
                unit = attributes.get("units", b"")
                text = unit.decode(errors="replace") if isinstance(unit, bytes) else ""
                # A time counts from an instant: `seconds since 2026-11-28`.
                text = text.partition(" since ")[0].strip()
                made = unpacked(values, attributes)
                made = values.astype(np.float64) if made is None else made
                leaves.append((f"{name} [{text.replace('.', ' ')}]" if text else name, np.atleast_1d(made)))
    except LogError:
        raise
    except Exception as error:  # scipy raises anything on a file that is cut off
        raise damaged(path, error, "Save it again.") from error
    return recording_of_vectors(path, leaves, notes, "Save the signals as vectors over time.")
