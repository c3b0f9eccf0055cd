"""The loops over beams and cells, compiled by numba: integers in, integers added to a window.

A window is a rectangle of whole tiles. Rows, columns and lattice units that kernels see are
relative to its lower-left corner; what lies outside it is left out, exactly, so that a map may be
traced window by window.
"""
