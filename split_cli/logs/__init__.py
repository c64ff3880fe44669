"""Recordings in, canonical drives out: readers, signal map, resampling, segments, consistency.

May import: vehicle, signals, files, errors. The only place that imports mcap, rosbags, h5py, asammdf.
"""
