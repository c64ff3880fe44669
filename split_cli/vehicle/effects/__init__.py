"""Named physical terms that may be added to the nominal single track, one file a family.

May import: vehicle (tire, operations), errors.
"""
