"""Charts of reports and figures as files; the only place that imports matplotlib.

May import: scoring, prediction, learning, logs, vehicle, signals, files, errors.
"""
