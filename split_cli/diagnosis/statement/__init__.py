"""What a diagnosis says: the tree of results, sentences for the report, and `diagnosis.json`.

May import: vehicle, signals, errors; none of the other packages of `diagnosis`, which all may import this one.
"""
