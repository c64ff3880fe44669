"""Checks of files and folders that this program wrote, against themselves: `split verify`.

May import: ingesting, the modules directly in `workflows/`, and every package but cli.
"""
