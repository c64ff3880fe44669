"""The blind proof with its diagnosis: cases, a multi-body car, faults in real recordings: `split prove`.

May import: the ground of `workflows`, and every package but cli.
"""
