"""What a drive must be before it is judged: screening, states, straights, redundant channels (witnesses).

May import: statement; vehicle, logs, signals, errors.
"""
