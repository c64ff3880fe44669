"""What a drive must be before it is judged: screening, smoothed series, straights, redundant channels (witnesses).

May import: statement; vehicle, logs, signals, errors.
"""
