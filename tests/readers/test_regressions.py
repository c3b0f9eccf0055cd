"""Small damaged inputs on which a reader once failed, or gave less than there was."""

from pathlib import Path

import pytest

from occmap.readers import open_log
from tests.fuzz.targets import TARGETS

FOLDER = Path(__file__).parent / "regressions"
SCANS = {
    "bag-definition-in-index": 3,
    "csv-gzip-damaged": 1,
    "db3-cut-within-last-page": 3,
    "mcap-definition-in-summary": 3,
}
"""What can be read of each; one that is not listed must only not crash."""


@pytest.mark.parametrize("path", sorted(FOLDER.iterdir()), ids=lambda path: path.name)
def test_nothing_but_a_log_error_comes_of_it(path: Path) -> None:
    TARGETS[path.name.partition("-")[0]].read(path.read_bytes())


@pytest.mark.parametrize("name", SCANS)
def test_what_can_be_read_is_read_and_the_damage_noted(name: str) -> None:
    log = open_log(FOLDER / name)

    scans = list(log.scans({stream.topic for stream in log.streams}))

    assert len(scans) == SCANS[name]
    assert any(note.damage for note in log.notes) or name.startswith("mcap")
