"""Results of a diagnosis: data classes, sentences for the report, and `diagnosis.json`.

May import: vehicle, signals, errors; none of the other packages of `diagnosis`, which all may import this one.
"""
