"""What clouds say against their own map: that they contradict each other, or show the robot."""

from pathlib import Path

import pytest

from occmap.evidence import list_contradictions
from tests.cli.runner import ask
from tests.clouds.simulation import HALL
from tests.grid.scans import make_grid

TURNED = ("--sensor-pose", "0,0,3.14")


@pytest.mark.parametrize(
    ("cells", "told"),
    [
        ([(3, 1), (1, 3), (0, 8)], ""),
        ([(4, 1), (6, 6), (0, 50)], ""),
        ([(3, 1), (7, 7), (0, 50)], "30%"),
        ([(9, 1), (0, 10)], ""),
        ([(0, 5)], ""),
    ],
)
def test_hits_in_cells_that_mostly_were_missed_are_told(
    cells: list[tuple[int, int]], told: str
) -> None:
    grid = make_grid({(0, col): counts for col, counts in enumerate(cells)})
    notes = list(list_contradictions(grid))
    assert len(notes) == bool(told)
    assert all(told in note for note in notes)


def test_a_wrong_mount_is_told_by_check_and_build(tmp_path: Path) -> None:
    made = tmp_path / "hall.pgm"
    for words, is_wrong in (((), False), (TURNED, True)):
        notes = ask("build", HALL, *words, "-o", made)["notes"]
        warnings = ask("check", HALL, *words)["warnings"]
        for told in (notes, warnings):
            assert any("clouds contradict each other" in text for text in told) == is_wrong


def test_a_number_of_the_model_leaves_the_others_those_for_clouds(tmp_path: Path) -> None:
    models = {
        ask("build", HALL, *words, "-o", tmp_path / "hall.pgm")["map"]["model"]
        for words in (("--cut", "0.2"), ("--model", "counting:cut=0.2"))
    }
    (model,) = models
    assert model.endswith("cut=0.2,spread=0.0,ceiling=1.0,doubt=0.0,repeat_from=8.0")
