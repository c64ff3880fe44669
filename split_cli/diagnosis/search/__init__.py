"""Which physical terms explain the prediction errors: candidates, joint fits, selection, tests of one term.

May import: remainder, innovations, baseline, recording, statement; vehicle, logs, signals, errors.
"""
