"""Simulation against reality: whether, where and why they differ, and whether the named physics helps.

`engine` calls the packages below in this order: recording, baseline, innovations, search, remainder, verdict,
statement. `policy` holds the numbers that decide. docs/inside_diagnosis.md shows objects, shapes and equations.

May import: scoring, prediction, learning, vehicle, logs, signals, files, errors; never plant.
"""
