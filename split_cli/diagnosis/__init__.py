"""Simulation against reality: whether, where and why they differ, and whether the named physics helps.

May import: scoring, prediction, learning, vehicle, logs, signals, files, errors; never plant.
"""
