"""What a drive must be before it is judged: screening, track position, smoothed series, motion against position.

May import: statement; vehicle, logs, signals, errors.
"""
