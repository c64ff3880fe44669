"""The nominal car: parameters, tyres, single track, integration, and the named terms that may be added.

May import: signals, files, errors, NumPy, SciPy, numba (and PyYAML in `parameters`). Never logs, learning, plant.
"""
