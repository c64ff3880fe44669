"""Closed loop: races by their parts and as a page, and manoeuvres.

May import: the modules directly in `workflows/`, and every package but cli.
"""
