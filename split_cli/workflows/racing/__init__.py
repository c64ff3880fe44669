"""A race by its parts: settings, what is refused, driving, learning from lap 0, sums over a lap, results.

May import control, plant, learning, prediction, logs and vehicle, as `workflows` may.
"""
