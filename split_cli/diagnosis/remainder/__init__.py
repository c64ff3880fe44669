"""What an explanation leaves: flexible fit, autocorrelation, spectral lines; its location, a sparse formula.

May import: innovations, baseline, recording, statement; learning, vehicle, logs, signals, errors.
"""
