"""Checks of files and folders that this program wrote, against themselves: `split verify`.

May import: ingesting, the ground of `workflows`, and every package but cli.
"""
