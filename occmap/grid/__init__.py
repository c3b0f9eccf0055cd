"""The grid engine: rays in, sparse integer evidence out."""
