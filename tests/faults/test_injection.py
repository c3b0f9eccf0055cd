"""A fault at each open, read, write, fsync and rename of each command that writes.

With OCCMAP_FAULTS set, every fault at every call; without, one fault at each.
"""

import gc
import os
from itertools import cycle
from pathlib import Path

import pytest

from tests.cli.runner import occmap
from tests.faults.injection import FAULTS, KINDS, Injector, inject
from tests.faults.scene import COMMANDS, Scene, set_up

# A reader or a library that a fault comes upon leaves its input to the end of the process.
pytestmark = pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")


@pytest.mark.parametrize("command", COMMANDS)
def test_a_fault_anywhere_leaves_each_file_as_it_was_or_as_it_should_be(
    command: str, here: Path
) -> None:
    scene = set_up(here, command)
    trial = Injector(scene.folder)
    with inject(trial):
        assert occmap(*scene.words).code == 0
    assert all(trial.counts[kind] for kind in KINDS)
    each = cycle([name] for name in FAULTS)
    for kind, count in trial.counts.items():
        for number in range(1, count + 1):
            for fault in FAULTS if "OCCMAP_FAULTS" in os.environ else next(each):
                hold_against(scene, kind, number, fault)
    gc.collect()  # of files that are not closed no other test is to be told


def hold_against(scene: Scene, kind: str, number: int, fault: str) -> None:
    """Run the command with a fault: it says so in one line, or does all that it should."""
    scene.reset()
    injector = Injector(scene.folder, kind, number, fault)
    with inject(injector):
        result = occmap(*scene.words)
    about = f"{injector.__dict__}: {result}"
    assert injector.fired, about
    assert list(scene.list_wrong()) == [], about
    if kind != "rename" and "m.pgm" in scene.words:
        assert not scene.is_mixed(), about
    if result.code == 0:
        assert scene.is_done(), about
    else:
        errors = [line for line in result.err.splitlines() if not line.startswith("note: ")]
        assert result.code == 1, about
        assert len(errors) == 1, about
        assert errors[0].startswith("error: "), about
        assert "fault in occmap" not in errors[0], about
