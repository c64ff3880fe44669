"""One file a log format; each turns a recording into a `RawLog`.

May import: logs.raw, signals, files, errors.
"""
