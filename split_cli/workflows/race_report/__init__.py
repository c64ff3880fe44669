"""The page of a race: track, laps to choose, compare and play, and tables.

May import: racing, the ground of `workflows`, and every package but cli.
"""
