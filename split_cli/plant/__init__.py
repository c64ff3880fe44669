"""The double-track car that makes test recordings: sensors, drivers, tracks, standard tests.

May import: signals, files, yaml_file, errors and itself. It does not use the nominal model's equations.
`recording` is the one place outside logs that imports mcap: it writes logs, by code that the readers do not share.
"""
