"""From a recording and a map to a drive: channels gathered, cleaned, put on one clock, moved to the CG, derived.

May import: checking and the modules directly in `logs/`, not the readers.
"""
