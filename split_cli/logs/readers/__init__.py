"""One file a log format; each turns a recording into a `RawRecording` of logs.raw, with nothing converted.

May import: logs.raw, signals, files, errors. `open_recording` finds the reader.
"""

from split_cli.logs.readers.opening import open_recording

__all__ = ["open_recording"]
