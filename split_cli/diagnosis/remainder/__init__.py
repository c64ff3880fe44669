"""What is left without a name, and where: structure, autocorrelation, spectral lines, a formula as a lead.

May import: innovations, baseline, recording, statement; learning, vehicle, logs, signals, errors.
"""
