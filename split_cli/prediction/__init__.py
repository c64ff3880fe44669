"""Predictors behind one seam: mean, variance and Jacobian of the residual.

May import: learning, vehicle, signals, files, errors.
"""
