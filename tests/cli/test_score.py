"""`occmap score` in lines, as JSON, with limits and a picture."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.cli.runner import ask, occmap
from tests.samples import SAMPLE_LOGS

DRIVE, PLAN = SAMPLE_LOGS / "drive.mcap", SAMPLE_LOGS / "floor_plan.yaml"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("made") / "map.pgm"
    assert occmap("build", DRIVE, "-o", path).code == 0
    return path


def test_a_map_is_held_against_recordings_and_the_plan(made: Path, tmp_path: Path) -> None:
    picture = tmp_path / "score.png"
    words = ["score", made, "--log", SAMPLE_LOGS / "drive.bag", "--truth", PLAN, "-o", picture]
    text = occmap(*words).out
    for told in ("share 0.9", "hits lie in occupied", "edges of", "invented", "m from those"):
        assert told in text
    assert ask(*words)["by_truth"]["edges_found"] > 0.99
    assert np.asarray(Image.open(picture)).shape[2] == 3


def test_a_map_that_lies_elsewhere_is_moved(made: Path, tmp_path: Path) -> None:
    moved = tmp_path / "moved.pgm"
    occmap("build", DRIVE, "--transform", "0.5,0.3,-0.1", "-o", moved)
    assert "fit " not in occmap("score", moved, "--truth", made).out
    words = ["score", moved, "--truth", made, "--log", DRIVE, "--fit"]
    limits = ["--fail-if", "edges_found < 98%", "--fail-if", "wall_distance > 0.05"]
    fitted = occmap(*words, *limits)
    assert (fitted.code, fitted.err) == (0, "")
    assert "the logs fit with --transform 0." in fitted.out
    assert "the map fits moved by -0." in fitted.out
    assert occmap(*words[:-1], *limits).code == 3


def test_what_does_not_belong_together_is_told(made: Path, tmp_path: Path) -> None:
    """The hall is another building than the office of the drive."""
    hall = tmp_path / "hall.pgm"
    assert occmap("build", SAMPLE_LOGS / "hall.mcap", "-o", hall).code == 0
    apart = occmap("score", hall, "--log", DRIVE).err
    assert "of the hits lie in occupied cells" in apart
    assert "--fit may find it" in apart
    doubts = occmap("score", hall, "--log", DRIVE, "--truth", made, "--fit").err
    assert "it is not sure how the drive lies on the map: " in doubts
    assert f"it is not sure how the map lies on {made}: " in doubts
