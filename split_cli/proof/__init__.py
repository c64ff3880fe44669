"""The blind proof of the diagnosis: cases with concealed effects, sealed answers and scores.

May import: plant, scoring, logs, vehicle, signals, files, errors. It never sees the diagnosis, nor the reverse.
"""
