"""Whether the channels of a drive fit together, how late they are, and what a mistake in them would explain.

May import: the modules directly in `logs/` (drive, signal_map, raw, ...), not the readers.
"""
