"""Trained sets as C99, CasADi, npz and json, each verified against Python.

May import: scoring, prediction, learning, logs, vehicle, signals, files, errors. Imports casadi.
"""
