"""Labels, features, valid region, cells and the trained set.

May import: logs.drive, vehicle, signals, files, errors.
"""
