"""Where each scan was taken: transform tree, trajectories, and their interpolation."""
