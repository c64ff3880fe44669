"""Prediction errors, whitened to unit noise, one step ahead and over seconds, and the fit's objective.

May import: baseline, recording, statement; learning, vehicle, logs, signals, errors.
"""
