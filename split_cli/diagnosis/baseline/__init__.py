"""What simulation and reality share beyond the nominal model: a discrepancy of smooth forces with priors.

May import: recording, statement; vehicle, logs, signals, errors.
"""
