"""All commands fail alike: 2 where the command line can never work, 1 where a file is at fault."""

from pathlib import Path

import pytest

from tests.cli.runner import occmap
from tests.samples import write_csv


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log, a map of it, its evidence, and evidence of another model."""
    folder = tmp_path_factory.mktemp("codes")
    log = write_csv(folder / "log.csv", [(0.0, 0.0, 0.0)] * 10, [0.3])
    assert occmap("build", log, "-o", folder / "a.npz", "-o", folder / "a.pgm").code == 0
    assert occmap("build", log, "-o", folder / "q.npz", "--model", "quadratic").code == 0
    return folder


@pytest.fixture(autouse=True)
def folder(files: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(files)
    return files


AT_FAULT = """
build none.csv -o m.pgm
check none.csv
compare none.csv
diff a.pgm none.pgm
score none.pgm --log log.csv
score a.pgm --log none.csv
score a.pgm --truth none.pgm
merge a.npz none.npz -o m.npz
build log.csv -o m.npz --resume none.npz
build a.npz -o m.pgm
check a.npz
compare a.npz
merge log.csv -o m.npz
build log.csv -o no/m.pgm
compare log.csv -o no/m.png
render a.npz -o no/m.pgm
merge a.npz -o no/m.npz
diff a.pgm a.pgm -o no/m.png
score a.pgm --truth a.pgm -o no/m.png
build log.csv -o m.pgm --scan-topic /x
compare log.csv --scan-topic /x
build log.csv -o m.pgm --max-cells 2
merge a.npz -o m.pgm --max-cells 2
render a.npz -o m.pgm --model quadratic
"""
"""Files that are missing, of another kind or in no folder; options that leave nothing of them"""
NEVER = """
build none.csv -o m.gif
compare none.csv -o m.gif
render none.npz -o m.gif
merge none.npz -o m.gif
diff none.pgm none.pgm -o m.gif
diff a.pgm a.gif
build
build log.csv
check
compare
render
merge
diff
render a.npz -o m.pgm --occupied-thresh 2
diff a.pgm a.pgm --occupied-thresh 2
build log.csv -o m.pgm --max-range -1
build log.csv -o m.pgm --p-hit 2
render a.npz -o m.pgm --p-hit 2
build log.csv -o m.pgm --max-cells 0
merge a.npz -o m.pgm --max-cells 0
compare log.csv --jobs 0
check log.csv --start 5 --end 2
diff a.pgm a.pgm --fail-above 5
"""
"""Suffixes that nobody writes, told before anything is read; nothing given; and values out of their
range"""


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (code, line)
        for code, lines in ((1, AT_FAULT), (2, NEVER))
        for line in lines.split("\n")[1:-1]
    ],
    ids=str,
)
def test_exit_codes(code: int, words: str) -> None:
    result = occmap(*words.split())
    assert result.code == code, result.err
    assert result.err.count("\n") <= 1  # check lists problems of logs on stdout
