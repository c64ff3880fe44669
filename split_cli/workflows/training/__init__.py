"""From drives to a trained set: `split train`, and the settings that held-out blocks choose.

May import: ingesting, the modules directly in `workflows/`, and every package but cli.
"""
