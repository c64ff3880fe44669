"""What may be concluded: findings with intervals, leads, detection limits, held-out errors, the corrected vehicle.

May import: search, remainder, innovations, baseline, recording, statement; scoring, prediction, learning, vehicle.
"""
