"""How good a model is: held-out blocks, errors, noise floor, rollouts, trust, and the choice of features.

May import: prediction, learning, logs, vehicle, signals, files, errors.
"""
