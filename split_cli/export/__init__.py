"""Trained sets as C99, CasADi, npz, JSON and limits over speed (`ggv`); code and numbers are compared with Python.

`targets` writes. `check` (predictions), `step_check` (steps), `c_check` and `generated_check` (compiled C) compare
while it writes; `verify` compares files that lie in a folder.

May import: scoring, prediction, learning, logs, vehicle, signals, files, errors. Imports casadi.
"""
