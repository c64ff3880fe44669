"""One plain function a command: what the command line does, for notebooks too.

May import: every package but cli.
"""
