"""Fuzzing of the readers: `python -m tests.fuzz [SECONDS] [TARGET...]`, also `make fuzz`.

With atheris installed the inputs are guided by coverage; without it they are random mutations.
"""
