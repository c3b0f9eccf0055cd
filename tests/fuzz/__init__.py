"""Fuzzing of the readers: `python -m tests.fuzz [SECONDS] [TARGET...]`, also `make fuzz`."""
