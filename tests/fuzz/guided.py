"""One reader under atheris: `run()` takes the target's name and libFuzzer's flags from argv."""

import sys
from importlib import import_module

from tests.fuzz.targets import TARGETS


def run() -> None:
    """Fuzz until libFuzzer's time is over; it ends the process."""
    atheris = import_module("atheris")  # an optional tool, without types
    target = TARGETS[sys.argv.pop(1)]
    atheris.instrument_all()
    atheris.Setup(sys.argv, target.read)
    atheris.Fuzz()
