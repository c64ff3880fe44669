"""The blind proof with its diagnosis: cases, and faults in real recordings: `split prove`.

May import: the modules directly in `workflows/`, and every package but cli.
"""
