"""The nominal model: vehicle file, tyres, single track, integration, calibration, and the effects that may be added.

May import: signals, files, errors, NumPy, SciPy, numba (and PyYAML in `parameters`). Never logs, learning, plant.
"""
