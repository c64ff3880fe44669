"""One function a command, for the command line and for notebooks.

May import: every package but cli.
"""
