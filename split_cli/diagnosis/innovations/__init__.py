"""Prediction errors of unit variance at common operating points, effect sizes over noise, the cost of a fit.

May import: baseline, recording, statement; learning, vehicle, logs, signals, errors.
"""
