"""Controllers that drive with a model, and learn: MPC, MPCC, their quadratic programmes, paths and scenarios.

May import: export, learning, prediction, vehicle; never the plant, which only `workflows` puts beside it.
"""
