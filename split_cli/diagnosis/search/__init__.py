"""Which physical terms explain the residuals: candidates, joint fits, selection, calibrated thresholds.

May import: remainder, innovations, baseline, recording, statement; vehicle, logs, signals, errors.
"""
