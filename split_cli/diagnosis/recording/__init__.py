"""Recordings before any effect is fitted: cleaning, screening, `Series` of states, redundant channels (witnesses).

May import: statement; vehicle, logs, signals, errors.
"""
