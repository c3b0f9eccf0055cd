"""Scoring: which update and sensor model suits a log, measured on scans that no map has seen."""
