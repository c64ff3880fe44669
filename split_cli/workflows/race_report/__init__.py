"""The page of a race: track, laps to choose, compare and play, and tables. May import what workflows may."""
