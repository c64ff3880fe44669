"""The model discrepancy that simulation and reality share: a dictionary of smooth forces with priors.

May import: recording, statement; vehicle, logs, signals, errors.
"""
