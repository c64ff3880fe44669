"""The blind proof with its diagnosis: cases, a multi-body car, faults in real recordings: `split prove`.

May import: the modules directly in `workflows/`, and every package but cli.
"""
