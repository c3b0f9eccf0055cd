"""Compiled loops of the readers; loaded only where a log is long enough to be worth it."""
