"""What is left in whitened residuals: structure, autocorrelation, spectral lines, location, a formula as lead.

May import: innovations, baseline, recording, statement; learning, vehicle, logs, signals, errors.
"""
