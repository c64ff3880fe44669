"""Closed loop: races by their parts, manoeuvres, and the experiments of the paper run once and kept.

May import: the ground of `workflows`, and every package but cli.
"""
