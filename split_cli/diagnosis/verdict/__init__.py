"""What may be concluded: findings with intervals, detectable sizes, held-out evidence, improvement.

May import: search, remainder, innovations, baseline, recording, statement; scoring, prediction, learning, vehicle.
"""
