"""`occmap explain` as a user types it."""

import math
import shutil
from pathlib import Path

import pytest

from tests.cli.runner import ask, occmap, read_error
from tests.samples import PLAIN_WORDS, write_csv

ACROSS = [(0.05, 0.05, 0.0), (0.65, 0.05, math.pi), (0.25, 0.05, 0.0)]
"""With a beam of 0.32 m: two that hit the cell at (0.35, 0.05), and one that crosses it"""


ASK = "explain a.npz 0.37 0.05"


def save(log: str, words: str = "", into: str = "") -> None:
    """Build evidence of a log."""
    line = f"{log}.csv --resolution 0.1 {words} -o {into or log}.npz"
    assert occmap("build", *PLAIN_WORDS, *line.split()).code == 0


@pytest.fixture(scope="module")
def made(workplace: Path) -> Path:
    """A folder with two logs, evidence of both, and of the first as log-odds, too."""
    write_csv(workplace / "a.csv", ACROSS, [0.32])
    write_csv(workplace / "b.csv", [(-1.95, -0.55, 0.0)], [0.32])
    save("a")
    save("b")
    save("a", "--model quadratic", into="q")
    return workplace


@pytest.fixture(autouse=True)
def _evidence(made: Path, here: Path) -> None:
    shutil.copytree(made, here, dirs_exist_ok=True)


def test_a_cell_in_lines() -> None:
    result = occmap(ASK)
    assert (result.code, result.err) == (0, "")
    assert result.out.splitlines() == [
        "cell     row 0, column 3 of the lattice: x 0.3 to 0.4 m, y 0 to 0.1 m",
        "class    occupied: probability 0.784 by "
        "simple:p_hit=0.7,p_miss=0.4,prior=0.5,cut=0.5,spread=0.0",
        "seen     2 hits and 1 miss",
        "visits   a.csv: hit on 1 of 1 visit, in slices of time from 0.000 s to 10.000 s",
        "around   0/0  0/0  0/0",
        "         0/2  2/1  0/2",
        "         0/0  0/0  0/0",
    ]


def test_a_cell_that_only_the_spread_of_hits_reaches_is_told_as_such() -> None:
    """The beam ends in column 3: nothing looked at column 4."""
    write_csv(Path("once.csv"), ACROSS[:1], [0.32])
    assert occmap("build beam once.csv -r 0.1 --hit-offset 0 -o once.npz").code == 0
    lines = occmap("explain once.npz 0.45 0.05").out.splitlines()
    assert lines[1].startswith("class    occupied: ")
    assert lines[2].startswith("seen     nothing of its own: ")
    assert "(--spread)" in lines[2]


def test_eighths_are_told_as_observations_and_json_says_the_unit() -> None:
    assert occmap("build surface a.csv -r 0.1 --hit-offset 0 -o s.npz").code == 0
    question = "explain s.npz 0.37 0.05"
    found = ask(question)
    hits, misses = (found["seen"][name] / 8 for name in ("hits", "misses"))
    assert found["unit"] == 8
    assert hits > 0
    seen = occmap(question).out.splitlines()[2].split()
    assert (float(seen[1]), float(seen[4])) == (hits, misses)


@pytest.mark.parametrize("logs", ["logs", "logs/*.csv"])
def test_a_folder_or_a_pattern_stands_for_the_logs_in_it(logs: str) -> None:
    Path("logs").mkdir()
    for name in ("a.csv", "b.csv"):
        Path(name).rename(f"logs/{name}")
    assert occmap("merge a.npz b.npz -o both.npz").code == 0
    found = ask(f"explain both.npz 0.37 0.05 --log {logs}")
    assert (len(found["scans"]), found["scans_used"]) == (3, 4)
    assert found["notes"] == [f"{logs}: 2 recordings, in the order of their time: a.csv, b.csv"]


def test_scans_in_lines() -> None:
    result = occmap(f"{ASK} --log a.csv")
    assert (result.code, result.err) == (0, "")
    assert result.out.splitlines()[7:] == [
        "scans    3 of 3 scans used: 2 hits and 1 miss",
        "         stamp (s)  hits  misses  sensor at (m)  away (m)        from",
        "             0.000     1       0   0.050, 0.050     0.300  a.csv scan",
        "             1.000     1       0   0.650, 0.050     0.300  a.csv scan",
        "             2.000     0       1   0.250, 0.050     0.100  a.csv scan",
    ]


def test_log_odds_in_lines() -> None:
    lines = occmap("explain q.npz 0.37 0.05 --log a.csv").out.splitlines()
    # logit(0.6), twice up, once down
    assert lines[2] == "seen     log-odds 0.405 of 3 observations"
    assert lines[7] == ("scans    3 of 3 scans used: log-odds 0.405 of 3 observations")
    assert lines[8].startswith("         stamp (s)  log-odds  observations  sensor at (m)")
    assert [line.split()[1] for line in lines[9:]] == ["0.41", "0.41", "-0.41"]


def test_visits_come_by_build() -> None:
    # Two visits, half a minute apart: on the first the cell is hit, on the second it is crossed.
    write_csv(Path("late.csv"), [ACROSS[0], *[(5.0, 5.0, 0.0)] * 29, ACROSS[2]], [0.32])
    save("late", "--resume a.npz", into="al")
    question = "explain al.npz 0.37 0.05"
    assert occmap(question).out.splitlines()[3:6] == [
        "visits   a.csv: hit on 1 of 1 visit, in slices of time from 0.000 s to 10.000 s",
        "         late.csv: hit on 1 of 2 visits, in slices of time from 0.000 s to 40.000 s",
        "         together: hit on 1 of 2 visits, in slices of time from 0.000 s to 40.000 s",
    ]
    assert occmap("explain al.npz 5.05 5.05").out.splitlines()[3] == (
        "visits   late.csv: hit on 0 of 1 visit, in slices of time from 0.000 s to 30.000 s"
    )
    found = ask(f"{question} --min-passes 2")
    assert [build["until_ns"] for build in found["builds"]] == [10 * 10**9, 40 * 10**9]
    known = {"since_ns": 0, "until_ns": 40 * 10**9, "hit_visits": 1, "seen_visits": 2}
    assert found["visits"] == known
    assert (found["class"], found["min_passes"]) == ("free", 2)  # two misses are left: 0.31
    assert (found["kept"]["hits"], found["kept"]["misses"]) == (0, 2)
    told = [occmap(f"{question} --min-passes {least}").out.splitlines()[2:4] for least in (1, 2)]
    assert [seen for seen, _ in told] == ["seen     3 hits and 2 misses"] * 2
    assert [kept for _, kept in told] == [
        "kept     3 hits and 0 misses by --min-passes 1, since half of its visits or more hit it",
        "kept     0 hits and 2 misses by --min-passes 2, since fewer visits hit it",
    ]
    assert ask(question)["kept"] is None


def test_hits_on_too_few_visits_are_forgotten() -> None:
    write_csv(Path("once.csv"), ACROSS[:1], [0.32])
    save("once")
    question = "explain once.npz 0.37 0.05 --min-passes"
    assert occmap(f"{question} 2").out.splitlines()[1:3] == [
        "class    unknown: it was hit, but on fewer visits than --min-passes",
        "seen     1 hit and 0 misses",
    ]
    assert "class    occupied" in occmap(f"{question} 1").out
    # Nothing around the point lasts either: that is an answer, too, and no error.
    around = occmap(question.replace("0.37", "0.47") + " 2")
    assert around.out.splitlines()[1] == "class    unknown: nothing observed this cell"


@pytest.mark.parametrize("point", ["-1.65 -.55", "-1.65e0 -0.55", "-- -1.65 -0.55"])
def test_coordinates_may_be_negative(point: str) -> None:
    found = occmap(f"explain --json b.npz {point}").json
    assert (found["cell"]["row"], found["cell"]["column"]) == (-6, -17)
    assert found["seen"] == {"hits": 1, "misses": 0, "log_odds": None, "observations": 1}


def test_a_log_may_have_the_name_of_a_number() -> None:
    Path("-5").write_bytes(Path("a.csv").read_bytes())
    assert occmap("check -- -5").out.startswith("-5\n")
    message = read_error(occmap("build a.csv -o m.pgm --extent -2 -2 2 2"), 2)
    assert message.startswith("--extent -2: 1 value")


def test_a_cell_that_nothing_observed() -> None:
    inside = occmap("explain a.npz 0.05 0.15 --log a.csv").out.splitlines()
    assert inside[1] == "class    unknown: nothing observed this cell"
    assert inside[2] == "         it lies outside of the map: x 0 to 0.7 m, y 0 to 0.1 m"
    assert inside[-1] == "scans    none of 3 scans used observed the cell"
    far = occmap("explain a.npz -70 0").out.splitlines()
    assert far[1:] == inside[1:3]


def test_a_long_list_is_cut_to_those_that_hit_first_and_json_is_not() -> None:
    write_csv(Path("long.csv"), [*ACROSS[2:] * 40, *ACROSS[:1] * 10], [0.32])
    save("long")
    question = "explain long.npz 0.37 0.05 --log long.csv"
    lines = occmap(question).out.splitlines()
    shown = [*range(40, 50), 0, 1]
    assert [line.split()[0] for line in lines[9:-1]] == [f"{s}.000" for s in shown]
    assert lines[-1] == "         and 38 more: --json lists all"
    found = ask(question)
    assert [scan["stamp_ns"] for scan in found["scans"]] == [s * 10**9 for s in range(50)]


def test_another_model_and_other_thresholds() -> None:
    counting = occmap(f"{ASK} --model counting:strength=2,spread=0,ceiling=1,doubt=0").out
    assert "probability 0.600 by counting:" in counting
    assert "class    undecided: " in occmap(f"{ASK} --occupied-thresh 0.8").out
    assert "p_hit=0.6" in occmap(f"{ASK} --p-hit 0.6").out
