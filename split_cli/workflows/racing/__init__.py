"""Closed loop: races by their parts and as a page, manoeuvres, the experiments of the paper run once and kept.

May import: the modules directly in `workflows/`, and every package but cli.
"""
