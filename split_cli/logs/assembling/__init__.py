"""From a recording and a map to a drive: gathered, cleaned, on one clock, moved to the CG, derived, judged.

May import: checking and the modules directly in `logs/`, not the readers.
"""
