"""Labels, features, valid region, cells and the trained set; sets that learn, and trust that is found, while driving.

May import: logs.drive, vehicle, signals, files, errors.
"""
