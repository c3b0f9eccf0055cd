"""3D lidars and depth cameras: the ground below a drive, and what stands on it.

A first pass over all logs finds the ground (`ground`), a second one observes each cloud over it
(`engine`). `kernels` holds the loops of both.
"""
