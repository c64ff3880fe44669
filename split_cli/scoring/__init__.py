"""Held-out splits, metrics, noise floor, rollouts, feature-set protocols.

May import: prediction, learning, logs, vehicle, signals, files, errors.
"""
