"""The blind proof of the diagnosis: cases with concealed effects, sealed answers and scores.

May import: plant, scoring, logs, vehicle, signals, files, errors. Never the diagnosis, which does not import it
either.
"""
