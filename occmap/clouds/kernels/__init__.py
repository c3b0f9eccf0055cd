"""The loops over points, columns and cells, compiled by numba: all that is counted is an integer.

A coordinate is rounded once, to whole millimetres for the ground and to lattice units for cells;
everything after that is integer arithmetic, so that the order of points, batches, threads and
workers changes nothing.
"""
