"""The double-track car that makes test recordings: sensors, drivers, tracks, standard tests.

May import: signals, files, yaml_file, errors and itself. It never sees the nominal model's equations. `recording` is
the one place outside logs that imports mcap: it writes logs that the readers have never seen.
"""
