"""From recordings to drives on one clock in SI units: readers, signal maps, resampling, segments, checks.

May import: vehicle, signals, files, errors. The only place that imports mcap, rosbags, h5py, asammdf.
"""
