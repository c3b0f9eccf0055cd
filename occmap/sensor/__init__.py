"""What a range value means, and what an observation says about a cell."""
