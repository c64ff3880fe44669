"""A signal map drafted from a recording nobody has described: names suggest, data and checks judge.

May import: assembling, checking and the modules directly in `logs/`, not the readers.
"""
