"""occmap: 2D occupancy grid maps from recorded laser scans with known poses."""
