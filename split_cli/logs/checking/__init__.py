"""Whether the channels of a drive fit together, how late they are, and what a mistake in them would explain.

May import: the ground of `logs` (drive, signal_map, raw, track_position, laps), not the readers.
"""
