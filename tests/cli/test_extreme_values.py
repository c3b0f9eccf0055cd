"""Numbers beyond their types, and YAML that unfolds: one line and an exit code, quickly."""

import resource
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from occmap.cells import MOST_OBSERVED
from occmap.writers.npz import read_evidence, write_evidence
from tests.cli.runner import occmap, read_error
from tests.samples import write_csv

MEMORY = 1 << 30
UNFOLDING = "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 40))
MERGING = "".join(f"a{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * 9)}]}}\n" for n in range(1, 40))


@pytest.fixture(autouse=True, scope="module")
def _map(workplace: Path) -> None:
    """A map, `m`, as PGM with YAML, PNG and evidence."""
    write_csv(workplace / "log.csv", [(x / 10, 0.0, 0.0) for x in range(5)], [1.0, 1.5], 0.1)
    assert occmap("build log.csv -o m.pgm -o m.png -o m.npz").code == 0


def change_yaml(name: str, value: str, before: str = "", into: str = "bad.yaml") -> str:
    lines = Path("m.yaml").read_text().splitlines()
    kept = [line for line in lines if not line.startswith(f"{name}:")]
    Path(into).write_text(before + "\n".join([*kept, f"{name}: {value}", ""]))
    return into


def limit_memory() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


DIFF = """
import sys
from occmap.cli import run
print(*(run(["diff", "m.yaml", name]) for name in sys.argv[1:]))
"""
"""Prints the exit codes"""
WRONG = [
    ("resolution", "9" * 400, "", "resolution is '999999999999"),
    ("resolution", "9" * 9000, "", "resolution is '999999999999"),
    ("resolution", "1e300", "", "resolution is 1e+300"),
    ("origin", "[1e308, -1e308, 0]", "", "origin is ['1e308', "),
    ("origin", "[" * 900 + "]" * 900, "", ""),
    ("origin", "[" * 9000 + "]" * 9000, "", ""),
    ("occupied_thresh", "1" + "0" * 400, "", "occupied_thresh is '1000"),
    ("negate", "[1]", "", "negate is \"['1']\", where 0 or 1 belongs"),
    *(
        (name, "*a39", f"a0: &a0 {{x: 1}}\n{unfolding}", "")
        for name, unfolding in (("origin", UNFOLDING), ("mode", MERGING), ("resolution", MERGING))
    ),
]
"""A value of a YAML, what stands above it, and what is said of it"""


def test_a_yaml_with_numbers_beyond_their_types_or_that_unfolds() -> None:
    files = [
        change_yaml(name, value, before, f"bad{number}.yaml")
        for number, (name, value, before, _) in enumerate(WRONG)
    ]
    command = [sys.executable, "-c", DIFF, *files]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, preexec_fn=limit_memory
    )
    assert done.stdout.split() == ["1"] * len(WRONG)
    for file, (*_, found), error in zip(files, WRONG, done.stderr.splitlines(), strict=True):
        assert error.startswith(f"error: {file}: ")
        assert found in error
        assert len(error) < 400
        assert "fault in occmap" not in error


def test_a_picture_of_changes_spares_the_image_that_a_yaml_names() -> None:
    image = Path("m.png").read_bytes()
    named = change_yaml("image", "m.png")
    for maps in (f"{named} m.pgm", f"m.pgm {named}"):
        for line in (f"diff {maps}", f"score {maps.replace(' ', ' --truth ')}"):
            assert "m.png: is an input" in read_error(occmap(f"{line} -o m.png"), 2)
        assert Path("m.png").read_bytes() == image
    assert occmap("diff", named, "m.pgm", "-o", "changes.png").code == 0
    assert Path("changes.png").exists()


def test_maps_under_names_that_are_no_text() -> None:
    """The YAML names its image with the bytes that the file system has."""
    name = "map\udcff.pgm"
    for line in (f"build log.csv -o {name}", "diff map\udcff.yaml m.yaml", f"diff {name} m.yaml"):
        assert occmap(line).code == 0


@pytest.mark.parametrize("fill", [MOST_OBSERVED, MOST_OBSERVED // 2 + 1])
def test_sums_beyond_what_evidence_may_hold_are_refused(fill: int) -> None:
    saved = read_evidence(Path("m.npz"))
    tiles = {key: np.where(tile > 0, np.int64(fill), 0) for key, tile in saved.tiles.items()}
    Path("sum.npz").unlink(missing_ok=True)
    write_evidence(Path("big.npz"), replace(saved, tiles=tiles))
    error = read_error(occmap("merge", "big.npz", "big.npz", "-o", "sum.npz"), 1)
    assert "the observations of a cell add up to more than 9,007,199,254,740,992" in error
    assert not Path("sum.npz").exists()
    resumed = occmap("build", "log.csv", "--resume", "big.npz", "-o", "sum.npz")
    assert resumed.code == (fill == MOST_OBSERVED)
    assert occmap("render", "sum.npz", "-o", "n.pgm").code == resumed.code


@pytest.mark.parametrize("reading", [3.4e38, 3e30, 1e18])
def test_a_stray_range_beyond_all_sense(reading: float) -> None:
    """What `check` recommends is what works, or it says why nothing does."""
    ranges = [1.0 + beam / 7 for beam in range(100)]
    log = write_csv(Path("far.csv"), [(0.1 * x, 0.0, 0.0) for x in range(5)], ranges, 0.01)
    log.write_text(f"{log.read_text().rpartition(',')[0]},{reading:g}\n")
    seen, built = occmap("check far.csv"), occmap("build far.csv -o far.pgm")
    assert "Warning" not in seen.err + built.err
    assert built.code == seen.code
    assert "1 x 1 cells" not in seen.out
    if seen.code:
        assert f"{reading:.6g} m" in seen.out
        assert f"{reading:.6g} m" in built.err
        assert "occmap build" not in seen.out.splitlines()[-1]
    assert occmap("build far.csv -o far.pgm --max-range 30").code == 0


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("named", "value", "told"),
    [
        ("angle_increment", "1e308", "angles not finite"),
        ("angle_min", "-1e308", ""),
        ("time_increment", "1e308", ""),
        ("pose", "1e308", "pose not finite"),
        ("range", "1e308", "did not come back"),
    ],
)
def test_a_csv_of_huge_numbers_is_checked_without_a_warning(
    named: str, value: str, told: str
) -> None:
    number = {"angle_min": "0", "angle_increment": "0.1", "time_increment": "0", "range": "1"}
    number |= {"pose": "0", named: value}
    head = "".join(f"# {name}: {number[name]}\n" for name in list(number)[:3])
    row = f"{number['pose']},{number['pose']},0,1,{number['range']},2\n"
    rows = "".join(f"{second},{row}" for second in range(4))
    Path("huge.csv").write_text(f"{head}stamp,x,y,yaw,r0,r1,r2\n{rows}")
    result = occmap("check", "huge.csv")
    assert result.err.count("\n") <= 1
    assert "fault in occmap" not in result.err
    assert told in result.out
