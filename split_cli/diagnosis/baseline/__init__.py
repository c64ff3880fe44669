"""What simulation and reality share beyond the nominal model: basis functions with normal priors of their weights.

May import: recording, statement; vehicle, logs, signals, errors.
"""
