"""Checks of files of ours against themselves: `split verify`.

May import: ingesting, the ground of `workflows`, and every package but cli.
"""
