"""A vehicle's tyres, resistances and splits from gentle drives, with what the drives cannot tell.

May import: vehicle, errors, NumPy. Arrays in, frozen results out; drives are read in workflows.
"""
